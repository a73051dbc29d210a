"""Newton, relaxation and load stepping on a coarse cup.

What matters: quadratic convergence; the inertia of a free shell shows six rigid modes and no more;
both relaxations end in the state that Newton finds; the path lands where it is told to and does
not depend on how it is cut into steps.
"""

import itertools
import math
from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

from opticcup_fem.equilibrium import newton as newton_module
from opticcup_fem.equilibrium.mass import lumped_mass
from opticcup_fem.equilibrium.newton import Drag, MixedNewton
from opticcup_fem.equilibrium.path import LoadStepping, PathPoint
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.relaxation import TOO_FAR, EnergyDescent
from opticcup_fem.equilibrium.steps import Course, History, StepControl
from opticcup_fem.equilibrium.tangent import on_tangent
from opticcup_fem.equilibrium.viscous import ViscousRelaxation
from opticcup_fem.mesh import disk_mesh
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.supports import clamped, free, rigid_modes_of_cup
from opticcup_fem.studies.model import shell_of
from tests.support.cups import coarse_case
from tests.support.shells import wall

T = 0.03
"""Grown, and before the first invagination."""


@pytest.fixture(scope="module")
def shell() -> Shell:
    return shell_of(coarse_case(), MPI.COMM_SELF)


@pytest.fixture(scope="module")
def problem(shell: Shell) -> Problem:
    return Problem(shell, rigid_modes_of_cup(shell))


@pytest.fixture(scope="module")
def newton(problem: Problem) -> MixedNewton:
    return MixedNewton(problem)


@pytest.fixture(scope="module")
def equilibrium(shell: Shell, newton: MixedNewton) -> ShellState:
    shell.set_time(T)
    solution = newton.solve(shell.reference_state())
    assert solution.converged
    return solution.state


def test_newton_converges_quadratically(shell: Shell, newton: MixedNewton) -> None:
    """Near the solution each residual is about the square of the one before."""
    norms: list[float] = []
    newton.monitor = lambda iteration, norm: norms.append(norm)
    shell.set_time(T)
    solution = newton.solve(shell.reference_state())
    newton.monitor = None
    assert solution.converged and solution.residual < newton.tolerance
    assert solution.iterations == len(norms) - 1 <= 7
    tail = [n for n in norms if 1e-11 < n < 1e-1]
    orders = [math.log(b) / math.log(a) for a, b in itertools.pairwise(tail)]
    assert max(orders) > 1.6


def test_last_iteration_uses_the_tangent_before(
    shell: Shell,
    problem: Problem,
    newton: MixedNewton,
    equilibrium: ShellState,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where that ends below the tolerance: as many iterations, one tangent less."""
    shell.set_time(T)
    push = 1e-5 * shell.reference[:, [1, 2, 0]] ** 2
    monkeypatch.setattr(newton_module, "NEAR_SOLUTION", 1e-3)
    monkeypatch.setattr(newton, "tolerance", 1e-11)
    norms, tangents = [], []
    monkeypatch.setattr(newton, "monitor", lambda iteration, norm: norms.append(norm))
    assemble = problem.assemble_tangent
    monkeypatch.setattr(problem, "assemble_tangent", lambda *a: (tangents.append(1), assemble(*a)))
    solution = newton.solve(replace(equilibrium, r=equilibrium.r + push))
    assert solution.converged and norms[-1] < 1e-11 < norms[-2] < 1e-7
    assert len(tangents) == solution.iterations - 1
    inertia = newton.inertia()
    assert inertia is not None and inertia.negative == 0
    assert len(tangents) == solution.iterations - 1


def test_newton_gives_up_with_a_reason(shell: Shell, newton: MixedNewton) -> None:
    """Far too large a step is a failed solution, not an exception and not a wrong state."""
    shell.set_time(0.9)
    solution = newton.solve(shell.reference_state())
    assert not solution.converged
    assert solution.reason.startswith(("DIVERGED", "LOST"))


def test_held_unknowns_have_no_reaction(
    shell: Shell, newton: MixedNewton, equilibrium: ShellState
) -> None:
    """The six held components carry no force: without supports the residual is zero too."""
    shell.set_time(T)
    unheld = Problem(shell, free(shell))
    unheld.unknowns.add_cells(shell.gradient(equilibrium), unheld.vector)
    assert np.abs(unheld.vector.array_r).max() < 1e-7


def test_inertia_of_a_free_shell(shell: Shell, equilibrium: ShellState) -> None:
    """Free, the tangent has six eigenvalues near zero; held, none, and none below zero."""
    shell.set_time(T)
    cells = shell.condensed(shell.with_local_equilibrium(equilibrium))
    counts = []
    for held in (free(shell), rigid_modes_of_cup(shell)):
        problem = Problem(shell, held)
        mass = lumped_mass(problem)
        for shift in (1e-4, -1e-4):
            problem.assemble_tangent(cells)
            problem.add_diagonal(mass, shift)
            problem.factorise()
            inertia = problem.inertia()
            assert inertia is not None
            counts.append(inertia.negative)
    assert counts == [0, 6, 0, 0]


def test_relaxations_find_the_equilibrium(
    shell: Shell, problem: Problem, newton: MixedNewton, equilibrium: ShellState
) -> None:
    """Energy descent and viscous flow from a disturbed state end where Newton ends."""
    shell.set_time(T)
    x, y, _ = shell.reference.T
    held = problem.unknowns.held[: 3 * len(shell.reference)].reshape(-1, 3)
    push = np.where(held, 0.0, np.column_stack([0.02 * x * y, 0 * x, 0.03 * (x**2 - y**2)]))
    disturbed = replace(equilibrium, r=equilibrium.r + push)
    energy = shell.energy(shell.with_local_equilibrium(equilibrium))
    for relaxation in (EnergyDescent(problem), ViscousRelaxation(problem, newton)):
        relaxed = relaxation.relax(disturbed)
        assert relaxed.converged, relaxed.reason
        assert np.abs(relaxed.state.r - equilibrium.r).max() < 1e-6
        assert relaxed.energy == pytest.approx(energy, rel=1e-10)


def test_relaxations_are_given_up_where_they_lead_astray(
    shell: Shell, problem: Problem, newton: MixedNewton, equilibrium: ShellState
) -> None:
    """At the first state that is not worth going on from."""
    shell.set_time(T + 0.01)
    for relaxation in (EnergyDescent(problem), ViscousRelaxation(problem, newton)):
        seen: list[ShellState] = []
        relaxed = relaxation.relax(equilibrium, lambda state, seen=seen: bool(seen.append(state)))
        assert not relaxed.converged and relaxed.reason == TOO_FAR
        assert len(seen) == 1 and relaxed.state is seen[0]
        assert np.abs(relaxed.state.r - equilibrium.r).max() > 1e-4


@pytest.mark.parametrize("dt", [1e-3, -1e-3])
def test_tangent_is_that_of_the_path(
    shell: Shell, problem: Problem, newton: MixedNewton, equilibrium: ShellState, dt: float
) -> None:
    """What is left of a short way is of second order, in every unknown."""
    ahead = on_tangent(problem, equilibrium, T, dt)
    assert ahead is not None and shell.t_n == T + dt
    there = newton.solve(equilibrium)
    assert there.converged
    for name in ("r", "alpha", "kappa", "sigma"):
        start, end, guess = (getattr(x, name) for x in (equilibrium, there.state, ahead))
        assert np.linalg.norm(guess - end) < 0.02 * np.linalg.norm(end - start)


def test_drag_shortens_the_way(
    shell: Shell, problem: Problem, newton: MixedNewton, equilibrium: ShellState
) -> None:
    """The larger the viscous rate, the less a backward Euler step moves; it moves the same way."""
    shell.set_time(T + 0.003)
    mass = lumped_mass(problem)
    ways = []
    for rate in (1e4, 1e3, 0.0):
        solution = newton.solve(equilibrium, Drag(mass, rate))
        assert solution.converged
        ways.append((solution.state.r - equilibrium.r).ravel())
    lengths = [np.linalg.norm(way) for way in ways]
    assert lengths[0] < 0.9 * lengths[1] < 0.9 * lengths[2]
    assert ways[0] @ ways[2] > 0


def follow(
    shell: Shell, problem: Problem, newton: MixedNewton, **control: float
) -> list[PathPoint]:
    """Return the path of the coarse cup up to t_n = .05."""
    stepping = LoadStepping(problem, newton, EnergyDescent(problem), StepControl(**control))
    points = list(stepping.follow(shell.reference_state(), 0.05, (0.02, 0.05)))
    assert stepping.failure() is None
    return points


def test_path_lands_and_does_not_depend_on_its_steps(
    shell: Shell, problem: Problem, newton: MixedNewton
) -> None:
    """Landing times are met exactly, and states there agree between two step controls."""
    quick = follow(shell, problem, newton)
    slow = follow(shell, problem, newton, initial=0.004, growth=1.2)
    assert len(slow) > len(quick)
    for t in (0.02, 0.05):
        (a,), (b,) = ([p for p in path if p.t_n == t] for path in (quick, slow))
        assert np.abs(a.state.r - b.state.r).max() < 1e-7
    assert all(p.negative_eigenvalues == 0 and not p.jump for p in quick)


def test_path_back_in_time_retraces_itself(
    shell: Shell, problem: Problem, newton: MixedNewton
) -> None:
    """Undoing growth along a stable branch passes the states that growth passed."""
    forth = follow(shell, problem, newton)
    stepping = LoadStepping(problem, newton, EnergyDescent(problem), StepControl())
    back = list(stepping.follow(forth[-1].state, 0.01, (0.02,), t_start=0.05))
    assert back[0].t_n == 0.05 and back[-1].t_n == 0.01
    (a,), (b,) = ([p for p in path if p.t_n == 0.02] for path in (forth, back))
    assert np.abs(a.state.r - b.state.r).max() < 1e-7


def test_next_time_leaves_no_sliver() -> None:
    """A step that would stop just before a landing goes half way; one that passes it, lands."""
    course = Course(0.0, 1.0, [0.1])
    assert course.next(0.0, 0.2) == (0.1, 0.1)
    assert course.next(0.0, 0.09) == (0.05, 0.05)
    assert course.next(0.1, 0.2) == (pytest.approx(0.3), 0.2)
    assert course.is_over(1.0)


def test_step_behind_an_accepted_one() -> None:
    """Longer behind a quick one, shorter behind a slow one, within its bounds."""
    control = StepControl(largest=0.1, smallest=0.01, growth=1.5, cut=0.4, quick=6, slow=15)
    assert control.after(0.04, 0.04, 6) == pytest.approx(0.06)
    assert control.after(0.04, 0.001, 3) == pytest.approx(0.06)  # it only had to land
    assert control.after(0.04, 0.04, 7) == control.after(0.04, 0.04, 15) == 0.04
    assert control.after(0.04, 0.03, 16) == pytest.approx(0.012)
    assert control.after(0.09, 0.09, 1) == 0.1 and control.after(0.02, 0.02, 99) == 0.01


def test_course_back_in_time_lands_too() -> None:
    course = Course(0.3, 0.0, [0.1, 0.5])
    assert course.sign == -1
    assert course.next(0.3, 0.12) == (pytest.approx(0.18), 0.12)
    assert course.next(0.12, 0.05) == (0.1, pytest.approx(0.02))
    assert course.next(0.1, 0.5) == (0.0, 0.1)


def test_history_foresees_a_fold(problem: Problem, equilibrium: ShellState) -> None:
    """Three states with t = 1 - (1 - s)^2, s the distance moved, show the fold at t = 1."""
    direction = np.zeros_like(equilibrium.r)
    direction[:, 2] = 1.0

    def moved(s: float) -> tuple[float, ShellState]:
        return 1 - (1 - s) ** 2, replace(equilibrium, r=equilibrium.r + s * direction)

    history = History(problem, Course(0.0, 1.0, []), *moved(0.4))
    history.add(*moved(0.6))
    history.add(*moved(0.7))
    assert history.limited(1.0, 1e-6) == pytest.approx(0.8 * 0.09, rel=1e-6)
    assert history.limited(0.01, 1e-6) == 0.01
    assert history.limited(1.0, 0.5) == 0.5


def test_first_point_is_an_equilibrium(shell: Shell, problem: Problem, newton: MixedNewton) -> None:
    """The ungrown cup is solved for, too: interpolating the sphere leaves a small residual."""
    first = follow(shell, problem, newton)[0]
    assert first.t_n == 0 and first.residual < newton.tolerance
    assert first.negative_eigenvalues == 0
    assert np.abs(first.state.r - shell.reference).max() < 1e-3


def test_descent_leaves_a_saddle_without_slope() -> None:
    """A flat disk that grows within a clamped rim is in equilibrium, and buckles out of it."""
    mesh = disk_mesh(1.0, 0.4, 0.4, comm=MPI.COMM_SELF)
    disk = Shell(mesh, {"disk": wall(0.05)}, {"wall": LinearGrowth(0.02)})
    disk.set_time(1.0)
    problem = Problem(disk, clamped(disk, "rim"))
    flat = disk.with_local_equilibrium(disk.reference_state())
    slope = problem.vector.duplicate()
    problem.assemble_gradient(disk.condensed(flat), flat, slope)
    assert slope.norm() < 1e-9
    norms: list[float] = []
    descent = EnergyDescent(problem)
    descent.monitor = lambda iteration, norm, energy: norms.append(norm)
    relaxed = descent.relax(flat)
    assert relaxed.converged and relaxed.negative_eigenvalues == 0
    assert norms[0] < 1e-9 and norms[1] > 1e-5  # the first step is one off the saddle
    assert relaxed.iterations < 40
    assert relaxed.energy < 0.9 * disk.energy(flat)
    assert 0.02 < np.abs(relaxed.state.r[:, 2]).max() < 0.5
