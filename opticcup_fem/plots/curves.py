"""Observables against t_n: branches apart, jumps dashed, events marked."""

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from opticcup_fem.plots import style

if TYPE_CHECKING:
    import pandas as pd

UNSTABLE = (0, (1, 1.2))
"""Dashes of what is not stable."""


def branches(path: "pd.DataFrame") -> "list[pd.DataFrame]":
    """Return the path cut before every row that follows a jump.

    Of a whole path, with its unstable parts, only what a cup follows.
    """
    if "followed" in path:
        path = path[path["followed"].astype(bool)]
    number = path["jump"].astype(bool).cumsum() if "jump" in path else path["t_n"] * 0
    return [branch for _, branch in path.groupby(number, sort=True)]


def draw_path(axes: Axes, path: "pd.DataFrame", name: str, colour: str, label: str = "") -> None:
    """Draw one column against t_n: lines along branches, a dashed line over each jump.

    States that are not stable are drawn thin and dotted: no tissue would take them.
    """
    parts = branches(path)
    for k, branch in enumerate(parts):
        for part, stable in by_stability(branch):
            first = k == 0 and part.index[0] == branch.index[0]
            (line,) = axes.plot(part["t_n"], part[name], color=colour, label=label if first else "")
            if not stable:
                line.set(linestyle=UNSTABLE, linewidth=1.0)
    for before, after in pairwise(parts):
        ends = [before.iloc[-1], after.iloc[0]]
        t, y = ([float(row[key]) for row in ends] for key in ("t_n", name))
        axes.plot(t, y, color=colour, linewidth=0.9, linestyle=(0, (2, 2)))
    axes.set_xlabel(style.SYMBOLS["t_n"])
    axes.set_ylabel(style.SYMBOLS.get(name, name))


def by_stability(branch: "pd.DataFrame") -> "list[tuple[pd.DataFrame, bool]]":
    """Return the parts of a branch of one stability, each up to the first row of the next."""
    if "stable" not in branch:
        return [(branch, True)]
    stable = branch["stable"].to_numpy(dtype=bool)
    ends = [0, *(np.flatnonzero(stable[1:] != stable[:-1]) + 1), len(branch)]
    return [(branch.iloc[a : b + 1], bool(stable[a])) for a, b in pairwise(ends)]


def place_of(path: "pd.DataFrame", name: str, event: dict[str, Any]) -> tuple[float, float]:
    """Return t_n and a column's value at an event: before a jump, the branch's last state.

    An event that knows the row behind it lies between that row and the one before.
    """
    t_n = float(event["t_n"])
    row = event.get("row")
    if row is not None and 0 < row < len(path) and not bool(path["jump"].iloc[row]):
        ends = path.iloc[[row - 1, row]].sort_values("t_n")
        return t_n, float(np.interp(t_n, ends["t_n"], ends[name]))
    if row is not None and 0 < row <= len(path):
        last = path.iloc[row - 1]
        return float(last["t_n"]), float(last[name])
    before = [b for b in branches(path) if float(b["t_n"].iloc[0]) <= t_n]
    on = before[-1] if before else path
    return min(t_n, float(on["t_n"].iloc[-1])), float(np.interp(t_n, on["t_n"], on[name]))


def mark_events(
    axes: Axes, path: "pd.DataFrame", name: str, events: Sequence[dict[str, Any]], colour: str
) -> None:
    """Put each event's marker on the curve of one column, labelled with kind, type and t_n."""
    for event in events:
        if not event.get("followed", True):
            continue
        marker, _ = style.EVENT_MARKERS[event["kind"]]
        t_n, value = place_of(path, name, event)
        axes.plot(
            [t_n],
            [value],
            linestyle="none",
            clip_on=False,
            marker=marker,
            markersize=8,
            markerfacecolor="white",
            markeredgecolor=colour,
            markeredgewidth=1.4,
            zorder=5,
            label=style.event_label(event),
        )
