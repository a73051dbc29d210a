"""Loads: signs, directions of edges, what they work on, and their derivatives.

Signs are pinned by `test_positive_edge_moment_bends_towards_the_normal` and
`test_pressure_pushes_along_the_normal`; work is compared with integrals done by hand.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pytest

from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.errors import CaseError, MeshError
from opticcup_fem.mesh import open_cap_mesh
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.loads import (
    EdgeForce,
    EdgeMoment,
    Load,
    LoadSites,
    LoadValues,
    Pressure,
    SurfaceForce,
)
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.supports import clamped, free, hinged
from tests.support.shells import (
    COMM,
    cup_shell,
    disturbed,
    loaded,
    moved,
    rate_of,
    sphere_shell,
    strip_shell,
    wall,
)

Array = npt.NDArray[np.float64]
ANGLE = 0.9
CURVES = ("left", "right", "bottom", "top")
THIN = wall(0.02, poisson_ratio=0.0)


def cap_shell(loads: Sequence[Load]) -> Shell:
    mesh = open_cap_mesh(ANGLE, 0.45, comm=COMM)
    return Shell(mesh, {"cap": wall(0.1)}, {"wall": LinearGrowth(0.0)}, loads=loads)


def sum_of_forces(shell: Shell, state: ShellState) -> Array:
    """Resultant of the external forces: virtual work of the three translations."""
    problem = Problem(shell, free(shell))
    force = problem.vector.duplicate()
    bare = replace(state, sigma=np.zeros_like(state.sigma))
    problem.unknowns.add_cells(-shell.gradient(bare), force)
    positions, _ = problem.unknowns.split(problem.unknowns.to_local(force.array_r))
    return positions.sum(axis=0)


@pytest.mark.parametrize("curve", CURVES)
def test_positive_edge_moment_bends_towards_the_normal(curve):
    """On any side of a strip: M_nunu = m and b_nunu > 0, whichever way its edges run."""
    moment = 1e-8
    shell = strip_shell(THIN, 0.5, 4, 3, loads=[EdgeMoment(curve, moment)])
    opposite = dict(zip(CURVES, ("right", "left", "top", "bottom"), strict=True))[curve]
    state, _, _ = loaded(shell, clamped(shell, opposite), steps=1, tolerance=1e-14)
    forms = shell.forms_at_points(state)
    stress = shell.resultants(state).stress
    across = _global_components(shell, forms[..., 3:])
    moments = _global_moments(shell, stress[..., 3:])
    axis = 0 if curve in ("left", "right") else 1
    np.testing.assert_allclose(moments[..., axis, axis], moment, rtol=1e-6)
    np.testing.assert_allclose(moments[..., 1 - axis, 1 - axis], 0.0, atol=1e-6 * moment)
    bending = 2 * 0.02**3 / 12  # E h^3/12, E = 2 mu
    np.testing.assert_allclose(across[..., axis, axis], moment / bending, rtol=1e-4)
    assert state.r[:, 2].max() > 100 * abs(state.r[:, 2].min())  # up, along n


def _frames(shell: Shell) -> Array:
    return shell.spaces.frame[:, :2, :2]


def _global_components(shell: Shell, covariant: Array) -> Array:
    """Components along x and y of a tensor in the cells' frames, shape (..., 2, 2)."""
    full = np.stack([covariant[..., [0, 2]], covariant[..., [2, 1]]], axis=-2)
    return np.einsum("cai,cqab,cbj->cqij", _frames(shell), full, _frames(shell))


def _global_moments(shell: Shell, stress: Array) -> Array:
    """The same of a stress, conjugate to (11, 22, 12): the mixed one counts twice."""
    return _global_components(shell, stress * np.array([1.0, 1.0, 0.5]))


def test_edge_moment_works_on_the_angle():
    """Virtual work - m int s alpha dS_ref: the rim's directors all turned outwards by an angle."""
    moment = 0.3
    shell = cap_shell([EdgeMoment("rim", moment)])
    bare = cap_shell([])
    state = shell.reference_state()
    force = shell.gradient(state) - bare.gradient(state)
    outwards = np.zeros((shell.spaces.n_cells, 3, 3))
    outwards[:] = shell.spaces.edge_sign[:, :, None]  # about n_0 x nu: n turns towards nu
    n_r = 3 * shell.spaces.nodes.shape[1]
    work = -np.sum(force[:, n_r:] * outwards.reshape(len(force), -1))
    # nodes of the rim lie on the circle: its length is exact up to the cubic interpolation
    assert work == pytest.approx(-moment * 2 * np.pi * np.sin(ANGLE), rel=1e-4)
    assert np.abs(force[:, :n_r]).max() == 0.0
    assert shell.has_energy


def test_interior_curve_is_loaded_from_the_side_that_is_named():
    """Moments on both sides of the interface cancel; forces add up."""
    moments = [EdgeMoment("interface", 1.0, side=side) for side in ("cap", "oov")]
    bare, one, both = (cup_shell(loads=loads) for loads in ([], moments[:1], moments))
    state = bare.reference_state()
    problem = Problem(bare, free(bare))

    def angles(shell: Shell) -> Array:
        force = problem.vector.duplicate()
        problem.unknowns.add_cells(shell.gradient(state) - bare.gradient(state), force)
        return problem.unknowns.split(problem.unknowns.to_local(force.array_r))[1]

    assert np.count_nonzero(angles(one)) == 13 * 3  # the interface's edges
    np.testing.assert_allclose(angles(both), 0.0, atol=1e-14)
    forces = [EdgeForce("interface", (0.0, 0.0, 1.0), side=side) for side in ("cap", "oov")]
    total = [sum_of_forces(cup_shell(loads=loads), state)[2] for loads in (forces[:1], forces)]
    length = 2 * np.pi * np.sin(np.radians(40.0))
    assert total[0] == pytest.approx(length, rel=1e-4)
    assert total[1] == pytest.approx(2 * total[0], rel=1e-10)


def test_dead_forces_add_up_to_length_and_area():
    """Resultants are the load times the reference length or area, however deformed the shell is."""
    force = np.array([0.3, -1.0, 2.0])
    length, area = 2 * np.pi * np.sin(ANGLE), 2 * np.pi * (1 - np.cos(ANGLE))
    for load, measure in ((EdgeForce("rim", force), length), (SurfaceForce(force), area)):
        shell = cap_shell([load])
        for state in (shell.reference_state(), _stretched(shell, 1.4)):
            np.testing.assert_allclose(sum_of_forces(shell, state), measure * force, rtol=1e-4)


def test_surface_force_acts_in_its_region():
    shell = cup_shell(loads=[SurfaceForce((0.0, 0.0, -1.0), region="cap")])
    total = sum_of_forces(shell, shell.reference_state())
    cap = 2 * np.pi * (1 - np.cos(np.radians(40.0)))
    np.testing.assert_allclose(total, [0.0, 0.0, -cap], atol=1e-4)


def _stretched(shell: Shell, factor: float) -> ShellState:
    state = shell.reference_state()
    return shell.with_local_equilibrium(replace(state, r=factor * state.r))


def test_pressure_pushes_along_the_normal():
    """The resultant on a cap is p times the projected *current* area, along +z where n is."""
    shell = cap_shell([Pressure(0.7)])
    for factor in (1.0, 1.3):
        total = sum_of_forces(shell, _stretched(shell, factor))
        projected = 0.7 * np.pi * (factor * np.sin(ANGLE)) ** 2
        np.testing.assert_allclose(total, [0.0, 0.0, projected], atol=1e-4 * projected)


def test_pressure_in_a_closed_shell_is_minus_p_V():
    """Energy -p V, no resultant, and a symmetric tangent."""
    pressure = 0.05
    bare, shell = sphere_shell(wall()), sphere_shell(wall(), loads=[Pressure(pressure)])
    state = disturbed(shell, 3e-4)
    potential = shell.energy(state) - bare.energy(state)
    assert potential == pytest.approx(-pressure * 4 / 3 * np.pi, rel=2e-3)
    shifted = replace(state, r=state.r + np.array([1.0, 2.0, 3.0]))
    assert shell.energy(shifted) - bare.energy(state) == pytest.approx(potential, rel=1e-11)
    np.testing.assert_allclose(sum_of_forces(shell, state), 0.0, atol=1e-13)
    assert shell.has_energy
    assert _skew(shell, state, free(shell)) < 1e-14


def _skew(shell: Shell, state: ShellState, held: Array) -> float:
    problem = Problem(shell, held)
    problem.assemble_tangent(shell.condensed(state))
    tangent = problem.matrix.convert("dense").getDenseArray()
    return float(np.abs(tangent - tangent.T).max() / np.abs(tangent).max())


def test_symmetry_of_an_open_shell_under_pressure_depends_on_its_edge():
    """Held edge: symmetric. Free edge: not, and the shell says that it has no energy."""
    held, loose = (cap_shell([Pressure(0.05, edge_is_held=h)]) for h in (True, False))
    state = disturbed(held, 3e-4)
    assert held.has_energy
    assert not loose.has_energy
    assert _skew(held, state, hinged(held, "rim")) < 1e-14
    assert _skew(loose, state, free(loose)) > 1e-7
    assert not Problem(loose, free(loose)).symmetric
    assert loose.energy(state) == pytest.approx(cap_shell([]).energy(state), rel=1e-14)


def test_part_of_a_closed_shell_under_pressure_has_no_potential():
    """Its edge moves."""
    assert not cup_shell(loads=[Pressure(0.1, region="cap")]).has_energy
    assert cup_shell(loads=[Pressure(0.1)]).has_energy


@pytest.mark.parametrize(
    "load",
    [
        EdgeMoment("rim", 0.02),
        EdgeForce("rim", (0.1, 0.2, 0.3)),
        SurfaceForce((0.1, 0.2, 0.3)),
        Pressure(0.1, edge_is_held=True),
    ],
    ids=lambda load: type(load).__name__,
)
def test_energy_residual_and_tangent_of_each_load_agree(load):
    """Taylor remainders of the energy: rate 2 with the residual, 3 with the tangent."""
    shell = cap_shell([load])
    state = disturbed(shell, 3e-4)
    problem = Problem(shell, free(shell))
    direction = np.random.default_rng(11).normal(size=free(shell).size)
    direction[hinged(shell, "rim")] = 0.0
    dr, dalpha = problem.unknowns.split(direction)
    in_cells = direction[problem.unknowns.in_cells]
    slope = np.sum(shell.gradient(state) * in_cells)
    bend = np.einsum("ci,cij,cj->", in_cells, shell.condensed(state).hessian, in_cells)
    sizes, first, second = 2e-4 * 0.5 ** np.arange(4), [], []
    for size in sizes:
        there = shell.with_local_equilibrium(moved(state, size * dr, size * dalpha))
        change = shell.energy(there) - shell.energy(state)
        first.append(abs(change - size * slope))
        second.append(abs(change - size * slope - size**2 / 2 * bend))
    assert rate_of(sizes, first) > 1.9
    assert rate_of(sizes, second) > 2.9


def test_loads_add_up():
    """Two loads of a kind are one of their sum, also beside others."""
    split = cap_shell([EdgeMoment("rim", 0.1), Pressure(0.2), EdgeMoment("rim", 0.3)])
    whole = cap_shell([EdgeMoment("rim", 0.4), Pressure(0.2)])
    state = disturbed(split, 3e-4)
    np.testing.assert_allclose(split.gradient(state), whole.gradient(state), rtol=1e-12, atol=1e-15)


def test_loads_follow_the_time():
    shell = cap_shell([SurfaceForce(lambda t_n: (0.0, 0.0, 2 * t_n))])
    state = shell.reference_state()
    area = 2 * np.pi * (1 - np.cos(ANGLE))
    assert sum_of_forces(shell, state)[2] == pytest.approx(0.0, abs=1e-15)
    shell.set_time(0.5)
    assert sum_of_forces(shell, state)[2] == pytest.approx(area, rel=1e-4)


@dataclass(frozen=True)
class Wind:
    """A kind of load that the package does not know: pressure where the sphere faces +x."""

    def add(self, values: LoadValues, sites: LoadSites, t_n: float) -> None:
        centre = sites.spaces.coordinates.mean(axis=1)
        values.pressure[centre[:, 0] > 0] -= 0.1

    def has_potential(self, sites: LoadSites) -> bool:
        return False


def test_own_kind_of_load_needs_no_form():
    shell = sphere_shell(wall(), loads=[Wind()])
    force = sum_of_forces(shell, shell.reference_state())
    assert force[0] == pytest.approx(-0.1 * np.pi, rel=0.1)  # the half sphere's shadow
    assert not shell.has_energy


def test_places_that_do_not_exist_are_refused():
    with pytest.raises(MeshError, match="no curve 'edge'"):
        cap_shell([EdgeForce("edge", (0, 0, 1))])
    with pytest.raises(MeshError, match="no region 'oov'"):
        cap_shell([Pressure(1.0, region="oov")])
    with pytest.raises(MeshError, match="both sides"):
        cup_shell(loads=[EdgeMoment("interface", 1.0)])
    with pytest.raises(MeshError, match="no region 'tail'"):
        cup_shell(loads=[EdgeMoment("interface", 1.0, side="tail")])


@pytest.mark.parametrize("value", [(1.0, 2.0), float("nan"), (0.0, 0.0, float("inf"))])
def test_meaningless_values_are_refused(value):
    with pytest.raises(CaseError, match="3 finite components"):
        cap_shell([EdgeForce("rim", value)])
    with pytest.raises(CaseError, match="finite number"):
        cap_shell([Pressure((1.0, 1.0))])
