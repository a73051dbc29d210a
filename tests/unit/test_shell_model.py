"""The shell as a whole: energy, its derivatives, and what must leave it alone.

The tests worth reading are `test_sphere_has_the_curvature_of_the_reference`, which pins the sign of
b, and `test_taylor_remainders_of_the_energy`, which holds energy, residual and tangent together.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import Rotation

from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.shell.closures import CLOSURES
from opticcup_fem.shell.fibres import LostFibre
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.section import Layer, Section
from opticcup_fem.shell.supports import free, rigid_modes_of_cup
from tests.support.shells import (
    ENERGY_CLOSURES,
    OTHER_CLOSURES,
    RATES,
    coarse_cup,
    cup_sections,
    cup_shell,
    disturbed,
    loaded,
    moved,
    rate_of,
    sphere_shell,
    wall,
)

Array = npt.NDArray[np.float64]
TURN = Rotation.from_rotvec([0.7, -1.1, 0.4]).as_matrix()
SHIFT = np.array([0.3, -2.0, 0.5])


@cache
def grown(closure: str = "layer-stretch") -> Shell:
    """The coarse chick cup at t_n = 0.05."""
    shell = cup_shell(closure)
    shell.set_time(0.05)
    return shell


@cache
def relaxed() -> tuple[Shell, ShellState]:
    """The coarse cup in equilibrium at t_n = 0.03."""
    shell = cup_shell()
    shell.laws = {name: LinearGrowth(0.03 * rate) for name, rate in RATES.items()}
    state, _, _ = loaded(shell, rigid_modes_of_cup(shell), steps=2, tolerance=1e-12)
    return shell, state


def scaled(shell: Shell, stretch: float) -> ShellState:
    """The sphere blown up, its cells' curvature that of (r, alpha)."""
    state = shell.reference_state()
    return shell.with_local_equilibrium(replace(state, r=stretch * state.r))


def test_sphere_has_the_curvature_of_the_reference():
    """b_ref = -a_ref/R with n outside: kappa of the reference position has that sign and size."""
    shell = sphere_shell(wall(), factor=0.5)
    forms = shell.forms_at_points(shell.reference_state())
    a, b = forms[..., :3], forms[..., 3:]
    assert np.abs(b + a).max() < 0.05  # interpolation: second derivatives of a cubic
    mean = np.einsum("cq,cqi->i", shell.weights, b) / np.einsum("cq,cqi->i", shell.weights, a)
    np.testing.assert_allclose(mean[:2], -1.0, atol=2e-4)


def test_reference_state_costs_nothing_up_to_interpolation():
    """The energy of the interpolated sphere falls with the fourth power of the cell size."""
    sizes, energies = [1.0, 0.7, 0.5], []
    for size in sizes:
        shell = sphere_shell(wall(), factor=size)
        energies.append(shell.energy(shell.reference_state()))
    assert energies[0] < 1e-6  # a growth of one part in a thousand costs that much
    assert rate_of(sizes, energies) > 3.9


@pytest.mark.parametrize("flip", ["outside", "radius"])
def test_flipped_sign_makes_the_reference_stressed(flip):
    """Were n or b_ref turned over, the ungrown sphere would store h^3/R^2 of energy."""
    mesh = coarse_cup()
    right = Shell(mesh, {"cap": wall(), "oov": wall()}, {"wall": LinearGrowth(0.0)})
    if flip == "outside":
        mesh = replace(mesh, surface=_Inward(mesh.surface))
    else:
        mesh = replace(mesh, surface=_Hollow(mesh.surface))
    wrong = Shell(mesh, {"cap": wall(), "oov": wall()}, {"wall": LinearGrowth(0.0)})
    assert right.energy(right.reference_state()) < 1e-6
    assert wrong.energy(wrong.reference_state()) > 0.1 * 4 * np.pi * 0.2**3


class _Changed:
    """A surface with one of its answers turned over."""

    def __init__(self, surface):
        self._surface = surface

    def __getattr__(self, name):
        return getattr(self._surface, name)


class _Inward(_Changed):
    def normal(self, x):
        return -self._surface.normal(x)


class _Hollow(_Changed):
    @property
    def curvature(self):
        return -self._surface.curvature


@pytest.mark.parametrize("closure", ENERGY_CLOSURES)
def test_taylor_remainders_of_the_energy(closure):
    """Rate 2 with the residual, rate 3 with the tangent, in (r, alpha) at local equilibrium."""
    shell = grown(closure)
    state = disturbed(shell, 3e-4)
    problem = Problem(shell, free(shell))
    direction = np.random.default_rng(5).normal(size=free(shell).size)
    dr, dalpha = problem.unknowns.split(direction)
    in_cells = direction[problem.unknowns.in_cells]
    energy = shell.energy(state)
    slope = np.sum(shell.gradient(state) * in_cells)
    bend = np.einsum("ci,cij,cj->", in_cells, shell.condensed(state).hessian, in_cells)
    sizes = 5e-5 * 0.5 ** np.arange(4)
    first, second = [], []
    for size in sizes:
        there = shell.with_local_equilibrium(moved(state, size * dr, size * dalpha))
        change = shell.energy(there) - energy
        first.append(abs(change - size * slope))
        second.append(abs(change - size * slope - size**2 / 2 * bend))
    assert rate_of(sizes, first) == pytest.approx(2.0, abs=0.05)
    assert rate_of(sizes, second) > 2.9


@pytest.mark.parametrize("closure", CLOSURES)
def test_taylor_remainder_of_the_residual(closure):
    """Rate 2 with the tangent, also where there is no energy."""
    shell = grown(closure)
    state = disturbed(shell, 3e-4)
    problem = Problem(shell, free(shell))
    direction = np.random.default_rng(6).normal(size=free(shell).size)
    dr, dalpha = problem.unknowns.split(direction)
    cells = shell.condensed(state)
    np.testing.assert_allclose(shell.gradient(state), cells.gradient, atol=1e-14)
    product = np.einsum("cij,cj->ci", cells.hessian, direction[problem.unknowns.in_cells])
    sizes = 1e-4 * 0.5 ** np.arange(4)
    remainders = []
    for size in sizes:
        there = shell.with_local_equilibrium(moved(state, size * dr, size * dalpha))
        change = shell.gradient(there) - cells.gradient
        remainders.append(np.linalg.norm(change - size * product))
    assert rate_of(sizes, remainders) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("closure", CLOSURES)
def test_tangent_is_symmetric_where_there_is_an_energy(closure):
    shell = grown(closure)
    hessian = shell.condensed(disturbed(shell, 3e-4)).hessian
    skew = np.abs(hessian - hessian.transpose(0, 2, 1)).max() / np.abs(hessian).max()
    assert shell.has_energy == (closure in ENERGY_CLOSURES)
    if shell.has_energy:
        assert skew < 1e-14
    else:
        assert skew > 1e-6


@pytest.mark.parametrize("closure", OTHER_CLOSURES)
def test_closures_without_energy_differ_from_their_density(closure):
    """The residual is not the derivative of the integral of Psi_0: lambda_3 is held in it."""
    shell = grown(closure)
    state = disturbed(shell, 3e-4)
    problem = Problem(shell, free(shell))
    direction = np.random.default_rng(7).normal(size=free(shell).size)
    dr, dalpha = problem.unknowns.split(direction)
    step = 1e-6
    ahead, behind = (
        shell.energy(shell.with_local_equilibrium(moved(state, s * dr, s * dalpha)))
        for s in (step, -step)
    )
    work = np.sum(shell.gradient(state) * direction[problem.unknowns.in_cells])
    assert abs((ahead - behind) / (2 * step) - work) > 1e-4 * abs(work)


def test_rigid_motions_cost_nothing():
    """Positions and directors turned together keep the energy and turn the forces."""
    shell = grown()
    state = disturbed(shell, 3e-4)
    turned = shell.with_local_equilibrium(
        replace(state, r=state.r @ TURN.T + SHIFT, director=state.director @ TURN.T)
    )
    np.testing.assert_allclose(turned.kappa, state.kappa, atol=1e-11)
    assert shell.energy(turned) == pytest.approx(shell.energy(state), rel=1e-12)
    before, after = shell.gradient(state), shell.gradient(turned)
    n_r = 3 * shell.spaces.nodes.shape[1]
    forces = before[:, :n_r].reshape(len(before), -1, 3) @ TURN.T
    np.testing.assert_allclose(after[:, :n_r].reshape(forces.shape), forces, atol=1e-10)
    np.testing.assert_allclose(after[:, n_r:], before[:, n_r:], atol=1e-10)


def test_turned_positions_alone_are_not_a_rigid_motion():
    """Directors left behind kink every edge: the test above would notice a lost director."""
    shell = grown()
    state = disturbed(shell, 3e-4)
    turned = shell.with_local_equilibrium(replace(state, r=state.r @ Rz(0.05).T))
    assert shell.energy(turned) > 1.01 * shell.energy(state)


def Rz(angle: float) -> Array:
    return Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()


def test_a_free_shell_in_equilibrium_has_six_zero_modes():
    """They are the rigid motions, of positions and angles; every other eigenvalue is positive."""
    shell, state = relaxed()
    problem = Problem(shell, free(shell))
    problem.assemble_tangent(shell.condensed(shell.with_local_equilibrium(state)))
    tangent = problem.matrix.convert("dense").getDenseArray()
    values = np.linalg.eigvalsh(tangent)
    assert np.abs(values[:6]).max() < 1e-13 * values[-1]
    assert values[6] > 1e-6 * values[-1]
    tangents = shell.directors.tangents(state.r)
    for axis in np.eye(3):
        shift = np.concatenate([np.tile(axis, len(state.r)), np.zeros(state.alpha.size)])
        turn = np.concatenate([np.cross(axis, state.r).ravel(), (tangents @ axis).ravel()])
        for motion in (shift, turn):
            force = problem.vector.duplicate()
            problem.unknowns.add_cells(
                np.einsum(
                    "cij,cj->ci",
                    shell.condensed(state).hessian,
                    motion[problem.unknowns.in_cells],
                ),
                force,
            )
            assert problem.norm(force.array_r) < 1e-11 * np.linalg.norm(motion) * values[-1]


def test_supports_of_the_cup_leave_no_zero_mode():
    shell, state = relaxed()
    problem = Problem(shell, rigid_modes_of_cup(shell))
    problem.assemble_tangent(shell.condensed(state))
    problem.factorise()
    inertia = problem.inertia()
    assert inertia is not None
    assert (inertia.negative, inertia.zero) == (0, 0)


def test_supports_of_the_cup_carry_no_force():
    """The residual of the free shell vanishes at the equilibrium of the supported one."""
    shell, state = relaxed()
    problem = Problem(shell, free(shell))
    force = problem.vector.duplicate()
    problem.unknowns.add_cells(shell.gradient(shell.with_local_equilibrium(state)), force)
    assert problem.norm(force.array_r) < 1e-10  # 100 times the solver's tolerance


def test_identical_layers_equal_one():
    """Three layers of h/3 make the same shell as one of h: energy, forces and tangent."""
    one = sphere_shell(wall(0.2, points=12), rate=1.0)
    layers = [Layer(name, 0.2 / 3, 1.0, 0.45, 10) for name in ("inner", "middle", "outer")]
    three = sphere_shell(Section(layers), rate=1.0)
    results = []
    for shell in (one, three):
        shell.set_time(0.2)
        state = disturbed(shell, 3e-4)
        cells = shell.condensed(state)
        results.append((shell.energy(state), cells.gradient, cells.hessian))
    for mine, yours in zip(*results, strict=True):
        np.testing.assert_allclose(mine, yours, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "changed",
    [
        {"mu": 1.1},
        {"nu": 0.44},
        {"thickness": 0.21},
        {"rate": 1.1},
        {"mass_change": False},
        {"t_n": 0.11},
        {"closure": "condensed"},
    ],
    ids=lambda changed: next(iter(changed)),
)
def test_every_parameter_changes_the_tangent(changed):
    base = {
        "mu": 1.0,
        "nu": 0.45,
        "thickness": 0.2,
        "rate": 1.0,
        "mass_change": True,
        "t_n": 0.1,
        "closure": "layer-stretch",
    }

    def tangent(p: dict) -> Array:
        section = Section([Layer("wall", p["thickness"], p["mu"], p["nu"], 5)])
        laws = {"wall": LinearGrowth(p["rate"], p["mass_change"])}
        shell = Shell(coarse_cup(), {"cap": section, "oov": section}, laws, p["closure"])
        shell.set_time(p["t_n"])
        return shell.condensed(disturbed(shell, 3e-4)).hessian

    start = tangent(base)
    assert np.abs(tangent(base | changed) - start).max() > 1e-4 * np.abs(start).max()


def test_larger_sphere_has_the_forms_of_a_larger_sphere():
    """With a = s^2 a_ref and b = -a/r both scale as they should, alpha still zero."""
    shell = sphere_shell(wall())
    start = shell.forms_at_points(shell.reference_state())
    forms = shell.forms_at_points(scaled(shell, 1.3))
    np.testing.assert_allclose(forms[..., :3], 1.3**2 * start[..., :3], rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(forms[..., 3:], 1.3 * start[..., 3:], rtol=1e-9, atol=1e-11)


def test_updated_directors_leave_the_shell_as_it_is():
    """Directors are re-expressed from the new mean normals: curvature and forces stay."""
    shell = grown()
    rng = np.random.default_rng(2)
    state = disturbed(shell, 3e-4)
    state = moved(state, 0.02 * rng.normal(size=3), 0.3 * rng.normal(size=state.alpha.shape))
    state = replace(state, r=state.r @ Rz(0.4).T)
    state = shell.with_mean_directors(state)
    state = replace(state, r=state.r @ Rz(0.3).T, kappa=shell.curvature_of(state))
    updated = shell.with_updated_directors(state)
    assert np.abs(updated.director - state.director).max() > 0.1
    assert np.abs(updated.alpha - state.alpha).max() > 0.01
    scale = np.abs(shell.curvature_of(state)).max()
    np.testing.assert_allclose(
        shell.curvature_of(updated), shell.curvature_of(state), atol=1e-12 * scale
    )


def test_lost_fibre_is_reported_with_its_place():
    """Point, layer and height of the closure reach the shell's own report."""
    shell = grown()
    state = shell.reference_state()
    kappa = state.kappa.reshape(shell.spaces.n_cells, -1, 3).copy()
    cell = int(shell.region_cells("oov")[17])
    kappa[cell, 0, 0] += 30.0
    bad = replace(state, kappa=kappa.reshape(state.kappa.shape))
    assert shell.evaluate(state)[1] is None
    with pytest.raises(LostFibre) as caught:
        shell.resultants(bad)
    assert caught.value.index // len(shell.forms.quadrature_points) == cell
    _, found = shell.evaluate(bad)
    assert found is not None
    lost, place = found
    assert (lost.layer, lost.cause) == ("oov", "metric")
    assert lost.height in shell.sections["oov"].gauss_points[0][0]
    centre = state.r[shell.spaces.nodes[cell]].mean(axis=0)
    assert np.linalg.norm(place - centre) < 0.5
    assert np.linalg.norm(place) == pytest.approx(1.0, abs=1e-3)


def test_regions_have_their_own_sections():
    """The cap's sections act in the cap's cells and nowhere else."""
    soft = Shell(coarse_cup(), cup_sections(), grown().laws)
    stiff = Section([replace(layer, shear_modulus=9.0) for layer in cup_sections()["cap"].layers])
    hard = Shell(coarse_cup(), cup_sections() | {"cap": stiff}, grown().laws)
    state = disturbed(soft, 3e-4)
    changed = hard.resultants(state).energy != soft.resultants(state).energy
    assert np.all(changed[soft.region_cells("cap")])
    assert not np.any(changed[soft.region_cells("oov")])
