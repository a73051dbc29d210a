"""Where a buckled and a round cup exist side by side, and where they have the same energy."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

Row = Mapping[str, Any]


def equal_energy(rows: Iterable[Row]) -> float | None:
    """Return the R/h beyond which the slit has less energy, by linear interpolation.

    Args:
        rows: ``ratio`` R/h and ``excess``, the slit's energy over the round cup's less 1 (None
            where one of them is missing), at one time.

    Returns:
        None where the sign does not change.
    """
    known = sorted((float(r["ratio"]), float(r["excess"])) for r in rows if r["excess"] is not None)
    for (thick, above), (slender, below) in pairwise(known):
        if above >= 0 > below:
            return thick + (slender - thick) * above / (above - below)
    return None


def thickest_slit(rows: Iterable[Row]) -> float | None:
    """Return the smallest R/h at which the slit is found, None where it is nowhere."""
    return min((float(r["ratio"]) for r in rows if r["energy_slit"] is not None), default=None)


@dataclass(frozen=True)
class Slice:
    """Slits and round cups at one time; each R/h is None where it was not found.

    Attributes:
        t_n: Normalised time.
        kappa_per_ratio: kappa_cap h: the natural curvature kappa_cap R of the cap over R/h, the
            same for every R/h.
        first: R/h beyond which there is a slit: half-way between the thickest shell with one and
            the next thicker, or the thickest shell of all.
        equal: R/h beyond which the slit has less energy.
        last: R/h up to which the round cup is stable, half-way likewise.
    """

    t_n: float
    kappa_per_ratio: float
    first: float | None
    equal: float | None
    last: float | None


def slices(rows: Sequence[Row]) -> list[Slice]:
    """Return what is known at each time, the earliest first.

    Args:
        rows: ``ratio`` R/h, ``t_n``, ``kappa_cap_R``, ``excess``, and ``energy_slit`` and
            ``energy_round``, None where there is no such cup.
    """
    by_time: dict[float, list[Row]] = {}
    for row in rows:
        by_time.setdefault(float(row["t_n"]), []).append(row)
    found = []
    for t_n, of_time in sorted(by_time.items()):
        slender = sorted(of_time, key=lambda r: -float(r["ratio"]))
        slits = _end([(float(r["ratio"]), r["energy_slit"] is not None) for r in slender])
        rounds = _end([(float(r["ratio"]), r["energy_round"] is not None) for r in slender[::-1]])
        per_ratio = float(slender[0]["kappa_cap_R"]) / float(slender[0]["ratio"])
        found.append(Slice(t_n, per_ratio, slits, equal_energy(of_time), rounds))
    return found


def _end(known: Sequence[tuple[float, bool]]) -> float | None:
    """Return half-way between the last R/h that has a cup and the next, None if none has one.

    >>> _end([(15.0, True), (14.0, True), (13.0, False)])
    13.5
    """
    there = [ratio for ratio, one in known if one]
    if not there:
        return None
    beyond = known[[ratio for ratio, _ in known].index(there[-1]) + 1 :]
    return (there[-1] + beyond[0][0]) / 2 if beyond else there[-1]
