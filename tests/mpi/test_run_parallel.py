"""A run on any number of processes gives the path of one process."""

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from opticcup_fem.events import Event
from opticcup_fem.records import read_events, read_path
from opticcup_fem.studies import cup
from tests.support.cups import coarse_case
from tests.support.series import FIELDS, MODES, area, read_series

pytestmark = [pytest.mark.mpi, pytest.mark.slow]


def largest_difference(folder: Path, **case: float) -> float:
    """Return the largest difference between path.csv of all ranks and of one (0 but on rank 0)."""
    comm = MPI.COMM_WORLD
    folder = Path(comm.bcast(str(folder)))
    together = cup.run(coarse_case(**case), folder / "together", quiet=True)
    assert together.ok
    if comm.rank:
        return 0.0
    alone = cup.run(coarse_case(**case), folder / "alone", quiet=True, comm=MPI.COMM_SELF)
    assert alone.ok
    tables = [read_path(folder / name) for name in ("together", "alone")]
    assert len(tables[0]) == len(tables[1])
    columns = [c for c in tables[0].columns if c not in ("newton_iterations", "residual")]
    one, other = (table[columns].to_numpy(dtype=float) for table in tables)
    neither = np.isnan(one) & np.isnan(other)  # no parts of the shell are near each other
    difference = np.where(neither, 0.0, np.abs(one - other)).max(axis=0)
    print(dict(zip(columns, difference, strict=True)))
    check_events(*(read_events(folder / name) for name in ("together", "alone")))
    check_series(folder / "together", folder / "alone")
    return float(difference.max())


def check_events(together: list[Event], alone: list[Event]) -> None:
    """The same kinds in the same order, times and modes of critical points included."""
    assert [one["kind"] for one in together] == [one["kind"] for one in alone]
    for one, other in zip(together, alone, strict=True):
        assert one["t_n"] == pytest.approx(other["t_n"], abs=1e-7)
        assert one.get("wavenumber") == other.get("wavenumber")
        for key in {"purity", "eigenvalue", "eigenvalues"} & set(other):
            assert one[key] == pytest.approx(other[key], rel=1e-4), key


def check_series(together: Path, alone: Path) -> None:
    """ParaView opens the fields and modes of both, and draws the same surfaces."""
    for name in (FIELDS, MODES):
        assert (together / name).exists() == (alone / name).exists()
        if not (alone / name).exists():
            continue
        one, other = read_series(together, name), read_series(alone, name)
        assert list(one) == pytest.approx(list(other), abs=1e-7)
        for mine, theirs in zip(one.values(), other.values(), strict=True):
            assert mine.n_cells == theirs.n_cells
            assert area(mine) == pytest.approx(area(theirs), rel=1e-6)
            assert mine.bounds == pytest.approx(theirs.bounds, abs=1e-5)


def test_smooth_path(tmp_path: Path) -> None:
    """Through the smooth primary invagination of the chick cup."""
    assert largest_difference(tmp_path) < 1e-6


def test_path_with_a_jump(tmp_path: Path) -> None:
    """Across the snap of a thinner cup (R/h = 10): the same critical mode, jump and state after."""
    assert largest_difference(tmp_path, radius_over_thickness=10.0, t_end=0.05) < 1e-6
