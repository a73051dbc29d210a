"""The axisymmetric shell.

What matters: Taylor remainders of the energy (rates 2 and 3), the exact Newton system with its
derivative in t_n, and solutions known in closed form.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from opticcup_fem.equilibrium.continuation import Continuation
from opticcup_fem.meridian.ellipticity import ellipticity, short_wave_hessian
from opticcup_fem.meridian.observables import CupObserver, apex_stretch, extremes
from opticcup_fem.meridian.problem import MeridianProblem
from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.shell.closures import resultants
from opticcup_fem.shell.fibres import GrowthState
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.section import Layer, Section
from tests.support.meridians import (
    PROFILES,
    bent_state,
    bilayer,
    in_local_equilibrium,
    shell_on,
)

T_N = 0.02


def moved(problem: MeridianProblem, state: MeridianState, move: np.ndarray) -> MeridianState:
    """Return a state with its free unknowns moved."""
    x = problem.pack(state)
    x[problem.free] += move
    return in_local_equilibrium(problem, problem.unpack(x), T_N)


@pytest.mark.parametrize("name", PROFILES)
def test_taylor_remainders_of_the_energy(name: str) -> None:
    shell = shell_on(PROFILES[name])
    problem = MeridianProblem(shell)
    state = in_local_equilibrium(problem, bent_state(shell, 1), T_N)
    linear = problem.linearise(problem.pack(state), T_N)
    other = problem.pack(bent_state(shell, 2)) - problem.pack(shell.reference_state())
    move = other[problem.free]
    first, second = linear.gradient @ move, move @ linear.hessian @ move
    energy = shell.energy(state, T_N)
    steps = np.array([0.1, 0.05, 0.025, 0.0125])
    change = [shell.energy(moved(problem, state, h * move), T_N) - energy for h in steps]
    with_residual = np.abs(change - steps * first)
    with_tangent = np.abs(change - steps * first - steps**2 / 2 * second)
    for remainder, rate in ((with_residual, 2), (with_tangent, 3)):
        slope = np.polyfit(np.log(steps), np.log(remainder), 1)[0]
        assert slope > rate - 0.1


@pytest.mark.parametrize("closure", ["layer-stretch", "paper"])
def test_the_newton_system_is_the_derivative_of_the_equations(closure: str) -> None:
    """Residuals after a small Newton-like step vanish to second order, also in t_n."""
    shell = shell_on(PROFILES["closed"], closure=closure)
    problem = MeridianProblem(shell)
    continuation = Continuation(problem)
    start = continuation.solve_at(problem.pack(shell.reference_state()), 0.002)
    assert start is not None
    path = continuation.oriented(start, (np.zeros_like(start.x), 1.0))
    steps = np.array([4e-4, 2e-4, 1e-4])
    left = [problem.linearise(path.x + h * path.dx / path.dt, path.t + h).residual for h in steps]
    assert np.polyfit(np.log(steps), np.log(left), 1)[0] > 1.9


def test_without_growth_the_reference_is_free_of_stress() -> None:
    """Up to the interpolation of the sphere: the solution at t_n = 0 is it to 1e-6."""
    shell = shell_on(PROFILES["closed"])
    problem = MeridianProblem(shell)
    solution = Continuation(problem).solve_at(problem.pack(shell.reference_state()), 0.0)
    assert solution is not None
    state = problem.unpack(solution.x)
    np.testing.assert_allclose(state.r, shell.reference_state().r, atol=1e-5)
    assert shell.energy(state, 0.0) < 1e-9


def test_uniform_growth_only_scales_the_sphere() -> None:
    """One layer of curvature b_ref grown by e has a stress-free state: the sphere of radius e R.

    Only to O(h): it would need lambda_3 = e through the thickness, which no closure gives.
    """
    layer = {
        "cap": Section([Layer("a", 1e-3, 1.0, 0.3, 3)]),
        "oov": Section([Layer("b", 1e-3, 1.0, 0.3, 3)]),
    }
    laws = {"a": LinearGrowth(1.0), "b": LinearGrowth(1.0)}
    mesh = shell_on(PROFILES["closed"]).mesh
    shell = MeridianShell(mesh, layer, laws)
    problem = MeridianProblem(shell)
    guess = shell.reference_state()
    solution = Continuation(problem).solve_at(problem.pack(guess), 0.01)
    assert solution is not None
    r = problem.unpack(solution.x).r
    widest = extremes(mesh, r[:, 0])[1]
    assert widest == pytest.approx(1.01, abs=1e-4)
    assert r[0, 1] - r[-1, 1] == pytest.approx(2.02, abs=2e-4)


def test_forms_of_the_sphere_have_the_sign_of_the_conventions() -> None:
    shell = shell_on(PROFILES["closed"])
    forms = shell.forms_at_points(shell.reference_state())
    np.testing.assert_allclose(forms[..., 0], 1.0, atol=2e-3)
    np.testing.assert_allclose(forms[..., 1], 1.0, atol=2e-3)
    np.testing.assert_allclose(forms[..., 3], -1.0, atol=1e-12)
    np.testing.assert_allclose(forms[..., 4], -1.0, atol=1e-2)


def test_volume_of_the_sphere() -> None:
    shell = shell_on(PROFILES["closed"])
    assert shell.volume(shell.reference_state()) == pytest.approx(4 * np.pi / 3, rel=1e-4)
    assert np.sum(shell.weights) == pytest.approx(4 * np.pi, rel=1e-7)


def test_axial_translation_changes_nothing() -> None:
    shell = shell_on(PROFILES["closed"])
    problem = MeridianProblem(shell)
    state = in_local_equilibrium(problem, bent_state(shell, 3), T_N)
    lifted = replace(state, r=state.r + np.array([0.0, 0.7]))
    assert shell.energy(lifted, T_N) == pytest.approx(shell.energy(state, T_N), rel=1e-12)
    for one in (state, lifted):
        gradient = problem.linearise(problem.pack(one), T_N).cells.gradient
        whole = np.zeros(problem.n_u)
        np.add.at(whole, problem.cell_unknowns, gradient)
        assert abs(np.sum(whole[1 : 2 * shell.mesh.n_nodes : 2])) < 1e-8


def test_observables_of_the_sphere() -> None:
    shell = shell_on(PROFILES["closed"])
    numbers = CupObserver(shell)(shell.reference_state(), 0.0)
    assert numbers["D_over_r"] == 0.0
    assert numbers["apex_height_over_R"] == pytest.approx(2.0)
    assert numbers["max_radius_over_R"] == pytest.approx(1.0, abs=1e-4)
    assert numbers["tangent_angle_interface"] == pytest.approx(np.deg2rad(40))
    assert apex_stretch(shell, shell.reference_state(), 0.0, "iov") == pytest.approx(1.0, abs=1e-3)


def test_extremes_lie_inside_cells() -> None:
    mesh = shell_on(PROFILES["disc"]).mesh
    values = (mesh.s - 0.43) ** 2
    low, high = extremes(mesh, values)
    assert low == pytest.approx(0.0, abs=1e-15)
    assert high == pytest.approx(0.57**2)


def test_short_wave_stiffness_is_the_hessian_in_stretch_and_rotation() -> None:
    """Central differences of the stress in (l, omega') at one grown, bent point."""
    section, growth = bilayer(0.1), [GrowthState(1.2, 1.44), GrowthState(1.0, 1.0)]
    a_ref = np.array([[1.0, 1.0, 0.0]])

    def evaluate(stretch: float, turn: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        forms = np.array([[stretch**2, 1.1, 0.0, stretch * turn, -0.8, 0.0]])
        result = resultants("layer-stretch", section, growth, forms, a_ref, -1.0)
        assert result.tangent is not None
        return forms, result.stress, result.tangent

    def gradient(x: np.ndarray) -> np.ndarray:
        _, stress, _ = evaluate(*x)
        w_a, w_b = stress[0, 0], stress[0, 3]
        return np.array([2 * x[0] * w_a + x[1] * w_b, x[0] * w_b])

    x, step, h = np.array([1.05, 0.4]), 1e-6, 0.1
    rows = [(gradient(x + step * e) - gradient(x - step * e)) / (2 * step) for e in np.eye(2)]
    scale = np.diag([1.0, 1 / h])
    np.testing.assert_allclose(
        short_wave_hessian(*evaluate(*x), h)[0], scale @ np.array(rows) @ scale, rtol=1e-6
    )


def test_the_reference_resists_short_waves() -> None:
    shell = shell_on(PROFILES["closed"])
    assert ellipticity(shell, shell.reference_state(), 0.0).value > 0
