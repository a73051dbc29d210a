"""Eigenvalues and modes of a small grown cup, against dense solvers of SciPy.

What matters: SLEPc's eigenvalues are LAPACK's, of a free shell without its six rigid motions, of a
held one, and of a closure whose tangent is not symmetric; rigid motions cost nothing in a deformed
state; the mass is area and rotary inertia.
"""

from dataclasses import replace

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import pytest
from scipy import linalg, sparse
from scipy.spatial.transform import Rotation

from opticcup_fem.equilibrium.mass import consistent_mass
from opticcup_fem.equilibrium.newton import MixedNewton
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.spectrum import SHIFT, Mode, Spectrum
from opticcup_fem.errors import ConvergenceError
from opticcup_fem.shell.growth import GrowthLaw, LinearGrowth
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.supports import Mask, free, rigid_modes_of_cup
from tests.support.shells import RATES, coarse_cup, cup_sections

Array = npt.NDArray[np.float64]
T = 0.03
COUNT = 8


class Grown:
    """A cup at an equilibrium, and the dense matrices of its motions."""

    def __init__(self, closure: str) -> None:
        """Solve for the cup at t_n = T."""
        laws: dict[str, GrowthLaw] = {name: LinearGrowth(rate) for name, rate in RATES.items()}
        self.shell = Shell(coarse_cup(1.6), cup_sections(), laws, closure)
        self.shell.set_time(T)
        newton = MixedNewton(Problem(self.shell, rigid_modes_of_cup(self.shell)), 1e-11)
        solution = newton.solve(self.shell.reference_state())
        assert solution.converged
        self.state = self.shell.with_updated_directors(solution.state)
        self.spectrum = Spectrum(self.shell)
        self.modes = self.spectrum.modes(self.state, COUNT)

    def matrices(self, held: Mask) -> tuple[Array, Array]:
        """Return H and M over the unknowns that are not held."""
        problem = Problem(self.shell, held)
        problem.assemble_tangent(self.shell.condensed(self.state))
        numbers = np.zeros(problem.matrix.getSize()[0], dtype=bool)
        numbers[problem.unknowns.numbers[held]] = True
        kept = np.ix_(~numbers, ~numbers)
        return dense(problem.matrix)[kept], dense(consistent_mass(problem))[kept]


def dense(matrix: PETSc.Mat) -> Array:
    """Return a PETSc matrix as an array."""
    starts, columns, values = matrix.getValuesCSR()
    return sparse.csr_array((values, columns, starts), shape=matrix.getSize()).toarray()


def nearest(values: Array, count: int = COUNT) -> Array:
    """Return the values nearest to the shift, in order."""
    return np.sort(values[np.argsort(np.abs(values - SHIFT))[:count]])


@pytest.fixture(scope="module")
def grown() -> Grown:
    return Grown("layer-stretch")


def eigenvalues(modes: list[Mode]) -> Array:
    return np.array([mode.eigenvalue for mode in modes])


def vector(problem: Problem, r: Array, alpha: Array) -> PETSc.Vec:
    """Return a motion as a vector of the problem."""
    made = problem.vector.duplicate()
    made.array[:] = problem.unknowns.owned_values(r, alpha)
    return made


def test_free_eigenvalues_are_lapacks_without_the_rigid_ones(grown: Grown) -> None:
    """Six of the dense eigenvalues are zero; the others nearest to the shift are SLEPc's."""
    values = linalg.eigh(*grown.matrices(free(grown.shell)), eigvals_only=True)
    rigid = np.abs(values) < 1e-7
    assert np.count_nonzero(rigid) == 6
    np.testing.assert_allclose(eigenvalues(grown.modes), nearest(values[~rigid]), rtol=1e-8)
    assert values[~rigid].min() > 0.01


def test_held_eigenvalues_are_lapacks(grown: Grown) -> None:
    """Held at its poles the shell has other eigenvalues, and none is lost."""
    held = rigid_modes_of_cup(grown.shell)
    values = linalg.eigh(*grown.matrices(held), eigvals_only=True)
    found = eigenvalues(Spectrum(grown.shell, held).modes(grown.state, COUNT))
    np.testing.assert_allclose(found, nearest(values), rtol=1e-8)
    assert np.abs(found - eigenvalues(grown.modes)).min() > 1e-4


def test_eigenvalues_of_a_tangent_that_is_not_symmetric() -> None:
    """Those of H itself, which the symmetric part's are not."""
    grown = Grown("paper")
    H, M = grown.matrices(free(grown.shell))
    values = linalg.eigvals(H, M).real
    rigid = np.abs(values) < 1e-6
    assert np.count_nonzero(rigid) == 6
    np.testing.assert_allclose(eigenvalues(grown.modes), nearest(values[~rigid]), rtol=1e-6)
    symmetric = linalg.eigh((H + H.T) / 2, M, eigvals_only=True)
    others = nearest(symmetric[np.abs(symmetric) > 1e-3])
    assert np.abs(others / eigenvalues(grown.modes) - 1).max() > 1e-4


def test_modes_solve_the_eigenproblem(grown: Grown) -> None:
    """H u = lambda M u, with a residual far below either side; the largest move is 1."""
    problem = grown.spectrum.problem
    problem.assemble_tangent(grown.shell.condensed(grown.state))
    mass = consistent_mass(problem)
    for mode in grown.modes:
        u = vector(problem, mode.r, mode.alpha)
        force, inertia = u.duplicate(), u.duplicate()
        problem.matrix.mult(u, force)
        mass.mult(u, inertia)
        difference = force - mode.eigenvalue * inertia
        assert difference.norm() < 1e-7 * mode.eigenvalue * inertia.norm()
        assert np.linalg.norm(mode.r, axis=1).max() == pytest.approx(1.0)


def test_rigid_motions_cost_nothing_and_are_no_modes(grown: Grown) -> None:
    """In a deformed state H maps each to zero; modes are orthogonal to all of them in M."""
    problem, spectrum = grown.spectrum.problem, grown.spectrum
    problem.assemble_tangent(grown.shell.condensed(grown.state))
    mass = consistent_mass(problem)
    motions = spectrum.rigid_motions(grown.state)
    assert len(motions) == 6
    assert np.abs(motions[3][1]).max() > 1e-3  # rotations turn directors against the lagged ones
    for motion in motions:
        u = vector(problem, *motion)
        image = u.duplicate()
        problem.matrix.mult(u, image)
        assert image.norm() < 1e-8 * u.norm()
        mass.mult(u, image)
        for mode in grown.modes:
            v = vector(problem, mode.r, mode.alpha)
            assert abs(v.dot(image)) < 1e-7 * u.norm() * v.norm()


def test_eigenvalues_do_not_depend_on_the_cups_place(grown: Grown) -> None:
    """A rigid motion of the state leaves them, and turns the motions along."""
    turn = Rotation.from_rotvec([0.5, -0.8, 0.3]).as_matrix()
    state = grown.state
    placed: ShellState = replace(
        state, r=state.r @ turn.T + np.array([0.3, 0.1, -0.7]), director=state.director @ turn.T
    )
    modes = grown.spectrum.modes(placed, COUNT)
    np.testing.assert_allclose(eigenvalues(modes), eigenvalues(grown.modes), rtol=1e-7)


def test_cosine_tells_modes_apart_and_overlooks_rigid_motions(grown: Grown) -> None:
    """1 for the mode itself with a rigid motion on top, 0 for another mode."""
    one, other = grown.modes[0], grown.modes[-1]
    cosine = grown.spectrum.cosine
    assert cosine(grown.state, one.r, one) == pytest.approx(1.0, abs=1e-3)
    rigid = np.array([1.0, 2.0, 3.0]) + np.cross([0.2, 0.5, -0.1], grown.state.r)
    assert cosine(grown.state, -one.r + rigid, one) == pytest.approx(1.0, abs=1e-3)
    assert cosine(grown.state, one.r, other) < 1e-2
    assert cosine(grown.state, rigid + 1e-3 * one.r, other) < 0.5


def test_mode_moves_a_state_by_the_amount_asked_for(grown: Grown) -> None:
    mode = grown.modes[0]
    moved = mode.moved(grown.state, -0.02)
    np.testing.assert_allclose(moved.r - grown.state.r, -0.02 * mode.r, atol=1e-14)
    np.testing.assert_allclose(moved.alpha - grown.state.alpha, -0.02 * mode.alpha, atol=1e-14)
    assert np.linalg.norm(moved.r - grown.state.r, axis=1).max() == pytest.approx(0.02)


def test_too_many_modes_are_refused(grown: Grown) -> None:
    """More than the shell has: an error that says how many there are."""
    with pytest.raises(ConvergenceError, match="eigenvalues converged"):
        grown.spectrum.modes(grown.state, grown.spectrum.problem.matrix.getSize()[0])


def moment(shell: Shell, r: Array, alpha: Array) -> float:
    """Return u . M u of a motion."""
    problem = Problem(shell, free(shell))
    u = vector(problem, r, alpha)
    image = u.duplicate()
    consistent_mass(problem).mult(u, image)
    return float(u.dot(image))


def test_consistent_mass_is_area_and_rotary_inertia(grown: Grown) -> None:
    """Translations weigh the area, a turn about z 8 pi/3, directors h^3/12 times the edges."""
    shell = grown.shell
    still = np.zeros_like(grown.state.alpha)
    for axis in np.eye(3):
        area = moment(shell, np.tile(axis, (len(shell.reference), 1)), still)
        assert area == pytest.approx(4 * np.pi, rel=1e-3)
    turned = np.cross([0.0, 0.0, 1.0], shell.reference)
    assert moment(shell, turned, still) == pytest.approx(8 * np.pi / 3, rel=2e-3)
    spaces = shell.spaces
    ends = spaces.coordinates[:, [[1, 2], [0, 2], [0, 1]]]
    lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    strips = lengths.sum() / 2 * shell.thickness**3 / 12  # every edge has two cells
    assert moment(shell, np.zeros_like(shell.reference), still + 1) == pytest.approx(strips)


def test_consistent_mass_is_positive_and_leaves_out_what_is_held(grown: Grown) -> None:
    held = rigid_modes_of_cup(grown.shell)
    problem = Problem(grown.shell, held)
    mass = dense(consistent_mass(problem))
    numbers = problem.unknowns.numbers[held]
    assert np.abs(mass[numbers]).max() == 0 == np.abs(mass[:, numbers]).max()
    _, M = grown.matrices(held)
    assert linalg.eigvalsh(M).min() > 0
    np.testing.assert_allclose(M, M.T, atol=1e-18)
