"""A movie's frame around its 3D images: title, curve with a moving marker, captions, legend."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from opticcup_fem.plots import style
from opticcup_fem.plots.curves import draw_path, mark_events

if TYPE_CHECKING:
    import pandas as pd

_DPI = 100

TRANSITION = "jump: shapes in between are no equilibria"
UNSTABLE = "unstable: a tissue would not stay here"
ALARM = "#c1121f"


@dataclass(frozen=True)
class Curve:
    """What a page shows of one run.

    Attributes:
        title: Said over its image.
        path: Its rows.
        events: Its events.
        colour: Of its curve.
    """

    title: str
    path: "pd.DataFrame"
    events: Sequence[dict[str, Any]]
    colour: str


@dataclass(frozen=True)
class Legend:
    """What the colours mean: layers by name, or a quantity's scale."""

    layers: Sequence[str]
    scale: Normalize | None = None
    label: str = ""
    colours: str = ""


@dataclass(frozen=True)
class Layout:
    """Where things are, in pixels from the upper left corner.

    Attributes:
        size: Width and height of the frame, both even.
        panes: Left, top, width and height of each 3D image.
    """

    size: tuple[int, int]
    panes: tuple[tuple[int, int, int, int], ...]
    curve: tuple[float, float, float, float]
    caption: tuple[float, float]
    legend: tuple[float, float, float, float]


def layout(size: tuple[int, int], count: int) -> Layout:
    """Return the layout for one or two runs: the image beside the curve, or above it."""
    width, height = (2 * (n // 2) for n in size)
    if count == 1:
        left = 2 * int(0.30 * width)
        pane = (0, 0, left, height)
        return Layout(
            (width, height),
            (pane,),
            (0.66, 0.22, 0.31, 0.44),
            (0.615, 0.86),
            (0.63, 0.03, 0.34, 0.07),
        )
    half, tall = width // 2, int(0.66 * height)
    panes = ((0, 0, half, tall), (half, 0, width - half, tall))
    return Layout(
        (width, height), panes, (0.30, 0.10, 0.42, 0.22), (0.02, 0.0), (0.77, 0.10, 0.2, 0.2)
    )


class Page:
    """Composes frames: what stays is drawn once, what moves is drawn over it."""

    @style.styled
    def __init__(self, where: Layout, curves: Sequence[Curve], legend: Legend) -> None:
        """Draw what stays."""
        self.where = where
        width, height = where.size
        self._figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
        self._canvas = FigureCanvasAgg(self._figure)
        self._unit = height / 720
        self._axes = self._figure.add_axes(where.curve)
        self._draw_curves(curves)
        self._draw_legend(legend)
        self._markers = [
            self._axes.plot(
                [], [], "o", markersize=9 * self._unit, color=one.colour, markeredgecolor="white",
                zorder=9, clip_on=False,
            )[0]
            for one in curves
        ]  # fmt: skip
        self._clock, self._captions = self._texts(curves)
        moving: list[Artist] = [*self._markers, self._clock, *self._captions]
        for artist in moving:
            artist.set_animated(True)
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(self._figure.bbox)
        self._moving = moving

    def _draw_curves(self, curves: Sequence[Curve]) -> None:
        size = 11 * self._unit
        for curve in curves:
            draw_path(self._axes, curve.path, "D_over_r", curve.colour)
            mark_events(self._axes, curve.path, "D_over_r", curve.events, style.INK)
        times = np.concatenate([np.asarray(curve.path["t_n"]) for curve in curves])
        self._axes.set_xlim(0.0, max(float(times.max()), 1e-3))
        self._axes.set_ylim(bottom=0.0)
        self._axes.tick_params(labelsize=size)
        self._axes.xaxis.label.set_fontsize(size)
        self._axes.yaxis.label.set_fontsize(size)
        self._axes.grid(color="#e6e6e6", linewidth=0.6)

    def _draw_legend(self, legend: Legend) -> None:
        size = 11 * self._unit
        axes = self._figure.add_axes(self.where.legend)
        if legend.scale is None:
            names = tuple(legend.layers)
            patches = [
                Patch(
                    color=style.layer_colour(name, names), label=style.LAYER_LABELS.get(name, name)
                )
                for name in names
            ]
            columns = 3 if self.where.legend[2] > 0.3 else 1
            axes.legend(handles=patches, loc="center", ncols=columns, fontsize=size)
            axes.axis("off")
            return
        left, bottom, wide, high = self.where.legend
        axes.set_position((left, bottom + 0.6 * high, wide, 0.3 * high))
        bar = self._figure.colorbar(
            ScalarMappable(legend.scale, legend.colours), cax=axes, orientation="horizontal"
        )
        bar.ax.tick_params(labelsize=0.85 * size)
        bar.set_label(legend.label, size=size)

    def _texts(self, curves: Sequence[Curve]) -> tuple[Artist, list[Any]]:
        width, height = self.where.size
        size = 15 * self._unit
        if len(curves) == 1:
            x, y = self.where.caption
            self._figure.text(x, y + 0.07, curves[0].title, size=size, va="bottom")
            clock = self._figure.text(x, y, "", size=1.5 * size, va="bottom")
            captions = [self._figure.text(x, y - 0.035, "", size=0.85 * size, va="top")]
            return clock, captions
        clock = self._figure.text(0.02, 0.18, "", size=1.5 * size, va="center")
        captions = []
        for (left, top, wide, tall), curve in zip(self.where.panes, curves, strict=True):
            middle, upper = (left + wide / 2) / width, 1 - top / height
            self._figure.text(
                middle, upper - 0.03, curve.title, size=size, ha="center", va="top",
                color=curve.colour,
            )  # fmt: skip
            lower = 1 - (top + tall) / height
            captions.append(
                self._figure.text(middle, lower + 0.06, "", size=0.8 * size, ha="center", va="top")
            )
        return clock, captions

    def frame(
        self,
        images: Sequence[NDArray[np.uint8]],
        clock: float,
        places: Sequence[tuple[float, float]],
        captions: Sequence[Mapping[str, str]],
    ) -> NDArray[np.uint8]:
        """Return a frame, shape (height, width, 3).

        Args:
            images: The 3D image of each pane.
            clock: The t_n to be written.
            places: For each run the marker's t_n and D/r.
            captions: For each run its text, and "alarm" if it is to be red.
        """
        self._canvas.restore_region(self._background)
        for marker, (t_n, value) in zip(self._markers, places, strict=True):
            marker.set_data([t_n], [value])
        self._clock.set(text=f"$t_n$ = {clock:.4f}")
        for text, caption in zip(self._captions, captions, strict=True):
            text.set_text(caption["text"])
            text.set_color(ALARM if caption.get("alarm") else style.INK)
        for artist in self._moving:
            self._figure.draw_artist(artist)
        frame = np.asarray(self._canvas.buffer_rgba())[..., :3].copy()
        for (left, top, wide, tall), image in zip(self.where.panes, images, strict=True):
            pane = frame[top : top + tall, left : left + wide]
            # titles lie over the images, whose ground is white
            np.minimum(pane, image, out=pane)
        return frame
