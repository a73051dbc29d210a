"""Continuation on equations of one or two unknowns whose paths are known in closed form.

The two that matter: limit points of a cubic, and the exits (below the start, outside the domain).
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from opticcup_fem.equilibrium.continuation import (
    ArcControl,
    Continuation,
    DenseLinearised,
    Inadmissible,
    PathState,
    solve_bordered,
)

Array = NDArray[np.float64]


class Cubic:
    """t = x^3 - 3 a x + 2 a^(3/2), with limit points x = -+sqrt(a), t = 4 a^(3/2) and 0."""

    def __init__(self, a: float = 0.5, wall: float = math.inf) -> None:
        """Keep a, and the largest x at which the equation is defined."""
        self.a, self.wall = a, wall

    def load(self, x: float) -> float:
        return x**3 - 3 * self.a * x + 2 * self.a**1.5

    def linearise(self, x: Array, t: float) -> DenseLinearised:
        if x[0] > self.wall:
            raise Inadmissible("beyond the wall")
        slope = 3 * x[0] ** 2 - 3 * self.a
        return DenseLinearised(np.array([self.load(x[0]) - t]), np.array([[slope]]), -np.ones(1))

    def inner(self, first: Array, second: Array) -> float:
        return float(first @ second)


class Circle(Cubic):
    """(t - 1)^2 + x^2 = 1: from t = 0 round and back."""

    def linearise(self, x: Array, t: float) -> DenseLinearised:
        value = (t - 1) ** 2 + x[0] ** 2 - 1
        return DenseLinearised(np.array([value]), np.array([[2 * x[0]]]), np.array([2 * (t - 1)]))


START = -1.8
CONTROL = ArcControl(initial=0.01, largest=0.3)


def cubic_path(
    landings: tuple[float, ...] = (), t_end: float = 3.0, problem: Cubic | None = None
) -> tuple[list[PathState], Continuation]:
    problem = problem or Cubic()
    continuation = Continuation(problem, CONTROL)
    path = list(
        continuation.follow(np.array([START]), problem.load(START), t_end, landings, longest=40)
    )
    return path, continuation


def test_limit_points_of_a_cubic() -> None:
    path, continuation = cubic_path()
    folds = [state for state in path if state.is_fold]
    a = 0.5
    assert continuation.ending is None
    np.testing.assert_allclose([s.x[0] for s in folds], [-math.sqrt(a), math.sqrt(a)], atol=1e-4)
    np.testing.assert_allclose([s.t for s in folds], [4 * a**1.5, 0.0], atol=1e-8)


def test_every_state_solves_the_equation_and_arc_length_grows() -> None:
    path, _ = cubic_path()
    for state in path:
        assert state.t == pytest.approx(Cubic().load(state.x[0]), abs=1e-12)
        assert state.dt**2 + state.dx[0] ** 2 == pytest.approx(1.0, abs=1e-12)
    arc = np.array([state.arc for state in path])
    assert np.all(np.diff(arc) > 0)


def test_arc_length_of_a_circle() -> None:
    problem = Circle()
    continuation = Continuation(problem, ArcControl(initial=1e-3, largest=0.02))
    path = list(continuation.follow(np.array([0.6]), 0.2, 1.9))
    # from (t, x) = (0.2, 0.6) to (1.9, sqrt(0.19)) over the top
    exact = math.pi - math.asin(0.6) - math.asin(math.sqrt(0.19))
    assert path[-1].x[0] == pytest.approx(math.sqrt(0.19), abs=1e-12)
    # a step is measured along the tangent: short of the arc in third order
    assert path[-1].arc == pytest.approx(exact, rel=2e-4)


def test_lands_on_every_passage() -> None:
    path, _ = cubic_path(landings=(0.5, 1.0))
    at = [state.x[0] for state in path if state.t == 0.5]
    roots = np.sort(np.roots([1, 0, -1.5, 2 * 0.5**1.5 - 0.5]).real)
    np.testing.assert_allclose(at, roots, atol=1e-10)
    assert sum(state.t == 1.0 for state in path) == 3


def test_ends_exactly_at_the_last_load() -> None:
    path, _ = cubic_path(t_end=2.0)
    assert path[-1].t == 2.0
    assert path[-1].x[0] > math.sqrt(0.5)


def test_reports_where_the_domain_ends() -> None:
    path, continuation = cubic_path(problem=Cubic(wall=0.3))
    assert continuation.ending is not None
    assert isinstance(continuation.ending.cause, Inadmissible)
    assert path[-1].x[0] == pytest.approx(0.3, abs=1e-5)
    assert continuation.ending.t == path[-1].t


def test_stops_where_the_path_falls_below_the_lowest_load() -> None:
    continuation = Continuation(Circle(), ArcControl(initial=0.01, largest=0.1))
    path = list(continuation.follow(np.array([0.6]), 0.2, 5.0, lowest=0.1))
    assert continuation.ending is not None
    assert path[-1].t < 0.1 <= path[-2].t
    assert path[-1].x[0] < 0
    assert max(state.t for state in path) == pytest.approx(2.0, abs=1e-8)


def test_a_start_without_a_solution_is_an_ending() -> None:
    continuation = Continuation(Circle(), ArcControl(initial=0.01, largest=0.1))
    assert list(continuation.follow(np.array([0.5]), 3.0, 4.0)) == []
    assert continuation.ending is not None


def test_bordered_system_is_regular_at_a_limit_point() -> None:
    matrix, column, row = np.zeros((1, 1)), np.array([2.0]), np.array([3.0])
    step, tangent = solve_bordered(matrix, column, row, 0.5, np.array([4.0]), 7.0)
    assert (step.t, step.x[0]) == (2.0, 2.0)
    assert (tangent.t, tangent.x[0]) == (0.0, pytest.approx(1 / 3))


@pytest.mark.parametrize("steps", [(0.0, 0.1, 0.2), (0.1, 0.01, 0.2), (0.01, 0.3, 0.2)])
def test_control_refuses_steps_out_of_order(steps: tuple[float, float, float]) -> None:
    smallest, initial, largest = steps
    with pytest.raises(ValueError, match="in this order"):
        ArcControl(smallest=smallest, initial=initial, largest=largest)


class Coupled(Cubic):
    """The cubic with an offset of the load that follows x, .1 x, but only when it is settled."""

    def __init__(self) -> None:
        """Begin without an offset."""
        super().__init__()
        self.offset, self.solves = 0.0, 0

    def load(self, x: float) -> float:
        return super().load(x) + self.offset

    def linearise(self, x: Array, t: float) -> DenseLinearised:
        self.solves += 1
        return super().linearise(x, t)

    def settle(self, x: Array, t: float) -> bool:
        change = abs(0.1 * x[0] - self.offset)
        self.offset = 0.1 * x[0] if change > 1e-7 else self.offset
        return change > 1e-7


def test_loose_solves_save_iterations_and_change_no_solution() -> None:
    """What is settled beside a path is settled as well; the solution is carried to its end."""
    found = {}
    for loose in (0.0, 1e-3):
        problem = Coupled()
        one = Continuation(problem, CONTROL, settle=problem.settle, loose=loose)
        state = one.solve_at(np.array([-1.7]), 1.0)
        assert state is not None
        assert abs(problem.load(state.x[0]) - 1.0) < 1e-12
        assert abs(problem.offset - 0.1 * state.x[0]) < 1e-7
        found[loose] = (state.x[0], problem.solves)
    assert found[1e-3][0] == pytest.approx(found[0.0][0], abs=1e-7)
    assert found[1e-3][1] < found[0.0][1]
