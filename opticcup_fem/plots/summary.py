"""The picture of one run: its curves with events, its cross-sections at key times."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from opticcup_fem.plots import style
from opticcup_fem.plots.curves import draw_path, mark_events
from opticcup_fem.plots.sections import KeyState, bounds, draw_section, key_states
from opticcup_fem.records import SECTIONS, SUMMARY, read_events, read_path, read_sections

if TYPE_CHECKING:
    import pandas as pd

_NAMES = ("D_over_r", "lambda_iov")
_VISIBLE = 0.02
"""Amplitude (over R) of a wave on the interface that is shown."""


@style.styled
def summary(run_dir: str | Path) -> Path:
    """Draw summary.png from the records of a run, finished or not, and return its path.

    Args:
        run_dir: The run's folder, with path.csv and events.json; cross-sections are drawn where
            sections.npz is there.
    """
    run_dir = Path(run_dir)
    path = read_path(run_dir)
    events = [one for one in read_events(run_dir) if one.get("followed", True)]
    shown: list[KeyState] = []
    if (run_dir / SECTIONS).exists():
        shown = key_states(read_sections(run_dir), events)
    width = 9.0 + 2.5 * len(_wave(path))
    figure = Figure(figsize=(width, 5.9 if shown else 3.8), layout="constrained")
    if shown:
        upper, lower = figure.subfigures(2, 1, height_ratios=(1.65, 1.0))
        _draw_sections(lower, shown)
    else:
        upper = figure.subfigures(1, 1)
    _draw_curves(upper, path, events)
    return style.save(figure, run_dir / SUMMARY)


def _draw_curves(figure: SubFigure, path: "pd.DataFrame", events: Sequence[dict[str, Any]]) -> None:
    """Draw D/r, lambda_IOV and a wave's amplitude side by side, the events' legend below."""
    names = (*_NAMES, *_wave(path))
    panels = figure.subplots(1, len(names))
    for axes, name, colour in zip(panels, names, style.CURVES, strict=False):
        draw_path(axes, path, name, colour)
        mark_events(axes, path, name, events, style.INK)
        axes.set_xlim(left=0.0)
        axes.grid(color="#e6e6e6", linewidth=0.6)
    panels[0].set_ylim(bottom=0.0)
    handles, labels = panels[0].get_legend_handles_labels()
    if handles:
        figure.legend(
            handles, labels, loc="outside lower center", ncols=min(len(names), len(handles))
        )


def _wave(path: "pd.DataFrame") -> tuple[str, ...]:
    """Return the column of the largest wave on the interface of a cup that lost its symmetry."""
    waves = [f"interface_m{m}" for m in range(2, 9) if f"interface_m{m}" in path]
    if not waves or path[waves].max().max() < _VISIBLE:
        return ()
    return (str(path[waves].max().idxmax()),)


def _draw_sections(figure: SubFigure, shown: Sequence[KeyState]) -> None:
    """Draw the states in a row, all to one scale, with the layers' colours and a scale bar."""
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    boxes = [bounds(key.state) for key in shown]
    reach = max(box[0] for box in boxes)
    height = max(high - low for _, low, high in boxes)
    for axes, key, (_, low, _) in zip(panels, shown, boxes, strict=True):
        draw_section(axes, key.state)
        axes.set_xlim(-1.04 * reach, 1.04 * reach)
        # one scale, each shape standing on the same line: cups drift along z as they grow
        axes.set_ylim(low - 0.05 * height, low + 1.02 * height)
        axes.set_title(f"$t_n$ = {key.state.t_n:.4f}")
        why = key.why.replace(" ", "\n", 1)
        axes.text(0.5, -0.03, why, transform=axes.transAxes, ha="center", va="top", fontsize=8)
    _scale_bar(panels[0], (boxes[0][1] + boxes[0][2]) / 2)
    part_layers = [part.layers for part in shown[0].state.sections[0].parts.values()]
    layers = tuple(dict.fromkeys(name for names in part_layers for name in reversed(names)))
    figure.legend(
        handles=style.layer_handles(layers), loc="outside lower center", ncols=len(layers)
    )


def _scale_bar(axes: Axes, z: float) -> None:
    """Draw a bar of length R across the axis, in the hollow of the first shape."""
    axes.plot([-0.5, 0.5], [z, z], color=style.INK, linewidth=1.4)
    axes.text(0.0, z, "$R$", ha="center", va="bottom")
