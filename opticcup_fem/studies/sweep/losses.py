"""Where a cup that follows an axisymmetric path first loses its symmetry."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from opticcup_fem.meridian.crossings import crossings
from opticcup_fem.meridian.path import MeridianPath, MeridianPoint
from opticcup_fem.meridian.waves import Waves


@dataclass(frozen=True)
class Loss:
    """A loss of axisymmetric stability on the followed part.

    Attributes:
        t_n: Normalised time.
        wavenumber: m of the mode that is lost first.
        by_jump: Whether the cup falls onto a state that is unstable already.
    """

    t_n: float
    wavenumber: int
    by_jump: bool


def first_loss(
    path: MeridianPath, points: Sequence[MeridianPoint], waves: Waves, after: float = -1.0
) -> Loss | None:
    """Return the first loss at t_n above ``after``; spectra are computed up to it only.

    Args:
        path: The path; its ``waves`` are replaced by ``waves``.
        points: Its points, in order.
        waves: Second variations in the wavenumbers that count, none of them 0.
        after: Where to begin; a part that is unstable there already is lost there.
    """
    path.waves = waves
    for branch in _branches(points):
        last: MeridianPoint | None = None
        for bare in branch:
            if bare.t_n < after:
                continue
            point = replace(bare, spectra=waves.spectra(bare.state, bare.t_n))
            unstable = [m for m, count in point.negative.items() if count]
            if unstable and (last is None or any(last.negative.values())):
                softest = min(unstable, key=lambda m: point.spectra[m].nearest)
                return Loss(point.t_n, softest, True)
            if unstable and last is not None:
                lost = [one for one in crossings(path, [last, point]) if one.lost]
                if lost:
                    first = min(lost, key=lambda one: one.t_n)
                    return Loss(first.t_n, first.wavenumber, False)
            last = point
    return None


def _branches(points: Sequence[MeridianPoint]) -> Iterator[list[MeridianPoint]]:
    """Yield the followed points between jumps."""
    branch: list[MeridianPoint] = []
    for point in points:
        if point.jump and branch:
            yield branch
            branch = []
        if point.followed:
            branch.append(point)
    if branch:
        yield branch
