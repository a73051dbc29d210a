"""One row of numbers for one cup: its events, its numbers at given times, and what became of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from opticcup_fem.case import Case
from opticcup_fem.events import Event

COLUMNS = (
    "t_n",
    "D_over_r",
    "lambda_iov",
    "apex_height_over_R",
    "max_radius_over_R",
    "tangent_angle_interface",
)
"""Columns of a path that are kept."""

Path = Mapping[str, Sequence[Any]]
"""Columns ``COLUMNS``, ``followed`` and ``jump``, one entry a state."""

Row = dict[str, Any]

_SUFFIX = {"primary_invagination": "1", "secondary_invagination": "2", "symmetry_breaking": "b"}


def empty_row() -> Row:
    """Return a row in which every event and number is missing."""
    names = [f"{name}_{s}" for s in _SUFFIX.values() for name in ("t", "type", "kappa")]
    names += [f"delta_theta_{s}" for s in _SUFFIX.values()]
    ends = ("t_contact", "t_breakdown", "t_ellipticity", "t_reached", "largest_D_over_r")
    names += ["theta_bar", "m_b", "t_early", "m_early", "D_over_r", "lambda_iov", *ends]
    return dict.fromkeys(names)


def value_at(path: Path, t_n: float, name: str) -> float | None:
    """Return a column's value on the followed part at a time, before the fall where there is one.

    None where the followed part does not reach the time.
    """
    branches: list[list[tuple[float, float]]] = []
    for t, value, followed, jump in zip(
        path["t_n"], path[name], path["followed"], path["jump"], strict=True
    ):
        if followed:
            if jump or not branches:
                branches.append([])
            branches[-1].append((t, value))
    if not branches or not branches[0][0][0] <= t_n <= branches[-1][-1][0] + 1e-9:
        return None
    # times are rounded where a path falls: it may land a hair before the limit point
    before = [branch for branch in branches if branch[0][0] <= t_n]
    containing = [branch for branch in before if t_n <= branch[-1][0] + 1e-9] or before[-1:]
    times, values = zip(*containing[0], strict=True)
    return float(np.interp(t_n, times, values))


def summary_row(case: Case, path: Path, events: Sequence[Event]) -> Row:
    """Return the numbers of a cup.

    Args:
        case: The case.
        path: Its path.
        events: Its events on the followed part: invaginations, the symmetry breaking after the
            primary invagination, that before it (``early``), contact and breakdowns.

    Returns:
        ``t_1, type_1, kappa_1, delta_theta_1`` of the primary invagination and likewise ``_2``,
        ``_b`` with ``m_b``; ``t_early, m_early``; ``t_contact, t_breakdown, t_ellipticity``;
        ``t_reached, D_over_r, lambda_iov`` at the end; None where there is none.
    """
    row: Row = {"theta_bar": case.shape.theta_bar}
    by_kind = {_name(one): one for one in reversed(events)}
    for kind, suffix in _SUFFIX.items():
        one = by_kind.get(kind)
        row |= _event_columns(case, path, one, suffix)
    early = by_kind.get("early")
    row["t_early"] = None if early is None else early["t_n"]
    row["m_early"] = None if early is None else early.get("wavenumber")
    for name in ("contact", "breakdown", "ellipticity"):
        found = by_kind.get(name)
        row[f"t_{name}"] = None if found is None else found["t_n"]
    followed = [i for i, flag in enumerate(path["followed"]) if flag]
    for column, name in (
        ("t_reached", "t_n"),
        ("D_over_r", "D_over_r"),
        ("lambda_iov", "lambda_iov"),
    ):
        row[column] = path[name][followed[-1]] if followed else None
    row["t_largest_depth"], row["largest_D_over_r"] = _deepest(path, followed)
    for t_n in case.output.times:
        for name in ("D_over_r", "lambda_iov"):
            row[f"{name}_at_{t_n:g}"] = value_at(path, t_n, name)
    return row


def _name(one: Event) -> str:
    if one["kind"] == "symmetry_breaking" and one.get("early"):
        return "early"
    if one["kind"] == "closure_breakdown":
        return "ellipticity" if one["type"] == "loss of ellipticity" else "breakdown"
    return "contact" if one["kind"] == "self_contact" else str(one["kind"])


def _event_columns(case: Case, path: Path, one: Event | None, suffix: str) -> Row:
    names = ("t", "type", "kappa", "delta_theta")
    columns: Row = {f"{name}_{suffix}": None for name in names}
    if suffix == "b":
        columns["m_b"] = None
    if one is None:
        return columns
    t_n = float(one["t_n"])
    angle = value_at(path, t_n, "tangent_angle_interface")
    turned = None if angle is None else case.shape.opening_angle - angle
    values = (t_n, one["type"], float(one["kappa_cap_R"]), turned)
    columns |= {f"{name}_{suffix}": value for name, value in zip(names, values, strict=True)}
    if suffix == "b":
        columns["m_b"] = one.get("wavenumber")
    return columns


def _deepest(path: Path, followed: Sequence[int]) -> tuple[float | None, float | None]:
    if not followed:
        return None, None
    at = max(followed, key=lambda i: float(path["D_over_r"][i]))
    return float(path["t_n"][at]), float(path["D_over_r"][at])
