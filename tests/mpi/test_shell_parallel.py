"""Loads, supports and growth fields of a distributed shell: the same as on one process."""

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
import pytest

from opticcup_fem.mesh import SurfaceMesh, cup_mesh, open_cap_mesh, strip_mesh
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.loads import EdgeForce, EdgeMoment, Load, Pressure, SurfaceForce
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.supports import Mask, clamped, hinged, rigid_modes_of_cup
from tests.support.shells import ALPHA, loaded, wall

pytestmark = pytest.mark.mpi


def strip(comm: MPI.Comm) -> SurfaceMesh:
    return strip_mesh(1.0, 0.4, 8, 3, comm)


def cap(comm: MPI.Comm) -> SurfaceMesh:
    return open_cap_mesh(0.9, 0.35, comm=comm)


def cup(comm: MPI.Comm) -> SurfaceMesh:
    return cup_mesh(ALPHA, 0.45, 0.3, 0.6, comm=comm)


CASES: dict[str, tuple[Callable[[MPI.Comm], SurfaceMesh], list[Load], Callable[[Shell], Mask]]] = {
    "clamped strip": (
        strip,
        [
            EdgeMoment("right", 2e-5),
            EdgeForce("right", (0.0, 0.0, 2e-5)),
            SurfaceForce((0, 0, 1e-5)),
        ],
        lambda shell: clamped(shell, "left"),
    ),
    "hinged cap": (
        cap,
        [Pressure(1e-2, edge_is_held=True), EdgeMoment("rim", -1e-4)],
        lambda shell: hinged(shell, "rim"),
    ),
    "closed cup": (
        cup,
        [Pressure(1e-2), EdgeMoment("interface", 1e-4, side="cap")],
        rigid_modes_of_cup,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_loaded_shell_is_the_same_on_all_ranks(name):
    """Energy, extents and iterations of the equilibrium."""
    mesh, loads, support = CASES[name]
    numbers = []
    for comm in (MPI.COMM_SELF, MPI.COMM_WORLD):
        on = mesh(comm)
        section = wall(0.05, 0.3)
        laws = {"wall": LinearGrowth(0.0)}
        shell = Shell(on, dict.fromkeys(on.regions, section), laws, loads=loads)
        state, iterations, problem = loaded(shell, support(shell), 1, tolerance=1e-11)
        inertia = problem.inertia()
        assert inertia is not None
        corners = np.array(comm.allgather([state.r.max(axis=0), state.r.min(axis=0)]))
        extents = [*corners[:, 0].max(axis=0), *corners[:, 1].min(axis=0)]
        numbers.append([shell.energy(state), inertia.negative, *iterations, *extents])
    np.testing.assert_allclose(numbers[1], numbers[0], rtol=1e-8, atol=1e-9)
