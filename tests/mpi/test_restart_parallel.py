"""A run interrupted on all ranks goes on, on one or on all, to the path of an undisturbed one."""

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from opticcup_fem.errors import InterruptedRun
from opticcup_fem.records import read_path, read_sections
from opticcup_fem.states import States
from opticcup_fem.studies import cup
from tests.support.cups import coarse_case
from tests.support.interrupted import stop_after

pytestmark = [pytest.mark.mpi, pytest.mark.slow]

CASE = coarse_case(t_end=0.06)


def compare(one: Path, other: Path, tolerance: float) -> None:
    """Check that paths, states and sections of two runs agree."""
    tables = [read_path(folder) for folder in (one, other)]
    numbers = [table.select_dtypes("number").drop(columns="residual") for table in tables]
    assert np.abs(numbers[0] - numbers[1]).max().max() < tolerance
    states = [States(folder) for folder in (one, other)]
    assert len(states[0]) == len(states[1]) == len(tables[0])
    for a, b in zip(*states, strict=True):
        assert (a.cells == b.cells).all()
        assert np.abs(a.position - b.position).max() < 1e-6
    assert [s.t_n for s in read_sections(one)] == [s.t_n for s in read_sections(other)]


def test_resumed_on_as_many_ranks_and_on_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numbering, partition and edge directions differ; cells in the input's order do not."""
    comm = MPI.COMM_WORLD
    folder = Path(comm.bcast(str(tmp_path)))
    cup.run(CASE, folder / "undisturbed", quiet=True)
    for name in ("together", "alone"):
        with monkeypatch.context() as patch:
            stop_after(3, patch)
            with pytest.raises(InterruptedRun):
                cup.run(CASE, folder / name, quiet=True)
    assert cup.run(CASE, folder / "together", quiet=True, resume=True).ok
    if comm.rank == 0:
        compare(folder / "undisturbed", folder / "together", 1e-10)
        assert cup.run(CASE, folder / "alone", quiet=True, resume=True, comm=MPI.COMM_SELF).ok
        compare(folder / "undisturbed", folder / "alone", 1e-6)
    comm.Barrier()
