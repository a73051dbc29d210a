"""Run one case on both discretisations and say how far apart they are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mpi4py import MPI

import numpy as np

from opticcup_fem.case import Case
from opticcup_fem.case.checks import require_axisymmetric, require_cup
from opticcup_fem.events import Event
from opticcup_fem.records import PATH, read_events, read_path
from opticcup_fem.studies import cup, meridian
from opticcup_fem.studies.outcome import on_root

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("D_over_r", "lambda_iov", "apex_height_over_R", "max_radius_over_R")
"""Observables that are compared at the output times."""

PICTURE = "verify.png"


@dataclass(frozen=True)
class Verification:
    """How far the two models are apart.

    Attributes:
        ok: Whether both runs ended as they should.
        message: Table of values and differences, events, and where the plot is.
    """

    ok: bool
    message: str


def run(
    case: Case, out_dir: Path, *, quiet: bool = False, comm: MPI.Comm | None = None
) -> Verification:
    """Run a case on the surface and on the meridian, and compare (collective).

    The meridian model resists no contact, and here the surface model does not either.

    Writes the run folders ``surface`` and ``meridian`` and the plot ``verify.png`` in ``out_dir``.

    Args:
        case: The case; its ``run.model`` is not looked at.
        out_dir: Folder of the results.
        quiet: No progress bar.
        comm: MPI communicator, all ranks by default.

    Raises:
        CaseError: The shape is not a cup, or the folder cannot be written.
        MeshError: The cup cannot be meshed as the case asks.
    """
    require_cup(case, "the surface model, to which the meridian model is compared, is")
    require_axisymmetric(case, "the meridian model, to which the surface is compared, is")
    comm = comm or MPI.COMM_WORLD
    folders = {name: out_dir / name for name in ("meridian", "surface")}
    unresisted = case.contact.model_copy(update={"mode": "stop"})
    case = case.model_copy(update={"contact": unresisted})
    outcomes = {
        "meridian": meridian.run(case, folders["meridian"], quiet=quiet, comm=comm),
        "surface": cup.run(case, folders["surface"], quiet=quiet, comm=comm),
    }
    message = on_root(comm, lambda: _report(case, folders, out_dir))
    ok = all(outcome.ok for outcome in outcomes.values())
    return Verification(ok, str(comm.bcast(message)))


def _report(case: Case, folders: dict[str, Path], out_dir: Path) -> str:
    from opticcup_fem.plots.compare import compare

    lines = [f"{'t_n':>6} {'observable':<20} {'surface':>10} {'meridian':>10} {'difference':>10}"]
    surface, axisymmetric = (read_path(folders[name]) for name in ("surface", "meridian"))
    for t_n in case.output.times:
        one, other = _state_at(surface, t_n), _state_at(axisymmetric, t_n)
        if one is None or other is None:
            continue
        for name in COLUMNS:
            lines.append(_line(f"{t_n:6.3f}", name, one[name], other[name]))
    lines += _event_lines(*(read_events(folders[name]) for name in ("surface", "meridian")))
    picture = compare(folders["surface"], folders["meridian"] / PATH, out_dir / PICTURE)
    return "\n".join([*lines, f"plot of both paths: {picture}"])


def _state_at(path: pd.DataFrame, t_n: float) -> dict[str, float] | None:
    """Return the row of the followed, stable branch at an output time; None if there is none."""
    rows = path[np.isclose(path.t_n, t_n, rtol=0, atol=1e-9)]
    if "followed" in rows:
        rows = rows[rows.followed]
    return None if rows.empty else {name: float(rows.iloc[-1][name]) for name in COLUMNS}


def _event_lines(surface: list[Event], axisymmetric: list[Event]) -> list[str]:
    """Return a line for every kind of event that either model has on the followed branch."""
    times = [
        {str(e["kind"]): float(e["t_n"]) for e in reversed(events) if e.get("followed", True)}
        for events in (surface, axisymmetric)
    ]
    lines = []
    for kind in sorted({*times[0], *times[1]}):
        if all(kind in found for found in times):
            lines.append(_line("event", kind, times[0][kind], times[1][kind]))
        else:
            where = "surface" if kind in times[0] else "meridian"
            t_n = next(found[kind] for found in times if kind in found)
            lines.append(f"{'event':>6} {kind:<20} t_n = {t_n:.4f}, on the {where} only")
    return lines


def _line(head: str, name: str, one: float, other: float) -> str:
    """Return a line of the table; differences of what is zero on the meridian are absolute."""
    change = f"{100 * (one / other - 1):+9.3f} %" if other else f"{one - other:+10.2e}"
    return f"{head:>6} {name:<20} {one:10.5f} {other:10.5f} {change}"
