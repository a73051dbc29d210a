"""Steps in t_n: how far they may go, where they land, and the guess that they start from."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from opticcup_fem.equilibrium.problem import Problem
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
        slow: One of more than these is followed by a shorter one; by default more than a single
            solve of Newton's method may take, so that only contact comes to it.
        max_move: Largest move of a node in one step, unit R.
        jump_move: A relaxation that moves a node farther than this is a jump, unit R.
    """

    initial: float = 0.01
    largest: float = 0.1
    smallest: float = 1e-4
    growth: float = 1.5
    cut: float = 0.4
    quick: int = 6
    slow: int = 15
    max_move: float = 0.4
    jump_move: float = 0.05

    def after(self, dt: float, step: float, iterations: int) -> float:
        """Return the length of the step behind an accepted one.

        Args:
            dt: Length that the accepted step was to have.
            step: Length that it had, to land where it was due.
            iterations: Iterations that it took.
        """
        if iterations > self.slow:
            return max(self.cut * step, self.smallest)
        longer = self.growth if iterations <= self.quick else 1.0
        return min(max(dt, step) * longer, self.largest)


class Course:
    """The way from one normalised time to another, with the times to land on.

    Attributes:
        sign: +1 where t_n grows along it, else -1.
    """

    def __init__(self, t_start: float, t_end: float, times: Sequence[float]) -> None:
        """Sort the times.

        Args:
            t_start: First normalised time.
            t_end: Last one, before or after it.
            times: Normalised times to land on.
        """
        self.sign = 1.0 if t_end >= t_start else -1.0
        self._end = t_end
        between = {t for t in times if self._ahead(t, t_start) and self._ahead(t_end, t)}
        self._landings = sorted({*between, t_end}, reverse=self.sign < 0)

    def _ahead(self, t: float, of: float) -> bool:
        return self.sign * (t - of) > TIME_EPSILON

    def is_over(self, t: float) -> bool:
        """Return whether ``t`` is the end, or past it."""
        return not self._ahead(self._end, t)

    def limited(self, t: float, dt: float) -> float:
        """Return the time ``dt`` after ``t``, or the end if that is nearer."""
        return self._end if abs(self._end - t) < dt else t + self.sign * dt

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


class History:
    """The last accepted states: predictor, and an estimate of how near a limit point is."""

    def __init__(
        self, problem: Problem, course: Course, t_n: float, state: ShellState, longest: int = 3
    ) -> None:
        """Begin with one state.

        Args:
            problem: The shell's global problem.
            course: The way in t_n.
            t_n: Normalised time of the state.
            state: The state.
            longest: Number of states to remember, three or more.
        """
        self._problem, self._course, self._longest = problem, course, longest
        self._passed = [(t_n, state)]
        self._blocked = math.inf

    @classmethod
    def restored(
        cls,
        problem: Problem,
        course: Course,
        passed: Sequence[tuple[float, ShellState]],
        blocked: float,
        longest: int = 3,
    ) -> History:
        """Return the history of an interrupted path from what it ``passed`` and ``blocked``."""
        (t_n, first), *later = passed
        history = cls(problem, course, t_n, first, longest)
        for time, state in later:
            history.add(time, state)
        history._blocked = blocked
        return history

    @property
    def blocked(self) -> float:
        """Signed time that a step failed to reach, which grows along the path; inf for none."""
        return self._blocked

    def add(self, t_n: float, state: ShellState) -> None:
        """Append an accepted state; the last three serve the next step, all of them a leap."""
        self._passed = [*self._passed, (t_n, state)][-self._longest :]
        if self._to_failure <= 0:
            self._blocked = math.inf

    @property
    def states(self) -> list[tuple[float, ShellState]]:
        """Normalised times and states of the last points, up to three."""
        return self._passed[-3:]

    @property
    def passed(self) -> list[tuple[float, ShellState]]:
        """Normalised times and states of all points that are remembered."""
        return list(self._passed)

    def ahead(self, step: float) -> float:
        """Return the time ``step`` ahead of the last state, or the end if that is nearer."""
        return self._course.limited(self._passed[-1][0], step)

    def block(self, step: float) -> None:
        """Remember that a step of this length failed."""
        self._blocked = min(self._along + step, self._blocked)

    @property
    def _along(self) -> float:
        """Signed time of the last state, which grows along the path."""
        return self._course.sign * self._passed[-1][0]

    @property
    def _to_failure(self) -> float:
        return self._blocked - self._along

    def predict(self, t: float) -> ShellState:
        """Return the guess at ``t``: polynomial extrapolation through up to three states."""
        points = self.states
        times = [time for time, _ in points]
        _, last = points[-1]
        guess = last
        for i, (time, state) in enumerate(points[:-1]):
            weight = math.prod(
                (t - other) / (time - other) for j, other in enumerate(times) if j != i
            )
            guess = guess.plus(state.minus(last), weight)
        return self._problem.with_mean_directors(guess, last)

    def predict_far(self, t: float, distance: float) -> ShellState:
        """Return the guess at ``t`` on the straight line through the last state and a distant one.

        Args:
            t: Normalised time.
            distance: Least distance in t_n of the two.
        """
        t_1, last = self._passed[-1]
        distant = [one for one in self._passed if abs(one[0] - t_1) >= distance]
        if not distant:
            return last
        t_0, first = distant[-1]
        return self._problem.along(last, first, (t - t_1) / (t_0 - t_1))

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
        if len(self._passed) < 3:
            return math.inf
        (t_0, a), (t_1, b), (t_2, c) = self.states
        s_1, s_2 = self._problem.distance(a, b), self._problem.distance(b, c)
        if s_1 == 0 or s_2 == 0:  # nothing moved
            return math.inf
        rate_1, rate_2 = abs(t_1 - t_0) / s_1, abs(t_2 - t_1) / s_2
        bend = (rate_2 - rate_1) / (s_1 + s_2)
        slope = rate_2 + bend * s_2
        if bend >= 0:
            return math.inf
        return slope * slope / (-4 * bend) if slope > 0 else 0.0
