r"""Pseudo-arclength continuation of F(x, t) = 0 through limit points in the load t.

The arc length s is measured by ds^2 = <dx, dx> + dt^2 with the problem's own inner product.  A step
goes to the predictor

    x_0 = x + ds x' + ds^2/2 x''   (x'' from the last two tangents; likewise t)

and solves F = 0 together with <x', x - x_0> + t' (t - t_0) = 0 by Newton's method.  All that is
needed of a problem is the solution of its bordered linear system.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Direction(NamedTuple):
    """A change of unknowns and load.

    Attributes:
        x: Change of the unknowns, shape (n,).
        t: Change of the load.
    """

    x: Array
    t: float


class Linearised(Protocol):
    """F and its derivatives at one (x, t)."""

    @property
    def residual(self) -> float:
        """Norm of F."""
        ...

    def bordered(self, row: Array, entry: float, value: float) -> tuple[Direction, Direction]:
        """Return Newton step and tangent.

        Both solve F_x dx + F_t dt = f, <row, dx> + entry dt = g: with f = -F and g = ``value``
        the step, with f = 0 and g = 1 the tangent.
        """
        ...


class ContinuationProblem(Protocol):
    """Equations F(x, t) = 0."""

    def linearise(self, x: Array, t: float) -> Linearised:
        """Return F and its derivatives; ``bordered`` may raise ``Inadmissible`` as well.

        Raises:
            Inadmissible: (x, t) is outside the domain of F.
        """
        ...

    def inner(self, first: Array, second: Array) -> float:
        """Return the inner product that measures arc length."""
        ...


FARTHEST = 1.0
"""Newton steps longer than this, in arc length, have lost the path."""


MOST_TURNS = 20
"""Times that a solution may change the equations it solves."""


class Inadmissible(ArithmeticError):
    """A point lies outside the domain of the equations; the cause is chained."""


class DenseLinearised:
    """F and dense derivatives, with the Euclidean inner product."""

    def __init__(self, residual: Array, in_x: Array, in_t: Array) -> None:
        """Keep F, shape (n,), F_x, shape (n, n), and F_t, shape (n,)."""
        self._residual, self._in_x, self._in_t = residual, in_x, in_t

    @property
    def residual(self) -> float:
        """See ``Linearised``."""
        return float(np.linalg.norm(self._residual))

    def bordered(self, row: Array, entry: float, value: float) -> tuple[Direction, Direction]:
        """See ``Linearised``."""
        return solve_bordered(self._in_x, self._in_t, row, entry, -self._residual, value)


def solve_bordered(
    matrix: Array, column: Array, row: Array, entry: float, right: Array, value: float
) -> tuple[Direction, Direction]:
    """Solve [[matrix, column], [row, entry]] y = (right, value) and = (0, 1).

    The bordered matrix is regular at limit points, where ``matrix`` is not.
    """
    n = len(right)
    whole = np.empty((n + 1, n + 1))
    whole[:n, :n], whole[:n, n], whole[n, :n], whole[n, n] = matrix, column, row, entry
    sides = np.zeros((n + 1, 2))
    sides[:n, 0], sides[n] = right, (value, 1.0)
    y: Array = np.asarray(np.linalg.solve(whole, sides), dtype=np.float64)
    return Direction(y[:n, 0], float(y[n, 0])), Direction(y[:n, 1], float(y[n, 1]))


@dataclass(frozen=True)
class ArcControl:
    """Steps along the path and Newton's method on them.

    Attributes:
        initial: First step in arc length.
        largest: No step is longer.
        smallest: No step is shorter; the path ends instead.
        tolerance: Largest last Newton step, in arc length, of a solution; its error is about the
            square of it.
        iterations: Most Newton iterations of a step.
        wanted: Iterations that leave the step as it is.
        turn: Smallest cosine between neighbouring tangents.
        drift: Largest distance of a solution from its predictor, over the step: farther away lies
            another part of the path.
        fold_tolerance: Accuracy of the load at a limit point.
    """

    initial: float = 2e-3
    largest: float = 0.04
    smallest: float = 1e-6
    tolerance: float = 1e-8
    iterations: int = 8
    wanted: int = 4
    turn: float = 0.9
    drift: float = 0.1
    fold_tolerance: float = 1e-8

    def __post_init__(self) -> None:
        """Refuse steps out of order.

        Raises:
            ValueError: Not 0 < smallest <= initial <= largest.
        """
        if not 0 < self.smallest <= self.initial <= self.largest:
            raise ValueError(
                f"steps {self.smallest}, {self.initial}, {self.largest} (smallest, initial, "
                "largest) must be positive and in this order"
            )


@dataclass(frozen=True)
class PathState:
    """A solution on the path.

    Attributes:
        t: Load.
        x: Unknowns.
        dx: Their derivative in arc length.
        dt: Derivative of the load in arc length, zero at a limit point.
        arc: Arc length from the start.
        iterations: Newton iterations spent on it, failed steps included.
        residual: Norm of F.
        is_fold: Whether it is a localised limit point.
        turns: Iterations among these that followed changes of the equations.
    """

    t: float
    x: Array
    dx: Array
    dt: float
    arc: float
    iterations: int = 0
    residual: float = 0.0
    is_fold: bool = False
    turns: int = 0


@dataclass
class Ending:
    """Why a path ended before the load that was asked for.

    Attributes:
        t: Load of the last solution.
        step: The step that failed.
        cause: What was raised by the last attempt, None if it did not converge.
    """

    t: float
    step: float
    cause: Inadmissible | None


@dataclass
class _Attempt:
    state: PathState | None
    iterations: int
    cause: Inadmissible | None = None


@dataclass
class Continuation:
    """Follows a path of solutions.

    Attributes:
        problem: The equations.
        control: Steps.
        ending: Set when the path could not be followed to its end.
        monitor: Called at every Newton iteration.
        settle: Called with (x, t) of a solution; returns whether that has changed the equations, so
            that the iteration has to go on.  It may raise ``Inadmissible``.
        loose: Where it is larger than zero, a guess is settled before it is iterated, and an
            iterate whose Newton step, in arc length, is no longer is settled at once; the
            iteration is carried to its end when that changes nothing more.
    """

    problem: ContinuationProblem
    control: ArcControl = field(default_factory=ArcControl)
    ending: Ending | None = None
    monitor: Callable[[], None] | None = None
    settle: Callable[[Array, float], bool] | None = None
    loose: float = 0.0

    def solve_at(self, x: Array, t: float) -> PathState | None:
        """Return the solution at a fixed load near ``x``, None if Newton's method fails."""
        zero = np.zeros_like(x)
        return self._newton(x, t, zero, 1.0, x, t, 0.0).state

    def between(self, low: PathState, high: PathState, share: float) -> PathState | None:
        """Return the solution at a share of the arc between two neighbouring solutions.

        Returns:
            The solution with its tangent, None if Newton's method fails.
        """
        arc = low.arc + share * (high.arc - low.arc)
        x, t = _hermite(low, high, share)
        row = (1 - share) * low.dx + share * high.dx
        entry = (1 - share) * low.dt + share * high.dt
        return self._newton(x, t, row, entry, x, t, arc).state

    def oriented(self, state: PathState, along: tuple[Array, float]) -> PathState:
        """Return ``state`` with its unit tangent, on the same side as ``along`` = (dx, dt)."""
        _, tangent = self.problem.linearise(state.x, state.t).bordered(*along, 0.0)
        return self._with_tangent(state, tangent)

    def _length(self, direction: Direction) -> float:
        return math.sqrt(self.problem.inner(direction.x, direction.x) + direction.t**2)

    def _with_tangent(self, state: PathState, tangent: Direction) -> PathState:
        length = self._length(tangent)
        return replace(state, dx=np.asarray(tangent.x / length), dt=tangent.t / length)

    def follow(
        self,
        x: Array,
        t: float,
        t_end: float,
        landings: Sequence[float] = (),
        *,
        lowest: float = -math.inf,
        longest: float = 30.0,
    ) -> Iterator[PathState]:
        """Yield solutions from load ``t`` until the path passes ``t_end``.

        Limit points are localised and yielded; so are solutions exactly at ``landings`` and
        ``t_end``, on every passage.

        Args:
            x: Guess of the solution at ``t``.
            t: First load.
            t_end: Last load, above ``t``.
            landings: Loads to land on.
            lowest: Load below which the path is given up as lost.
            longest: Arc length after which the path is given up as endless.
        """
        self.ending = None
        start = self.solve_at(x, t)
        if start is None:
            self.ending = Ending(t, 0.0, None)
            return
        first = self.oriented(start, (np.zeros_like(x), 1.0))
        yield first
        yield from self.onward(first, t_end, landings, lowest=lowest, longest=longest)

    def start(self, x: Array, t: float, across: Direction) -> PathState | None:
        """Return the solution near (x, t) on the plane through it normal to ``across``.

        Args:
            x: Guess of the unknowns, beside a known solution in the direction ``across``.
            t: Guess of the load.
            across: Where another branch leads; unit length.

        Returns:
            The solution with its tangent on the side of ``across``, None if there is none.
        """
        return self._newton(x, t, across.x, across.t, x, t, 0.0).state

    def onward(
        self,
        start: PathState,
        t_end: float,
        landings: Sequence[float] = (),
        *,
        lowest: float = -math.inf,
        longest: float = 30.0,
        before: PathState | None = None,
    ) -> Iterator[PathState]:
        """Yield the solutions after ``start``, which has its tangent; see ``follow``.

        Args:
            start: A solution.
            t_end: Last load.
            landings: Loads to land on.
            lowest: Load below which the path is given up as lost.
            longest: Arc length after which the path is given up as endless.
            before: The solution that the step to ``start`` came from, if the path was followed up
                to there: it goes on as if it had not been interrupted.
        """
        self.ending = None
        last = start
        step = self.control.initial if before is None else self._next_step(before, last)
        due = sorted({*landings, t_end})
        while last.arc < longest:
            state = self._advance(last, before, step)
            if state is None:
                return
            for stop in self._stops(last, before, state, due):
                yield stop
                if stop.t >= t_end - 1e-12 and not stop.is_fold:
                    return
            yield state
            if state.t < lowest:
                self.ending = Ending(state.t, state.arc - last.arc, None)
                return
            step = self._next_step(last, state)
            before, last = last, state
        self.ending = Ending(last.t, step, None)

    def _advance(self, last: PathState, before: PathState | None, step: float) -> PathState | None:
        """Return the next solution; note the end of the path if there is none."""
        spent = 0
        while True:
            attempt = self._step(last, before, step)
            spent += attempt.iterations
            if attempt.state is not None:
                return replace(attempt.state, iterations=spent)
            step *= 0.4
            if step < self.control.smallest:
                self.ending = Ending(last.t, step, attempt.cause)
                return None

    def _next_step(self, before: PathState, last: PathState) -> float:
        """Return the step after that from one solution to the next."""
        factor = 2.0 ** ((self.control.wanted - (last.iterations - last.turns)) / 2)
        used = last.arc - before.arc
        return min(used * min(max(factor, 0.5), 1.6), self.control.largest)

    def _step(self, last: PathState, before: PathState | None, step: float) -> _Attempt:
        x, t = _predict(last, before, step)
        row, entry = last.dx, last.dt
        attempt = self._newton(x, t, row, entry, x, t, last.arc + step)
        if attempt.state is None:
            return attempt
        state = attempt.state
        cosine = self.problem.inner(state.dx, row) + state.dt * entry
        drift = self._length(Direction(state.x - x, state.t - t))
        if cosine < self.control.turn or drift > self.control.drift * step:
            return _Attempt(None, attempt.iterations)
        return _Attempt(state, attempt.iterations)

    def _newton(
        self, x: Array, t: float, row: Array, entry: float, x_0: Array, t_0: float, arc: float
    ) -> _Attempt:
        """Solve F = 0 on the plane <row, x - x_0> + entry (t - t_0) = 0."""
        iteration, left, turns, direct = 0, self.control.iterations, 0, 0
        enough = max(self.loose, self.control.tolerance)
        try:
            if self.loose and self.settle is not None:  # equations follow the solution: begin near
                self.settle(x, t)
            while left > 0:
                iteration, left = iteration + 1, left - 1
                value = self.problem.inner(row, x_0 - x) + entry * (t_0 - t)
                linear = self.problem.linearise(x, t)
                step, tangent = linear.bordered(row, entry, value)
                length = self._length(step)
                if not length < FARTHEST:
                    break
                x, t = x + step.x, t + step.t
                if self.monitor is not None:
                    self.monitor()
                if length > enough:
                    continue
                changed = self.settle is not None and self.settle(x, t)
                direct = direct or iteration
                if changed:
                    turns += 1
                    left = self.control.iterations if turns < MOST_TURNS else 0
                elif length > self.control.tolerance:
                    left, enough = self.control.iterations, self.control.tolerance
                else:
                    after = iteration - direct
                    state = PathState(t, x, x, 0.0, arc, iteration, linear.residual, turns=after)
                    return _Attempt(self._with_tangent(state, tangent), iteration)
        except Inadmissible as cause:
            return _Attempt(None, iteration, cause)
        except np.linalg.LinAlgError:
            pass
        return _Attempt(None, iteration)

    # --- points between two steps -------------------------------------------------------------

    def _stops(
        self,
        last: PathState,
        before: PathState | None,
        state: PathState,
        landings: Sequence[float],
    ) -> Iterator[PathState]:
        """Yield limit point and landings between two neighbouring solutions, in order."""
        fold = None
        if last.dt * state.dt < 0:
            fold = self._limit_point(last, before, state)
        stops = [last, state] if fold is None else [last, fold, state]
        for low, high in pairwise(stops):
            inside = [s for s in landings if min(low.t, high.t) + 1e-12 < s < max(low.t, high.t)]
            for t in sorted(inside, reverse=high.t < low.t):
                found = self._land(low, high, t)
                if found is not None:
                    yield found
            if high is fold:
                yield high

    def _limit_point(
        self, last: PathState, before: PathState | None, state: PathState
    ) -> PathState | None:
        """Return the limit point between two solutions: the root of dt/ds, by regula falsi."""
        low, high = (0.0, last.dt), (state.arc - last.arc, state.dt)
        best: PathState | None = None
        for _ in range(40):
            width = high[0] - low[0]
            share = low[1] / (low[1] - high[1])
            step = low[0] + min(max(share, 0.05), 0.95) * width
            found = self._step(last, before, step).state
            if found is None:
                return best
            best = replace(found, is_fold=True)
            # t differs from the limit point's by about dt/ds times half the distance to it
            if abs(found.dt) * width < self.control.fold_tolerance:
                return best
            if found.dt * low[1] > 0:
                low = (step, found.dt)
            else:
                high = (step, found.dt)
        return best

    def _land(self, low: PathState, high: PathState, t: float) -> PathState | None:
        """Return the solution at load ``t`` between two solutions."""
        share = _share_at(low, high, t)
        found = self.solve_at(_hermite(low, high, share)[0], t)
        if found is None:
            return None
        arc = low.arc + share * (high.arc - low.arc)
        return self.oriented(replace(found, t=t, arc=arc), (low.dx + high.dx, low.dt + high.dt))


def _predict(last: PathState, before: PathState | None, step: float) -> tuple[Array, float]:
    """Return the guess of (x, t) at distance ``step``."""
    x, t = last.x + step * last.dx, last.t + step * last.dt
    if before is not None and last.arc > before.arc:
        bend = step * step / (2 * (last.arc - before.arc))
        x, t = x + bend * (last.dx - before.dx), t + bend * (last.dt - before.dt)
    return x, t


def _weights(share: float) -> tuple[float, float, float, float]:
    """Return Hermite's cubics at a share of the interval: values and slopes, start and end."""
    a, b = share, 1 - share
    return b * b * (1 + 2 * a), a * b * b, a * a * (1 + 2 * b), -a * a * b


def _hermite(low: PathState, high: PathState, share: float) -> tuple[Array, float]:
    """Return (x, t) interpolated from two states and their tangents."""
    w = _weights(share)
    width = high.arc - low.arc
    x = w[0] * low.x + w[1] * width * low.dx + w[2] * high.x + w[3] * width * high.dx
    t = w[0] * low.t + w[1] * width * low.dt + w[2] * high.t + w[3] * width * high.dt
    return x, t


def _share_at(low: PathState, high: PathState, t: float) -> float:
    """Return the share of the arc at which the load, interpolated as x is, equals ``t``."""
    left, right = 0.0, 1.0
    rising = high.t > low.t
    for _ in range(60):
        share = (left + right) / 2
        if (_hermite(low, high, share)[1] < t) == rising:
            left = share
        else:
            right = share
    return (left + right) / 2
