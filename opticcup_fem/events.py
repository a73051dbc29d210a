"""Events on a path of equilibria: invaginations, loss of symmetry, and why a run ended.

Only the rows of a path are used, so every solver that records them shares these definitions
(docs/theory.md, "Events").  Rows may be irregular in t_n; a row with ``jump`` true starts a new
branch.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, PchipInterpolator, make_interp_spline

from opticcup_fem.snapshot import Floats

KINDS = (
    "primary_invagination",
    "secondary_invagination",
    "symmetry_breaking",
    "closure_breakdown",
    "self_contact",
    "limit_point",
    "symmetry_regained",
)

ASYMMETRY_THRESHOLD = 1e-4
"""A state with more is not axisymmetric: about 0.014 R r.m.s. away from it, a thousand times what
an unsymmetric mesh of ordinary fineness causes."""

_BENT, _THROWN = 30.0, 10.0
"""Asymmetry over the threshold up to which a state is only bent by imperfections, and the growth of
asymmetry over a jump that makes the jump the loss of symmetry."""

_TIME_SCALE = 0.1
"""t_n that counts as much as one R of apex height along the path (t_n, c)."""

_MIN_SPACING = 0.1
"""Rows nearer than this along the path are thinned, so that rounding is not differentiated."""

_MIN_DESCENT = 0.005
"""A descent of the apex by less (over R) is no event."""

_EASED = 0.7
"""A fastest descent counts once dc/dt_n has eased to this share of it: while the apex still speeds
up, a limit point may be ahead."""

Event = dict[str, Any]
Row = Mapping[str, Any]


def event(kind: str, kind_type: str, t_n: float, kappa_cap_R: float, **fields: Any) -> Event:
    """Return an event as it is recorded.

    Args:
        kind: One of `KINDS`.
        kind_type: How it happens: "fold", "smooth", "jump", or the name of a closure or contact.
        t_n: Normalised time.
        kappa_cap_R: Natural curvature of the cap times R at that time.
        fields: More, for example ``wavenumber``.

    Raises:
        ValueError: The kind is unknown.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown kind of event {kind!r}; the kinds are {', '.join(KINDS)}")
    return {"kind": kind, "type": kind_type, "t_n": t_n, "kappa_cap_R": kappa_cap_R} | fields


def detect_events(
    rows: Sequence[Row],
    recorded: Iterable[Event] = (),
    *,
    curvature: Callable[[float], float] | None = None,
    asymmetry_threshold: float = ASYMMETRY_THRESHOLD,
) -> list[Event]:
    """Find the events of a path.

    Args:
        rows: The path's rows in order, with at least ``t_n``, ``apex_height_over_R``,
            ``D_over_r``, ``kappa_cap_R``; ``jump`` and ``asymmetry`` where the run has them.
        recorded: Events that the run itself knows (self contact, breakdown, a bifurcation that it
            has localised); they replace what the rows show of the same kind.
        curvature: kappa_cap R as a function of t_n; else interpolated in the rows.
        asymmetry_threshold: Asymmetry of states that are not axisymmetric; from the loss of
            symmetry on the rows are not searched for invaginations.

    Returns:
        Events ordered by t_n.  Those found here carry ``t_n_range``, the rows that enclose them.
    """
    recorded = list(recorded)
    found: list[Event] = []
    if rows:
        kappa = curvature or _interpolated_curvature(rows)
        broken = _loss_of_symmetry(rows, asymmetry_threshold)
        if broken is not None:
            found.append(_symmetry_breaking(rows, broken, kappa))
        found += _invaginations(rows[:broken], kappa)
    known = {e["kind"] for e in recorded}
    return sorted(
        [*recorded, *(e for e in found if e["kind"] not in known)], key=lambda e: e["t_n"]
    )


def with_limit_points(events: Iterable[Event]) -> list[Event]:
    """Return the events with each localised limit point in place of the fold that it explains.

    A fall of the apex over a jump takes time, wavenumber and eigenvalues of the limit point inside
    its ``t_n_range``; limit points that let nothing fall stay events of their own.

    Args:
        events: Events ordered by t_n.
    """
    events = list(events)
    limits = [one for one in events if one["kind"] == "limit_point"]
    merged = []
    for one in events:
        if one["type"] == "fold" and one["kind"] != "limit_point" and "t_n_range" in one:
            low, high = one["t_n_range"]
            inside = next((other for other in limits if low <= other["t_n"] <= high), None)
            if inside is not None:
                limits.remove(inside)
                one = {**one, **inside, "kind": one["kind"]}
        merged.append(one)
    kept = [one for one in merged if one["kind"] != "limit_point" or one in limits]
    return sorted(kept, key=lambda one: float(one["t_n"]))


def _interpolated_curvature(rows: Sequence[Row]) -> Callable[[float], float]:
    t_n, first = np.unique([float(row["t_n"]) for row in rows], return_index=True)
    kappa = np.array([float(rows[i]["kappa_cap_R"]) for i in first])
    if len(t_n) < 2:
        return lambda _: float(kappa[0])
    curve = PchipInterpolator(t_n, kappa)
    return lambda t: float(curve(np.clip(t, t_n[0], t_n[-1])))


def _loss_of_symmetry(rows: Sequence[Row], threshold: float) -> int | None:
    """Return the first row that is no longer axisymmetric, None if all are.

    An imperfect mesh bends slightly out of symmetry before a subcritical bifurcation throws the
    shell far away from it.  The event is then the throw, not the bending before it.  A fall of the
    apex that carries such a bend a little over the threshold is no loss of symmetry either: one
    after it counts from `_THROWN` times the asymmetry that it left.
    """
    asymmetry = [float(row.get("asymmetry", 0.0)) for row in rows]
    first = next((i for i, value in enumerate(asymmetry) if value > threshold), None)
    if first is None:
        return None
    fell = first > 0 and rows[first].get("jump", False) and _drops(rows, first)
    carried = _THROWN * asymmetry[first - 1] if fell else 0.0
    if asymmetry[first] <= min(carried, _BENT * threshold):
        return _loss_of_symmetry(rows, _THROWN * asymmetry[first])
    for i in range(max(first, 1), len(rows)):
        if asymmetry[i - 1] > _BENT * threshold:
            return first
        if rows[i].get("jump", False) and asymmetry[i] > _THROWN * asymmetry[i - 1]:
            return i
    return first


def _symmetry_breaking(rows: Sequence[Row], at: int, kappa: Callable[[float], float]) -> Event:
    """Return the loss of symmetry before row `at`, with the wavenumber that the row shows."""
    row = rows[at]
    low = float(rows[max(at - 1, 0)]["t_n"])
    high = float(row["t_n"])
    t_n = (low + high) / 2
    amplitudes = {m: row.get(f"interface_m{m}", 0.0) for m in range(1, 9)}
    wavenumber = max(amplitudes, key=lambda m: float(amplitudes[m]))
    fields = {"wavenumber": wavenumber} if amplitudes[wavenumber] else {}
    kind_type = "jump" if row.get("jump", False) else "smooth"
    return event("symmetry_breaking", kind_type, t_n, kappa(t_n), t_n_range=[low, high], **fields)


@dataclass(frozen=True)
class _Descent:
    """A fall of the apex: its time, "fold" or "smooth", the rows' times around it, D/r after."""

    t_n: float
    kind_type: str
    t_n_range: tuple[float, float]
    depth_after: float


def _invaginations(rows: Sequence[Row], kappa: Callable[[float], float]) -> list[Event]:
    """Return the first and second fall of the apex, from the first that leaves a dimple on."""
    falls = _falls(rows)
    while falls and falls[0].depth_after <= 0:
        falls.pop(0)
    kinds = ("primary_invagination", "secondary_invagination")
    return [
        event(kind, fall.kind_type, fall.t_n, kappa(fall.t_n), t_n_range=list(fall.t_n_range))
        for kind, fall in zip(kinds, falls, strict=False)
    ]


def _falls(rows: Sequence[Row]) -> list[_Descent]:
    """Return all falls of the apex, in order: fastest descents on branches, drops between them."""
    starts = [i for i, row in enumerate(rows) if i and row.get("jump", False)]
    falls: list[_Descent] = []
    for start, stop in zip([0, *starts], [*starts, len(rows)], strict=True):
        if start:
            falls += _drop(rows, start)
        after_drop = start > 0 and _drops(rows, start)
        before_drop = stop < len(rows) and _drops(rows, stop)
        falls += _fastest_descents(rows[start:stop], after_drop=after_drop, before_drop=before_drop)
    return falls


def _column(rows: Sequence[Row], name: str) -> Floats:
    return np.array([float(row[name]) for row in rows])


def _drops(rows: Sequence[Row], at: int) -> bool:
    c = _column(rows[at - 1 : at + 1], "apex_height_over_R")
    return bool(c[0] - c[1] > _MIN_DESCENT)


def _drop(rows: Sequence[Row], at: int) -> list[_Descent]:
    """Return the fall over the jump before row `at`, if it is one.

    The limit point lies between the two rows; extrapolating the square root by which the apex
    approaches it was tried on whole paths and is no better than the middle of the two.
    """
    if not _drops(rows, at):
        return []
    low, high = float(rows[at - 1]["t_n"]), float(rows[at]["t_n"])
    return [_Descent((low + high) / 2, "fold", (low, high), float(rows[at]["D_over_r"]))]


def _fastest_descents(
    branch: Sequence[Row], *, after_drop: bool, before_drop: bool
) -> list[_Descent]:
    """Return the points of fastest descent of one branch.

    t_n and c are interpolated along the path's arc length (quintic splines), which follows a
    steep smooth descent where c(t_n) itself could not be interpolated.

    Args:
        branch: Rows without jumps.
        after_drop: Whether the apex fell over the jump before the branch; a descent at once after
            it belongs to that fall.
        before_drop: The same at the end of the branch.
    """
    branch = _thinned(branch)
    if len(branch) < 4:
        return []
    t, c, depth = (_column(branch, name) for name in ("t_n", "apex_height_over_R", "D_over_r"))
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(t) / _TIME_SCALE, np.diff(c)))])
    degree = 5 if len(branch) > 5 else 3
    t_of, c_of = (make_interp_spline(arc, x, k=degree) for x in (t, c))
    s = np.linspace(0.0, arc[-1], 64 * len(branch))
    falling = np.concatenate([[False], c_of(s, 1) < 0, [False]])
    starts, stops = np.flatnonzero(np.diff(falling)).reshape(-1, 2).T
    falls = []
    for start, stop in zip(starts, stops, strict=True):
        of_a_drop = (after_drop and start == 0) or (before_drop and stop == len(s))
        fast = None if of_a_drop else _fastest(t_of, c_of, s[start:stop])
        if fast is not None and c_of(s[start]) - c_of(s[stop - 1]) > _MIN_DESCENT:
            after = int(np.searchsorted(arc, fast))
            until = int(np.searchsorted(arc, s[stop - 1]))
            # in the last interval the spline may bend as it likes
            if after < len(arc) - 1:
                around = (float(t[after - 1]), float(t[after]))
                deepest = float(depth[after : until + 1].max())
                falls.append(_Descent(float(t_of(fast)), "smooth", around, deepest))
    return falls


def _thinned(branch: Sequence[Row]) -> list[Row]:
    """Return rows at least `_MIN_SPACING` apart along the path; the last one stays."""
    kept: list[Row] = []
    for row in branch:
        if len(kept) > 1 and _spacing(kept[-1], row) < _MIN_SPACING and row is not branch[-1]:
            continue
        kept.append(row)
    if len(kept) > 2 and _spacing(kept[-2], kept[-1]) < _MIN_SPACING:
        kept.pop(-2)
    return kept


def _spacing(first: Row, second: Row) -> float:
    t = (float(second["t_n"]) - float(first["t_n"])) / _TIME_SCALE
    c = float(second["apex_height_over_R"]) - float(first["apex_height_over_R"])
    return float(np.hypot(t, c))


def _fastest(t_of: BSpline, c_of: BSpline, s: Floats) -> float | None:
    """Return the arc length of the least dc/dt_n inside a descent, None if it lies on its end."""
    # a spline through nearly vertical rows may turn back in t_n by a hair
    speed = c_of(s, 1) / np.maximum(t_of(s, 1), 1e-6)
    at = int(np.argmin(speed))
    if at in (0, len(s) - 1) or speed[-1] < _EASED * speed[at]:
        return None
    return float(s[at])
