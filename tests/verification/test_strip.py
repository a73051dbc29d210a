"""A strip rolled up by a moment on its end: large rotations, exact solution, order of convergence.

With nu = 0 the strip rolls into a cylinder of uniform stretch l and turn w per reference length,

    a_11 = l^2,  b_11 = l w,  a_22 = 1,  all others 0,

which minimises W(l^2, l w) - m w: the tension N_11 + M_11 b_11/a_11 vanishes (N_11 alone does not)
and m = l M_11.
"""

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import brentq

from opticcup_fem.shell.closures import resultants
from opticcup_fem.shell.fibres import GrowthState
from opticcup_fem.shell.loads import EdgeMoment
from opticcup_fem.shell.supports import clamped
from tests.support.shells import loaded, rate_of, strip_shell, wall

Array = npt.NDArray[np.float64]
TURN = 1.5 * np.pi
SECTION = wall(0.02, poisson_ratio=0.0)
STEPS = 8


def stress(stretch: float, turn: float) -> Array:
    """(N/2, M) of the cylinder in the components (11, 22, 12)."""
    forms = np.array([[stretch**2, 1.0, 0.0, stretch * turn, 0.0, 0.0]])
    flat = np.array([[1.0, 1.0, 0.0]])
    return resultants("layer-stretch", SECTION, [GrowthState(1.0, 1.0)], forms, flat, 0.0).stress[0]


def cylinder(turn: float) -> tuple[float, float]:
    """Return stretch and moment of the strip rolled by ``turn`` per reference length."""

    def tension(stretch: float) -> float:
        half_n, m = stress(stretch, turn)[[0, 3]]
        return 2 * half_n * stretch + m * turn

    stretch = brentq(tension, 0.9, 1.1, xtol=1e-15)
    return stretch, stretch * stress(stretch, turn)[3]


def rolled(along: int, steps: int = STEPS) -> tuple[float, float, list[int]]:
    """Roll the strip up; return largest node error, chord error and Newton iterations."""
    stretch, moment = cylinder(TURN)
    load = EdgeMoment("right", lambda t_n: moment * t_n)
    shell = strip_shell(SECTION, 0.3, along, along // 3, loads=[load])
    state, iterations, problem = loaded(shell, clamped(shell, "left"), steps)
    inertia = problem.inertia()
    assert inertia is not None and inertia.negative == 0
    x, y, _ = shell.reference.T
    radius, angle = stretch / TURN, TURN * x
    exact = np.stack([radius * np.sin(angle), y, radius * (1 - np.cos(angle))], axis=1)
    end = np.isclose(x, 1.0)

    def chord(r: Array) -> float:
        return float(np.hypot(r[end, 0], r[end, 2]).mean())

    error = np.linalg.norm(state.r - exact, axis=1).max()
    return float(error), abs(chord(state.r) / chord(exact) - 1), iterations


def test_exact_solution_is_one():
    """The strip's energy less the moment's work is stationary in stretch and turn."""
    stretch, moment = cylinder(TURN)
    step = 1e-6

    def energy(change_l: float, change_w: float) -> float:
        forms = np.array([[(stretch + change_l) ** 2, 1, 0, 0, 0, 0]])
        forms[0, 3] = (stretch + change_l) * (TURN + change_w)
        flat, growth = np.array([[1.0, 1.0, 0.0]]), [GrowthState(1.0, 1.0)]
        strain = resultants("layer-stretch", SECTION, growth, forms, flat, 0.0).energy[0]
        return strain - moment * (TURN + change_w)

    for direction in ((step, 0.0), (0.0, step)):
        ahead, behind = energy(*direction), energy(*(-x for x in direction))
        assert abs(ahead - behind) / (2 * step) < 1e-11  # against 2 mu h = 4e-2 and m = 6e-6
    assert np.abs(stress(stretch, TURN)[[1, 2, 4, 5]]).max() < 1e-15


def test_coarse_strip_rolls_up():
    """24 cells, 270 degrees, up along n: a flipped moment or b would roll it down."""
    error, chord, iterations = rolled(6)
    assert error < 1e-4
    assert chord < 2e-4
    assert len(iterations) == STEPS
    assert max(iterations) <= 8


@pytest.mark.slow
def test_rolled_strip_converges():
    """Fourth order at least; on 24, 96 and 384 cells."""
    along = [6, 12, 24]
    errors, chords, iterations = zip(*(rolled(n) for n in along), strict=True)
    order = -rate_of(along, errors)
    print("errors", errors, "chord", chords, "order", order, "iterations", iterations)
    assert order > 3.9
    assert np.all(np.array(errors) < [1e-4, 2e-6, 1e-7])
    assert np.all(np.array(chords) < [2e-4, 2e-6, 1e-7])
    assert sum(iterations[-1]) <= 8 * STEPS
