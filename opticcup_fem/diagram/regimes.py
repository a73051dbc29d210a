"""What becomes of a cup, from its row of events."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

AT_ONCE = 0.98
"""Events later than this share of the time at which the closure breaks down belong to that
breakdown: all wavenumbers lose their stability with it."""

Regime = Literal["evaginated", "invaginated", "normal", "abnormal", "undecided"]
Row = Mapping[str, Any]


def regime(row: Row) -> Regime:
    """Return the regime of a cup.

    "normal" if the secondary invagination comes before any loss of symmetry, "abnormal" if
    symmetry is lost first, "invaginated" if neither comes up to the end of the path,
    "evaginated" if the apex never sinks below the rim.  "undecided" where the path ended early
    (closure breakdown, no convergence) or the closure lost its ellipticity before it could tell.

    Args:
        row: ``t_1``, ``t_2``, ``t_b``, ``largest_D_over_r``; ``status`` other than "ok" or "ended
            early" is undecided.
    """
    t_2, t_b = row.get("t_2"), row.get("t_b")
    if row.get("status", "ok") not in ("ok", "ended early"):
        return "undecided"
    lost = breakdown(row)
    if lost is not None:
        t_2, t_b = (None if t is None or t > AT_ONCE * lost else t for t in (t_2, t_b))
    if t_b is not None and (t_2 is None or t_b <= t_2):
        return "abnormal"
    if t_2 is not None:
        return "normal"
    if lost is not None:
        return "undecided"
    depth = row.get("largest_D_over_r")
    return "evaginated" if depth is None or depth <= 0 else "invaginated"


def breakdown(row: Row) -> float | None:
    """Return the time from which a path says nothing: without ellipticity, or at its early end."""
    lost = row.get("t_ellipticity")
    if row.get("status") == "ended early":
        end = row.get("t_reached")
        return min((t for t in (lost, end) if t is not None), default=0.0)
    return None if lost is None else float(lost)


def second_event(row: Row) -> tuple[str, float, float] | None:
    """Return kind, t_n and kappa_cap R of the first event after the primary invagination.

    Returns:
        "secondary_invagination" or "symmetry_breaking", or None where there is neither.
    """
    kinds = {"normal": ("secondary_invagination", "2"), "abnormal": ("symmetry_breaking", "b")}
    found = kinds.get(regime(row))
    if found is None:
        return None
    kind, suffix = found
    return kind, float(row[f"t_{suffix}"]), float(row[f"kappa_{suffix}"])


def margin(row: Row) -> float | None:
    """Return how far the second event is from being the other one, in kappa_cap R, relative.

    (kappa_b - kappa_2)/kappa_2: positive in a normal cup that would buckle later, negative in an
    abnormal one that would deepen later; None where only one of the two exists.
    """
    kappa_2, kappa_b = row.get("kappa_2"), row.get("kappa_b")
    if kappa_2 is None or kappa_b is None:
        return None
    return float(kappa_b / kappa_2 - 1)
