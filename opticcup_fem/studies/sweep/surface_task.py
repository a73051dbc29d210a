"""A cup on the surface model as a task."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mpi4py import MPI

from opticcup_fem.case import parse_case
from opticcup_fem.records import read_events, read_path
from opticcup_fem.studies import cup
from opticcup_fem.studies.sweep.rows import COLUMNS, summary_row

Record = dict[str, Any]


def surface_cup(parameters: Mapping[str, Any]) -> Record:
    """Run one cup on the surface model, on this process alone.

    Args:
        parameters: A case, as nested tables.

    Returns:
        As ``meridian_tasks.cup``; an early loss of symmetry ends the axisymmetric part here.
    """
    case = parse_case(parameters)
    with tempfile.TemporaryDirectory() as folder:
        summary = cup.run(case, Path(folder), quiet=True, comm=MPI.COMM_SELF)
        states, events = read_path(folder), read_events(folder)
    table = {name: [float(value) for value in states[name]] for name in COLUMNS}
    table["jump"] = [bool(value) for value in states["jump"]]
    table["followed"] = [True] * len(states)
    table["limit_point"] = [False] * len(states)
    row = summary_row(case, table, events)
    return {"row": row, "path": table, "reason": None if summary.ok else summary.message}
