"""Where two cups of one R/h have the same energy, and where the buckled one begins to exist."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
