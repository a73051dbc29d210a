"""Load stepping in t_n along stable equilibria, through limit points by relaxation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from opticcup_fem.equilibrium.jumps import Relaxation
from opticcup_fem.equilibrium.newton import MixedNewton, Solution
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.relaxation import Relaxed
from opticcup_fem.errors import ClosureBreakdown, ConvergenceError, OpticCupError
from opticcup_fem.shell.model import ShellState

TIME_EPSILON = 1e-12
"""Two normalised times closer than this are the same."""


@dataclass(frozen=True)
class StepControl:
    """How far a step in t_n may go.

    Attributes:
        initial: First step, and first step after a jump.
        largest: No step is longer.
        smallest: No step is shorter; a jump is looked for instead.
        growth: Factor after a quick step.
        cut: Factor after a failed one.
        quick: A step of at most this many iterations is quick.
        max_move: Largest move of a node in one step, unit R.
        jump_move: A relaxation that moves a node farther than this is a jump, unit R.
    """

    initial: float = 0.01
    largest: float = 0.1
    smallest: float = 1e-4
    growth: float = 1.5
    cut: float = 0.4
    quick: int = 6
    max_move: float = 0.4
    jump_move: float = 0.05


@dataclass(frozen=True)
class PathPoint:
    """An accepted, stable equilibrium.

    Attributes:
        t_n: Normalised time.
        state: The equilibrium.
        jump: Whether it was reached by relaxation from a state that had lost its stability.
        negative_eigenvalues: Of the tangent; None where the closure has no energy.
        iterations: Newton iterations or descent steps that the point took, failures included.
        residual: Norm of the residual.
        energy: Strain energy (for closures without one: the integral of Psi_0).
    """

    t_n: float
    state: ShellState
    jump: bool
    negative_eigenvalues: int | None
    iterations: int
    residual: float
    energy: float


@dataclass(frozen=True)
class PathEnd:
    """Why a path ended before its end: the last attempt and the time that it was for."""

    t_n: float
    attempt: Solution | Relaxed


class LoadStepping:
    """Follows stable equilibria as growth goes on, or as it is undone.

    Attributes:
        end: Set when the path could not be followed to its end.
        accepted: Number of accepted steps.
    """

    def __init__(
        self,
        problem: Problem,
        newton: MixedNewton,
        relaxation: Relaxation,
        control: StepControl,
    ) -> None:
        """Keep the parts.

        Args:
            problem: The shell's global problem.
            newton: Solver of one state.
            relaxation: Way down from a lost state.
            control: Step control.
        """
        self.problem, self.newton, self.relaxation = problem, newton, relaxation
        self.control = control
        self.end: PathEnd | None = None
        self.accepted = 0

    def count_iterations(self, count: Callable[[], None]) -> None:
        """Have ``count`` called at every Newton iteration and relaxation step."""
        self.newton.monitor = lambda iteration, residual: count()
        self.relaxation.monitor = lambda iteration, residual, energy: count()

    def failure(self) -> OpticCupError | None:
        """Return why the path ended early, None if it did not.

        Where no admissible step existed it is the closure that broke down, with place and
        height, and not the iteration.
        """
        if self.end is None:
            return None
        t_n, attempt = self.end.t_n, self.end.attempt
        if attempt.lost is not None:
            fibre, place = attempt.lost
            closure = self.problem.shell.closure
            return ClosureBreakdown(closure, fibre.layer, fibre.height, [*map(float, place)], t_n)
        return ConvergenceError(
            attempt.reason, t_n, self.accepted, attempt.iterations, attempt.residual
        )

    def follow(
        self,
        state: ShellState,
        t_end: float,
        times: Sequence[float] = (),
        t_start: float = 0.0,
    ) -> Iterator[PathPoint]:
        """Yield the accepted states from ``t_start`` to ``t_end``, exactly at ``times`` too.

        Args:
            state: First guess of the equilibrium at ``t_start``, the first point.
            t_end: Last normalised time; growth is undone where it is less than ``t_start``.
            times: Normalised times to land on.
            t_start: First normalised time.
        """
        control = self.control
        course = _Course(t_start, t_end, times)
        point, solution = self._attempt(t_start, state, state)
        if point is None:
            self.end = PathEnd(t_start, solution)
            return
        yield point
        dt, spent = control.initial, 0
        history = _History(self.problem, course.sign, point)
        while not course.is_over(point.t_n):
            step = history.limited(dt, control.smallest)
            target, step = course.next(point.t_n, step)
            found, solution = self._attempt(target, history.predict(target), point.state)
            spent += solution.iterations
            if found is not None:
                history.add(found)
                quick = solution.iterations <= control.quick
                dt = min(max(dt, step) * (control.growth if quick else 1.0), control.largest)
            elif step > control.smallest * (1 + 1e-6):
                history.block(step)
                dt = control.cut * step
                continue
            else:
                found = self._relaxed(point, target, solution)
                if found is None:
                    return
                spent += found.iterations
                history = _History(self.problem, course.sign, found)
                dt = control.initial
            point = replace(found, iterations=spent)
            self.accepted += 1
            spent = 0
            yield point

    def _attempt(
        self, t_n: float, guess: ShellState, before: ShellState
    ) -> tuple[PathPoint | None, Solution]:
        """Solve at ``t_n``; return the point if it is converged, near and stable (collective)."""
        shell = self.problem.shell
        shell.set_time(t_n)
        solution = self.newton.solve(guess, before=before)
        far = self._moved(solution.state, before) > self.control.max_move
        if not solution.converged or far:
            return None, solution
        inertia = self.newton.inertia()
        if inertia is not None and inertia.negative > 0:
            return None, solution
        state = shell.with_updated_directors(solution.state)
        negative = None if inertia is None else inertia.negative
        energy = shell.energy(state)
        point = PathPoint(
            t_n, state, False, negative, solution.iterations, solution.residual, energy
        )
        return point, solution

    def _relaxed(self, point: PathPoint, t_n: float, attempt: Solution) -> PathPoint | None:
        """Relax from a point onto a stable state at ``t_n``; None ends the path (collective)."""
        self.problem.shell.set_time(t_n)
        relaxed = self.relaxation.relax(point.state)
        if not relaxed.converged:
            self.end = PathEnd(t_n, attempt if relaxed.lost is None else relaxed)
            return None
        return PathPoint(
            t_n,
            relaxed.state,
            self._moved(relaxed.state, point.state) > self.control.jump_move,
            relaxed.negative_eigenvalues,
            relaxed.factorisations,
            relaxed.residual,
            relaxed.energy,
        )

    def _moved(self, after: ShellState, before: ShellState) -> float:
        """Return the largest move of a node between two states (collective)."""
        return self.problem.largest(np.linalg.norm(after.r - before.r, axis=1))


class _Course:
    """The way from one normalised time to another, with the times to land on.

    Attributes:
        sign: +1 where t_n grows along it, else -1.
    """

    def __init__(self, t_start: float, t_end: float, times: Sequence[float]) -> None:
        self.sign = 1.0 if t_end >= t_start else -1.0
        self._end = t_end
        between = {t for t in times if self._ahead(t, t_start) and self._ahead(t_end, t)}
        self._landings = sorted({*between, t_end}, reverse=self.sign < 0)

    def _ahead(self, t: float, of: float) -> bool:
        return self.sign * (t - of) > TIME_EPSILON

    def is_over(self, t: float) -> bool:
        """Return whether ``t`` is the end, or past it."""
        return not self._ahead(self._end, t)

    def next(self, t: float, dt: float) -> tuple[float, float]:
        """Return the next time and the step to it (positive), landing exactly where it is due.

        A step that would stop just short of a landing goes half the way instead of leaving a
        sliver.
        """
        due = next(time for time in self._landings if self._ahead(time, t))
        left = abs(due - t)
        if dt >= left - TIME_EPSILON:
            return due, left
        step = left / 2 if 1.5 * dt > left else dt
        return t + self.sign * step, step


class _History:
    """The last accepted states: predictor, and an estimate of how near a limit point is."""

    def __init__(self, problem: Problem, sign: float, first: PathPoint) -> None:
        self._problem, self._sign = problem, sign
        self._points = [(first.t_n, first.state)]
        self._blocked = math.inf

    def add(self, point: PathPoint) -> None:
        """Append an accepted point; three are remembered."""
        self._points = [*self._points[-2:], (point.t_n, point.state)]
        if self._to_failure <= 0:
            self._blocked = math.inf

    def block(self, step: float) -> None:
        """Remember that a step of this length failed."""
        self._blocked = min(self._along + step, self._blocked)

    @property
    def _along(self) -> float:
        """Signed time of the last state, which grows along the path."""
        return self._sign * self._points[-1][0]

    @property
    def _to_failure(self) -> float:
        return self._blocked - self._along

    def predict(self, t: float) -> ShellState:
        """Return the guess at ``t``: polynomial extrapolation through up to three states."""
        times = [time for time, _ in self._points]
        _, last = self._points[-1]
        guess = last
        for i, (time, state) in enumerate(self._points[:-1]):
            weight = math.prod(
                (t - other) / (time - other) for j, other in enumerate(times) if j != i
            )
            guess = guess.plus(state.minus(last), weight)
        return self._problem.with_mean_directors(guess, last)

    def limited(self, dt: float, smallest: float) -> float:
        """Return ``dt``, or less near a failed step or where the path bends to a limit point.

        Near a fold t is quadratic in the distance moved; its maximum through the last three
        states estimates the fold, and a step goes at most 0.8 of the way there.
        """
        to_fold = self._distance_to_fold()
        ahead = 0.8 * to_fold
        if to_fold < 3 * self._to_failure:
            ahead = min(ahead, 0.5 * self._to_failure)
        return min(dt, max(ahead, smallest))

    def _distance_to_fold(self) -> float:
        """Return the estimated distance in t_n to the next limit point, inf where none shows."""
        if len(self._points) < 3:
            return math.inf
        (t_0, a), (t_1, b), (t_2, c) = self._points
        s_1, s_2 = self._problem.distance(a, b), self._problem.distance(b, c)
        rate_1, rate_2 = abs(t_1 - t_0) / s_1, abs(t_2 - t_1) / s_2
        bend = (rate_2 - rate_1) / (s_1 + s_2)
        slope = rate_2 + bend * s_2
        if bend >= 0:
            return math.inf
        return slope * slope / (-4 * bend) if slope > 0 else 0.0
