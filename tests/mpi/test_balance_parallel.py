"""The mass balance is the same on any number of ranks."""

from mpi4py import MPI

import numpy as np
import pytest

from opticcup_fem.shell.balance import BalanceLaw
from opticcup_fem.stimulus import NO_MASS
from tests.support.spheres import surface_sphere

pytestmark = pytest.mark.mpi
LAW = BalanceLaw(NO_MASS, lambda t_n, points, rho: 0.5 * rho, lambda t_n, points: 0.3)


def numbers(comm):
    sphere = surface_sphere(LAW, 0.6, comm)
    sphere.begin(1 + 0.2 * sphere.x[:, 2])
    sphere.advance(0.2, 3, lambda t: 1 + t)
    return sphere.balance.columns(0.2, sphere.rest(1.2))


def test_numbers_of_a_balance_with_flux():
    spread, alone = numbers(MPI.COMM_WORLD), numbers(MPI.COMM_SELF)
    assert spread["mass_error_wall"] < 1e-12
    for name in spread.keys() - {"mass_error_wall"}:
        np.testing.assert_allclose(spread[name], alone[name], rtol=2e-5)
    assert spread["rho_wall_max"] - spread["rho_wall_min"] > 0.1
