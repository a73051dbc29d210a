"""Growth laws: constants, NumPy formulas and UFL expressions are one thing to the shell."""

import numpy as np
import pytest
from dolfinx import fem

from opticcup_fem.shell.fibres import GrowthState
from opticcup_fem.shell.growth import FieldGrowth, LinearGrowth, density_ratio
from opticcup_fem.shell.model import Shell
from tests.support.shells import coarse_cup, disturbed, wall

MESH = coarse_cup()
SECTIONS = {"cap": wall(), "oov": wall()}


def shell_with(law) -> Shell:
    shell = Shell(MESH, SECTIONS, {"wall": law})
    shell.set_time(0.3)
    return shell


def forces(law):
    shell = shell_with(law)
    state = disturbed(shell, 3e-4)
    return np.append(shell.gradient(state).ravel(), shell.energy(state))


@pytest.mark.parametrize("mass_change", [True, False])
def test_uniform_growth_in_any_form_is_the_same(mass_change):
    expected = forces(LinearGrowth(0.7, mass_change))
    constant = fem.Constant(MESH.mesh, 0.7)
    for rate in (lambda x: 0.7 + 0 * x[:, 0], constant, constant**2 / 0.7):
        np.testing.assert_allclose(forces(FieldGrowth(rate, mass_change)), expected, rtol=1e-12)


def test_field_in_any_form_is_the_same():
    """A formula in the reference position, and UFL expressions in a Function that holds it."""
    shell = shell_with(LinearGrowth(0.0))
    place = MESH.reference_position(shell.spaces.position)
    numpy_rate = FieldGrowth(lambda x: 0.5 + 0.4 * x[:, 2] ** 2)
    ufl_rate = FieldGrowth(0.5 + 0.4 * place[2] ** 2)
    np.testing.assert_allclose(forces(ufl_rate), forces(numpy_rate), rtol=1e-11, atol=1e-14)
    assert (
        np.abs(forces(numpy_rate) - forces(FieldGrowth(lambda x: 0.5 + 0 * x[:, 2]))).max() > 1e-3
    )


def test_own_law_of_any_kind():
    """A law is any function of time and points."""

    def law(t_n, points):
        e = 1 + t_n * (points.x[:, 2] > 0)
        return GrowthState(e, 1.0)

    growth = shell_with(law).growth
    for region in ("cap", "oov"):
        (state,) = growth[region]
        assert np.min(state.factor) >= 1.0
        assert np.max(state.factor) == pytest.approx(1.3)
    assert np.min(growth["oov"][0].factor) == 1.0


def test_time_sets_the_growth():
    shell = shell_with(LinearGrowth(2.0))
    assert shell.growth["cap"][0] == GrowthState(1.6, pytest.approx(2.56))
    shell.set_time(0.0)
    assert shell.growth["cap"][0] == GrowthState(1.0, 1.0)


def test_growth_at_other_points_of_a_region():
    shell = shell_with(FieldGrowth(lambda x: x[:, 2]))
    (growth,) = shell.growth_at("cap", np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    corners = shell.reference[shell.spaces.nodes[shell.region_cells("cap")][:, :3]]
    np.testing.assert_allclose(growth.factor, 1 + 0.3 * corners[..., 2].ravel(), rtol=1e-13)


def test_density_ratio_is_that_of_mass_balance():
    """(S9), (S10) with v_m = 1/rho_0: J rho/rho_0 = e^2."""
    np.testing.assert_array_equal(density_ratio(np.array([1.0, 2.0]), True), [1.0, 4.0])
    np.testing.assert_array_equal(density_ratio(np.array([1.0, 2.0]), False), [1.0, 1.0])
