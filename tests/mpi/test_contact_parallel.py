"""Contact on all ranks: the same states as on one, and a run that goes on there."""

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from opticcup_fem.errors import InterruptedRun
from opticcup_fem.records import read_path
from opticcup_fem.studies import cup
from tests.support.cups import BETWEEN_PLATES, SLIT
from tests.support.interrupted import stop_after

pytestmark = [pytest.mark.mpi, pytest.mark.slow]


def compare(one: Path, other: Path) -> None:
    """Check that two runs took the same path, contact and all."""
    tables = [read_path(folder) for folder in (one, other)]
    assert (tables[0].contact_force > 0).any()
    assert len(tables[0]) == len(tables[1])
    numbers = [
        table.select_dtypes("number").drop(columns=["residual", "newton_iterations"])
        for table in tables
    ]
    np.testing.assert_allclose(numbers[0], numbers[1], rtol=1e-5, atol=1e-6)


def test_contact_together_alone_and_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Geometry is on rank 0, its forces on every rank; the faces are in the checkpoint."""
    comm = MPI.COMM_WORLD
    folder = Path(comm.bcast(str(tmp_path)))
    assert cup.run(BETWEEN_PLATES, folder / "together", quiet=True).ok
    forces = comm.bcast(read_path(folder / "together").contact_force if comm.rank == 0 else None)
    with monkeypatch.context() as patch:
        stop_after(int(np.argmax(forces > 0)) + 1, patch)
        with pytest.raises(InterruptedRun):
            cup.run(BETWEEN_PLATES, folder / "resumed", quiet=True)
    if comm.rank == 0:
        assert cup.run(BETWEEN_PLATES, folder / "alone", quiet=True, comm=MPI.COMM_SELF).ok
        compare(folder / "together", folder / "alone")
        alone = cup.run(
            BETWEEN_PLATES, folder / "resumed", quiet=True, resume=True, comm=MPI.COMM_SELF
        )
        assert alone.ok
        compare(folder / "together", folder / "resumed")
    comm.Barrier()


def test_slit_between_mirrors_together_and_alone(tmp_path: Path) -> None:
    """Images of an unknown lie on any rank; the rims that touch are images of each other."""
    comm = MPI.COMM_WORLD
    folder = Path(comm.bcast(str(tmp_path)))
    assert cup.run(SLIT, folder / "together", quiet=True).ok
    if comm.rank == 0:
        assert cup.run(SLIT, folder / "alone", quiet=True, comm=MPI.COMM_SELF).ok
        compare(folder / "together", folder / "alone")
    comm.Barrier()
