"""What a figure of the report is, and what the figures share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from opticcup_fem.plots import style

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]
Row = Mapping[str, Any]

EVENT_COLOURS = {
    "primary_invagination": style.INK,
    "secondary_invagination": style.CURVES[2],
    "symmetry_breaking": style.CURVES[1],
}
REGION_COLOURS = {"invaginated": "#cfe3f3", "normal": "#d3ecd9", "abnormal": "#f8d7c4"}
"""Light blue, green and red, after the letter's Fig. 4, told apart by lightness too."""

GRID = "#e6e6e6"


@dataclass(frozen=True)
class Comparison:
    """One line of the table "paper | this code | difference".

    Attributes:
        quantity: What is compared.
        paper: The paper's value, a number or words, None where it has none.
        ours: Ours.
        note: What to know about it.
    """

    quantity: str
    paper: float | str | None
    ours: float | str | None
    note: str = ""

    @property
    def difference(self) -> str:
        """Ours less the paper's, and in percent; words where there are no two numbers."""
        if isinstance(self.paper, str) and isinstance(self.ours, str):
            return "agrees" if self.paper == self.ours else "differs"
        if isinstance(self.paper, float) and isinstance(self.ours, float):
            change = self.ours - self.paper
            percent = f" ({100 * change / abs(self.paper):+.1f} %)" if self.paper else ""
            return f"{change:+.3g}{percent}"
        return ""


@dataclass(frozen=True)
class Drawn:
    """A figure with what stands behind it.

    Attributes:
        name: Its name, also of its files.
        title: Its title.
        text: Paragraphs below it.
        figure: The picture.
        tables: Tables behind it, by file name without ending.
        comparisons: Lines for the table of the report.
        shown: Tables to print in the report, by heading.
    """

    name: str
    title: str
    text: Sequence[str]
    figure: Figure
    tables: Mapping[str, pd.DataFrame]
    comparisons: Sequence[Comparison] = ()
    shown: Mapping[str, pd.DataFrame] = field(default_factory=dict)


def followed_parts(path: Mapping[str, Sequence[Any]]) -> Iterator[dict[str, Array]]:
    """Yield the columns of the parts of a path that a cup follows, between jumps.

    A part that a fall leads to begins at the time of the fall, between the computed states.
    """
    followed, jump = np.array(path["followed"], bool), np.array(path["jump"], bool)
    chosen = np.flatnonzero(followed)
    starts = [0, *(i for i in range(1, len(chosen)) if jump[chosen[i]]), len(chosen)]
    columns = {
        name: np.array(path[name], float) for name in path if name not in ("followed", "jump")
    }
    for start, stop in pairwise(starts):
        part = chosen[start:stop]
        if not len(part):
            continue
        found = {name: values[part] for name, values in columns.items()}
        first = part[0]
        fall = columns["t_n"][chosen[start - 1]] if start else np.inf
        before, after = columns["t_n"][first - 1], columns["t_n"][first]
        if before < fall < after:
            share = (fall - before) / (after - before)
            for name, values in columns.items():
                landing = values[first - 1] + share * (values[first] - values[first - 1])
                found[name] = np.concatenate([[landing], found[name]])
        yield found


def draw_path(
    axes: Axes,
    path: Mapping[str, Sequence[Any]],
    name: str,
    until: float | None = None,
    **line: Any,
) -> None:
    """Draw a column against t_n, dotted over jumps and, thin, beyond a time ``until``."""
    label = line.pop("label", "")
    last: tuple[float, float] | None = None
    for part in followed_parts(path):
        t, y = part["t_n"], part[name]
        if last is not None:
            axes.plot([last[0], t[0]], [last[1], y[0]], **line | {"lw": 0.7, "ls": ":"})
        stop = len(t) if until is None else int(np.searchsorted(t, until)) + 1
        if stop > 1:
            axes.plot(t[:stop], y[:stop], label=label, **line)
            label = ""
        if stop < len(t):
            axes.plot(
                t[max(stop - 1, 0) :], y[max(stop - 1, 0) :], **line | {"lw": 0.6, "ls": "--"}
            )
        last = (float(t[-1]), float(y[-1]))


def mark(axes: Axes, x: float, y: float, kind: str, colour: str, size: float = 5.5) -> None:
    """Put an event's marker."""
    axes.plot(
        [x],
        [y],
        linestyle="none",
        marker=style.EVENT_MARKERS[kind][0],
        markersize=size,
        markerfacecolor="white",
        markeredgecolor=colour,
        markeredgewidth=1.2,
        zorder=5,
        clip_on=False,
    )


def event_handles(kinds: Sequence[str], colours: Mapping[str, str]) -> list[Any]:
    """Return legend handles of kinds of events."""
    from matplotlib.lines import Line2D

    return [
        Line2D(
            [],
            [],
            linestyle="none",
            marker=style.EVENT_MARKERS[kind][0],
            markerfacecolor="white",
            markeredgecolor=colours[kind],
            markeredgewidth=1.2,
            label=style.EVENT_MARKERS[kind][1],
        )
        for kind in kinds
    ]


def cross_handle(label: str, marker: str = "x") -> Any:
    """Return the legend handle of a cross where something ends."""
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="none", marker=marker, color=style.INK, label=label)


def shades(count: int) -> list[Any]:
    """Return ordered colours that stay distinct for the colour-blind and in grey."""
    return [colormaps["viridis"](x) for x in np.linspace(0.0, 0.88, count)]


def labelled(axes: Axes, x: str, y: str, letter: str = "") -> None:
    """Set the labels, a light grid, and the panel's letter."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(color=GRID, linewidth=0.6)
    if letter:
        axes.set_title(f"({letter})", loc="left")
