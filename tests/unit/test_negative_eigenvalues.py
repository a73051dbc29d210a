"""Negative eigenvalues of tangents that are not symmetric, against LAPACK.

What matters: a false alarm of the symmetric part is caught and its state accepted; an instability
is not.  The false alarm is that of a cantilever under a follower pressure, which loses stability
by growing oscillations or not at all: two of its eigenvalues meet and become complex.
"""

import math

import numpy as np
import numpy.typing as npt
import pytest
from scipy import linalg, sparse

from opticcup_fem.equilibrium.mass import consistent_mass
from opticcup_fem.equilibrium.newton import MixedNewton
from opticcup_fem.equilibrium.path import LoadStepping, PathPoint
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.stability import NegativeEigenvalues
from opticcup_fem.equilibrium.steps import StepControl
from opticcup_fem.equilibrium.viscous import ViscousRelaxation
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.loads import Pressure
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.supports import clamped, rigid_modes_of_cup
from tests.support.shells import coarse_cup, strip_shell, wall

H, NU = 0.05, 0.3
STIFFNESS = 2 * (1 + NU) * H**3 / 12
"""Of the strip, per width."""


def real_parts(problem: Problem, state: ShellState) -> npt.NDArray[np.float64]:
    """Return the real parts of all eigenvalues, ascending, by LAPACK."""
    problem.assemble_tangent(problem.shell.condensed(state))
    matrices = []
    for matrix in (problem.matrix, consistent_mass(problem)):
        starts, columns, values = matrix.getValuesCSR()
        matrices.append(sparse.csr_array((values, columns, starts)).toarray())
    values = linalg.eigvals(*matrices)  # what is held has infinite ones
    return np.sort(values[np.isfinite(values)].real)


def followed(stepping: LoadStepping, shell: Shell) -> list[PathPoint]:
    points = list(stepping.follow(shell.reference_state(), 1.0))
    assert stepping.failure() is None
    return points


def test_false_alarm_is_caught_and_the_state_accepted() -> None:
    """At 60 E I/L^3 the symmetric part has a negative eigenvalue, the tangent has none."""
    load = Pressure(lambda t_n: 60 * STIFFNESS * t_n)
    shell = strip_shell(wall(H, NU), 0.3, 8, 2, loads=[load])
    problem = Problem(shell, clamped(shell, "left"))
    assert not problem.symmetric
    newton = MixedNewton(problem, 1e-11, 20, math.inf)
    stepping = LoadStepping(
        problem, newton, ViscousRelaxation(problem, newton), StepControl(largest=0.05)
    )
    points = followed(stepping, shell)
    inertia = newton.inertia()
    assert inertia is not None and inertia.negative == 1
    assert [point.negative_eigenvalues for point in points] == [0] * len(points)
    assert not any(point.jump for point in points)
    assert real_parts(problem, points[-1].state).min() > 0
    assert NegativeEigenvalues(newton).at_solution(points[-1].state) == 0


@pytest.mark.parametrize("load", [0.9, 1.6])
def test_instability_of_a_closure_without_an_energy_is_counted(load: float) -> None:
    """A sphere of `paper` under external pressure, below and above its buckling pressure."""
    h = 0.1
    classical = 2 * 2 * (1 + NU) * h**2 / math.sqrt(3 * (1 - NU**2))
    mesh, section = coarse_cup(1.6), wall(h, NU, 3)
    loads = [Pressure(lambda t_n: -classical * t_n)]
    laws = {"wall": LinearGrowth(0.0)}
    shell = Shell(mesh, {"cap": section, "oov": section}, laws, "paper", loads=loads)
    problem = Problem(shell, rigid_modes_of_cup(shell))
    newton = MixedNewton(problem, 1e-10, 20, math.inf)
    state = shell.reference_state()
    for t_n in (load / 2, load):
        shell.set_time(t_n)
        solution = newton.solve(state)
        assert solution.converged
        state = shell.with_updated_directors(solution.state)
    counted = NegativeEigenvalues(newton).at_solution(state)
    assert counted == np.count_nonzero(real_parts(problem, state) < 0)
    assert counted == 0 if load < 1 else counted is not None and counted > 3
