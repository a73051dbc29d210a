"""Static condensation: a Newton step of (r, alpha) is one of the four-field system.

`test_step_is_that_of_the_whole_system` assembles all four fields densely and shares with the
condensation only the element blocks.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from opticcup_fem.equilibrium.newton import MixedNewton
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.mesh import open_cap_mesh
from opticcup_fem.shell.closures import CLOSURES
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.loads import EdgeForce, EdgeMoment, Pressure
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.supports import hinged
from tests.support.shells import COMM, disturbed, wall

Array = npt.NDArray[np.float64]


def small_shell(closure: str) -> Shell:
    """A hinged cap of a few dozen cells with every kind of block in its tangent."""
    mesh = open_cap_mesh(0.9, 0.45, comm=COMM)
    loads = [
        Pressure(1e-3, edge_is_held=True),
        EdgeMoment("rim", 1e-4),
        EdgeForce("rim", (0.01, 0, 0)),
    ]
    shell = Shell(mesh, {"cap": wall(0.1)}, {"wall": LinearGrowth(1.0)}, closure, loads=loads)
    shell.set_time(0.01)
    return shell


def out_of_balance(shell: Shell) -> ShellState:
    """A state in which none of the four equations holds."""
    rng = np.random.default_rng(8)
    state = disturbed(shell, 3e-4)
    return replace(
        state,
        kappa=state.kappa + 1e-3 * rng.normal(size=state.kappa.shape),
        sigma=state.sigma + 1e-4 * rng.normal(size=state.sigma.shape),
    )


def whole_system(shell: Shell, problem: Problem, state: ShellState) -> tuple[Array, Array]:
    """Residual and tangent of (r, alpha, kappa, sigma), unknowns in that order, dense."""
    cells = shell.condensed(state)
    blocks = {name: kernel(cells.data) for name, kernel in cells.kernels.items()}
    n_cells, n_k = state.kappa.shape
    n_u = problem.unknowns.in_cells.max() + 1
    u, d = problem.unknowns.in_cells, shell.spaces.det_j
    n_r = 3 * shell.spaces.nodes.shape[1]
    first = n_u + np.arange(n_cells)[:, None] * n_k + np.arange(n_k)
    k, s = first, first + n_cells * n_k
    size = n_u + 2 * n_cells * n_k
    residual, tangent = np.zeros(size), np.zeros((size, size))

    def add(rows: Array, columns: Array, block: Array) -> None:
        np.add.at(tangent, (rows[:, :, None], columns[:, None, :]), block)

    r = u[:, :n_r]
    add(r, r, blocks["Krr"] + blocks["G"] + blocks["G_edge"].sum(axis=1))
    mixed = blocks["Ga_edge"].reshape(n_cells, -1, n_r)
    add(u[:, n_r:], r, mixed)
    add(r, u[:, n_r:], mixed.transpose(0, 2, 1))
    add(r, k, blocks["Krk"])
    add(k, r, blocks["Kkr"])
    add(k, k, blocks["Kkk"])
    slope = np.concatenate(
        [blocks["B"] + blocks["B_edge"].sum(axis=1), *np.moveaxis(blocks["Ba_edge"], 1, 0)], axis=2
    )
    add(s, u, slope)
    add(u, s, slope.transpose(0, 2, 1))
    mass = d[:, None, None] * np.eye(n_k)
    add(k, s, -mass)
    add(s, k, -mass)
    np.add.at(residual, r, blocks["Fr"])
    np.add.at(residual, u, np.einsum("cku,ck->cu", slope, state.sigma))
    np.add.at(residual, k, blocks["Fk"] - d[:, None] * state.sigma)
    functional = blocks["L"] + blocks["L_edge"].sum(axis=1)
    np.add.at(residual, s, functional - d[:, None] * state.kappa)
    assert cells.external is not None
    np.add.at(residual, u, -cells.external.gradient(cells.data))
    add(r, r, -cells.external.tangent(cells.data))
    return residual, tangent


@pytest.mark.parametrize("closure", CLOSURES)
def test_step_is_that_of_the_whole_system(closure):
    shell = small_shell(closure)
    held = hinged(shell, "rim")
    problem = Problem(shell, held)
    state = out_of_balance(shell)
    residual, tangent = whole_system(shell, problem, state)
    free = np.ones(len(residual), dtype=bool)
    free[: held.size] = ~held
    step = np.zeros(len(residual))
    step[free] = -np.linalg.solve(tangent[np.ix_(free, free)], residual[free])
    after = MixedNewton(problem, max_iterations=1).solve(state).state
    n_u, n_kappa = held.size, state.kappa.size
    dr, dalpha = problem.unknowns.split(step[:n_u])
    dkappa, dsigma = (part.reshape(state.kappa.shape) for part in np.split(step[n_u:], [n_kappa]))
    for mine, yours in (
        (after.r - state.r, dr),
        (after.alpha - state.alpha, dalpha),
        (after.kappa - state.kappa, dkappa),
        (after.sigma - state.sigma, dsigma),
    ):
        scale = np.abs(yours).max()
        assert scale > 0
        np.testing.assert_allclose(mine, yours, atol=1e-8 * scale)  # condition of the system


def test_norm_of_the_solver_covers_the_local_equations():
    """An iterate in global balance whose kappa is wrong is no solution."""
    shell = small_shell("layer-stretch")
    cells = shell.condensed(out_of_balance(shell))
    state = out_of_balance(shell)
    curvature, moments = cells.local_residual(state.sigma)
    d = shell.spaces.det_j[:, None]
    np.testing.assert_allclose(curvature, d * (shell.curvature_of(state) - state.kappa), atol=1e-13)
    rested = shell.with_local_equilibrium(state)
    for part in shell.condensed(rested).local_residual(rested.sigma):
        assert np.abs(part).max() < 1e-14
    assert np.abs(moments).max() > 1e-6


def test_fraction_of_a_step_is_that_fraction():
    """Cut steps move curvature and moments as far as position and angles."""
    shell = small_shell("layer-stretch")
    state = out_of_balance(shell)
    cells = shell.condensed(state)
    du = 1e-3 * np.random.default_rng(9).normal(size=cells.gradient.shape)
    whole = cells.local_update(du, state.sigma, 1.0)
    half = cells.local_update(0.5 * du, state.sigma, 0.5)
    for full, cut in zip(whole, half, strict=True):
        np.testing.assert_allclose(cut, 0.5 * full, rtol=1e-12, atol=1e-15)
