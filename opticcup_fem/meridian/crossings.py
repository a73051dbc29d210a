"""Where eigenvalues of a wavenumber cross zero between two states of a path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from scipy.optimize import brentq

from opticcup_fem.errors import OpticCupError
from opticcup_fem.meridian.path import MeridianPath, MeridianPoint
from opticcup_fem.meridian.shell import MeridianState
from opticcup_fem.meridian.waves import Mode


@dataclass(frozen=True)
class Crossing:
    """An eigenvalue of a wavenumber vanishes.

    Attributes:
        t_n: Normalised time.
        wavenumber: m.
        lost: Whether stability against the mode is lost along the path, or regained.
        followed: Whether it lies on the part of the path that a cup follows.
        state: The state there.
        mode: The critical mode.
        arc: Arc length along the path.
    """

    t_n: float
    wavenumber: int
    lost: bool
    followed: bool
    state: MeridianState
    mode: Mode
    arc: float


def crossings(
    path: MeridianPath, points: Sequence[MeridianPoint], tolerance: float = 1e-6
) -> list[Crossing]:
    """Return all crossings between neighbouring points, in their order along the path.

    In m = 0 the limit points, which the path holds itself, are not repeated.  Where no state
    between two points can be solved for, t_n is interpolated and the first one's mode is given.

    Args:
        path: The path.
        points: Its points, in order.
        tolerance: Accuracy in t_n.
    """
    found = []
    for low, high in pairwise(points):
        for m in path.waves.wavenumbers:
            if m == 0 and (low.path.is_fold or high.path.is_fold):
                continue
            first, last = sorted((low.negative[m], high.negative[m]))
            for index in range(first, last):
                found.append(_localised(path, low, high, m, index, tolerance))
    return sorted(found, key=lambda crossing: crossing.arc)


def _localised(
    path: MeridianPath,
    low: MeridianPoint,
    high: MeridianPoint,
    m: int,
    index: int,
    tolerance: float,
) -> Crossing:
    """Return where the eigenvalue of a given place in the order crosses zero."""

    def eigenvalue(state: MeridianState, t_n: float) -> float:
        return path.waves.eigenvalue(state, t_n, m, index)

    def at(share: float) -> float:
        solution, state = path.point_between(low, high, share)
        return eigenvalue(state, solution.t)

    # t_n may change little near a limit point
    width = max(abs(high.t_n - low.t_n), 1e-2 * (high.path.arc - low.path.arc))
    try:
        share = float(brentq(at, 0.0, 1.0, xtol=tolerance / width))
        solution, state = path.point_between(low, high, share)
        t_n, arc = solution.t, solution.arc
    except OpticCupError:
        # where many modes become critical together no state between the two can be solved for
        ends = [eigenvalue(point.state, point.t_n) for point in (low, high)]
        share = ends[0] / (ends[0] - ends[1])
        t_n = low.t_n + share * (high.t_n - low.t_n)
        arc = low.path.arc + share * (high.path.arc - low.path.arc)
        state = low.state
    (mode,) = path.waves.modes(state, t_n, m)
    return Crossing(
        t_n,
        m,
        high.negative[m] > low.negative[m],
        low.followed and high.followed,
        state,
        mode,
        arc,
    )
