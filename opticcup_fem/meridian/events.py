"""The events of an axisymmetric path, with its exact slopes, limit points and crossings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from scipy.optimize import minimize_scalar

from opticcup_fem.equilibrium.continuation import PathState
from opticcup_fem.events import Event, detect_events, event
from opticcup_fem.meridian.crossings import Crossing
from opticcup_fem.meridian.path import MeridianPath, MeridianPoint

Curvature = Callable[[float], float]


def path_events(
    path: MeridianPath,
    points: Sequence[MeridianPoint],
    rows: Sequence[Mapping[str, Any]],
    found: Sequence[Crossing],
    curvature: Curvature,
) -> list[Event]:
    """Return the events of a path, ordered by t_n.

    Invaginations are those of the part that a cup follows (``opticcup_fem.events``); a fold is
    placed at its limit point, a smooth descent where dc/dt_n is least; a flat disc has none.
    Other limit points and all crossings of eigenvalues are events of their own.

    Args:
        path: The path.
        points: Its points, in order.
        rows: Their rows, with the columns that ``detect_events`` needs.
        found: The crossings of eigenvalues.
        curvature: kappa_cap R as a function of t_n.
    """
    pairs = [(point, row) for point, row in zip(points, rows, strict=True) if point.followed]
    followed = [point for point, _ in pairs]
    is_curved = path.problem.shell.mesh.profile.curvature != 0
    events = [
        _sharpened(one, path, followed, curvature)
        for one in detect_events([row for _, row in pairs], curvature=curvature)
        if is_curved
    ]
    taken = {one["t_n"] for one in events}
    events += [
        event(
            "limit_point",
            "fold",
            point.t_n,
            curvature(point.t_n),
            followed=False,
            arc_length=point.path.arc,
        )
        for point in points
        if point.path.is_fold and point.t_n not in taken
    ]
    events += [_of_crossing(one, curvature) for one in found]
    return sorted(events, key=lambda one: one["t_n"])


def _of_crossing(one: Crossing, curvature: Curvature) -> Event:
    kind = "symmetry_breaking" if one.lost else "symmetry_regained"
    return event(
        kind,
        "bifurcation",
        one.t_n,
        curvature(one.t_n),
        wavenumber=one.wavenumber,
        followed=one.followed,
        arc_length=one.arc,
    )


def _sharpened(
    one: Event, path: MeridianPath, followed: Sequence[MeridianPoint], curvature: Curvature
) -> Event:
    """Return an invagination at its exact t_n."""
    low, high = one["t_n_range"]
    if one["type"] == "fold":
        at = next(p.path for p in followed if p.path.is_fold and low <= p.t_n <= high)
    else:
        at = _fastest_descent(path, followed, one["t_n"])
    return {**one, "t_n": at.t, "kappa_cap_R": curvature(at.t), "arc_length": at.arc}


def _fastest_descent(
    path: MeridianPath, followed: Sequence[MeridianPoint], near: float
) -> PathState:
    """Return the state of least dc/dt_n near a time: among the points, then between two."""

    def speed(solution: PathState) -> float:
        rate = path.problem.unpack(solution.dx).r[:, 1]
        return float((rate[0] - rate[-1]) / solution.dt)

    at = min(range(len(followed)), key=lambda i: abs(followed[i].t_n - near))
    window = [p for p in followed[max(at - 4, 0) : at + 5] if not p.path.is_fold]
    least = min(range(len(window)), key=lambda i: speed(window[i].path))
    best = window[least].path
    for low, high in pairwise(window[max(least - 1, 0) : least + 2]):

        def at_share(share: float, low: MeridianPoint = low, high: MeridianPoint = high) -> float:
            return speed(path.point_between(low, high, share)[0])

        result = minimize_scalar(
            at_share, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-3}
        )
        if result.fun < speed(best):
            best = path.point_between(low, high, float(result.x))[0]
    return best
