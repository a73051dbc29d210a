"""The picture of a whole path: stable and unstable parts, every event, the critical mode."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from opticcup_fem.plots import style
from opticcup_fem.plots.curves import by_stability
from opticcup_fem.records import BIFURCATION, MODES, read_events, read_path

if TYPE_CHECKING:
    import pandas as pd

_NAMES = ("D_over_r", "apex_height_over_R")
_BUMP = 0.12
"""Largest displacement of the drawn mode, over the largest radius."""


@style.styled
def bifurcation(run_dir: str | Path) -> Path:
    """Draw bifurcation.png from the records of a run on the meridian model; return its path.

    Args:
        run_dir: The run's folder, with path.csv and events.json; the critical mode is drawn where
            modes.npz is there.
    """
    run_dir = Path(run_dir)
    path, events = read_path(run_dir), read_events(run_dir)
    mode = _first_loss(run_dir)
    figure = Figure(figsize=(12.5 if mode else 9.0, 5.2), layout="constrained")
    ratios = (1.0, 1.0, 0.9) if mode else (1.0, 1.0)
    grid = figure.add_gridspec(1, len(ratios), width_ratios=ratios)
    for i, name in enumerate(_NAMES):
        _draw_panel(figure.add_subplot(grid[0, i]), path, events, name)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    if mode is not None:
        _draw_mode(figure.add_subplot(grid[0, 2], projection="3d"), mode)
    return style.save(figure, run_dir / BIFURCATION)


def _draw_panel(
    axes: Axes, path: pd.DataFrame, events: Sequence[dict[str, Any]], name: str
) -> None:
    labelled: set[bool] = set()
    for part, kind in by_stability(path):
        label = "" if kind in labelled else ("stable" if kind else "unstable")
        labelled.add(kind)
        line = "-" if kind else (0, (3, 1.5))
        colour = style.CURVES[0] if kind else style.CURVES[1]
        axes.plot(part["t_n"], part[name], linestyle=line, color=colour, label=label)
    for number, one in enumerate(_on_path(events), start=1):
        marker, label = style.EVENT_MARKERS[one["kind"]]
        wave = f", m = {one['wavenumber']}" if "wavenumber" in one else ""
        value = float(np.interp(one["arc_length"], path["arc_length"], path[name]))
        axes.plot(
            [one["t_n"]],
            [value],
            linestyle="none",
            marker=marker,
            markersize=7,
            markerfacecolor="white",
            markeredgecolor=style.INK,
            zorder=5,
            clip_on=False,
            label=f"{number}  {label} ({one['type']}{wave}), $t_n$ = {one['t_n']:.4f}",
        )
        # neighbours have their numbers on different sides
        side = 1 if number % 2 else -1
        axes.annotate(
            str(number),
            (one["t_n"], value),
            (6 * side, 8 * side),
            textcoords="offset points",
            ha="left" if side > 0 else "right",
            va="center",
            fontsize=8,
            zorder=6,
        )
    _scale_time(axes, path["t_n"].to_numpy())
    axes.set_xlabel(style.SYMBOLS["t_n"])
    axes.set_ylabel(style.SYMBOLS[name])
    axes.grid(color="#e6e6e6", linewidth=0.6)


def _on_path(events: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the events that have a place on the path, in its order."""
    placed = [one for one in events if "arc_length" in one]
    return sorted(placed, key=lambda one: float(one["arc_length"]))


def _scale_time(axes: Axes, t_n: NDArray[np.float64]) -> None:
    """Scale t_n by its root: the many events of slender cups come early."""
    axes.set_xscale(
        "function",
        functions=(lambda t: np.sign(t) * np.sqrt(np.abs(t)), lambda x: np.sign(x) * x**2),
    )
    low, high = min(0.0, float(t_n.min())), float(t_n.max())
    axes.set_xlim(low, high)
    marks = np.array([-0.1, -0.05, 0.0, 0.01, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0])
    shown = marks[(marks >= low) & (marks <= high)]
    axes.set_xticks(shown, [f"{t:g}" for t in shown])


def _first_loss(run_dir: Path) -> dict[str, NDArray[Any]] | None:
    """Return the first critical mode on the followed part, else the first at all."""
    if not (run_dir / MODES).exists():
        return None
    with np.load(run_dir / MODES) as file:
        arrays = dict(file)
    order = np.lexsort((arrays["t_n"], ~arrays["lost"], ~arrays["followed"]))
    first = order[0]
    shared = ("theta", "interface")
    return {name: a if name in shared else a[first] for name, a in arrays.items()}


def _draw_mode(axes: Any, mode: dict[str, NDArray[Any]]) -> None:
    """Draw the state moved along its mode, coloured by the displacement, seen from above."""
    r, z = mode["position"].T
    m = int(mode["wavenumber"])
    phi = np.linspace(0.0, 2 * np.pi, 97)[:, None]
    scale = _BUMP * r.max() / np.abs(mode["amplitude"]).max()
    u = scale * mode["amplitude"]
    radial = r + u[:, 0] * np.cos(m * phi)
    turn = u[:, 1] * np.sin(m * phi)
    x = radial * np.cos(phi) - turn * np.sin(phi)
    y = radial * np.sin(phi) + turn * np.cos(phi)
    height = z + u[:, 2] * np.cos(m * phi)
    size = np.sqrt((u[:, 0] * np.cos(m * phi)) ** 2 + turn**2 + (height - z) ** 2)
    colours = colormaps["viridis"](Normalize(0.0, float(size.max()))(size))
    axes.plot_surface(
        x, y, height, facecolors=colours, rstride=1, cstride=1, linewidth=0, shade=True
    )
    edge = int(np.argmin(np.abs(mode["theta"] - mode["interface"])))
    axes.plot(x[:, edge], y[:, edge], height[:, edge], color=style.INK, linewidth=1.0, zorder=9)
    axes.set_box_aspect((np.ptp(x), np.ptp(y), np.ptp(height)))
    axes.view_init(elev=42, azim=-60)
    axes.set_axis_off()
    axes.set_title(f"critical mode m = {m} at $t_n$ = {float(mode['t_n']):.4f}")
