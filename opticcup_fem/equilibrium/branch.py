"""The branch that leaves a bifurcation, by arc length through all its limit points."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from opticcup_fem.equilibrium.arc_length import LostPlaceError, ShellEquations
from opticcup_fem.equilibrium.axisymmetric import AxisymmetricStepping
from opticcup_fem.equilibrium.continuation import (
    ArcControl,
    Continuation,
    Direction,
    Ending,
    PathState,
)
from opticcup_fem.equilibrium.critical import CriticalPoint, CriticalPoints, Known
from opticcup_fem.equilibrium.path import PathPoint, SteppingState
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.errors import ClosureBreakdown, ConvergenceError, OpticCupError
from opticcup_fem.shell.model import ShellState

CONTROL = ArcControl(initial=5e-3, largest=0.03, smallest=1e-5, tolerance=1e-7)
"""Steps along a branch."""

CHART = 12
"""Steps after which director angles refer to new directors."""

PUSHES = (0.05, -0.05, 0.1, -0.1, 0.2, -0.2)
"""Moves along the critical mode to the first state of a branch, largest of a node over R, that are
tried one after the other: nearer to the bifurcation an unsymmetric mesh hides the branch."""

LONGEST = 3.0
"""Longest arc of a branch."""


@dataclass(frozen=True)
class BranchState:
    """All that a branch beyond an accepted state depends on.

    Attributes:
        point: The state as a point.
        accepted: Number of accepted states.
        state: The state on the directors of its chart.
        along: Derivative of its unknowns in arc length.
        before: The same of the state before in its chart, None for the first.
        numbers: Time, its derivative in arc length, arc length and iterations of the state.
        numbers_before: Derivative of the time and arc length of the state before.
        count: Steps since the chart was changed.
    """

    point: PathPoint
    accepted: int
    state: ShellState
    along: ShellState
    before: ShellState | None
    numbers: tuple[float, float, float, int]
    numbers_before: tuple[float, float] | None
    count: int


class BranchStepping:
    """Follows the axisymmetric states to their first bifurcation, and then what branches off."""

    def __init__(self, stem: AxisymmetricStepping, branch: BranchPath) -> None:
        """Keep the two parts.

        Args:
            stem: Stepping along the axisymmetric states.
            branch: The branch that leaves them.
        """
        self.problem, self._stem, self._branch = stem.problem, stem, branch
        self._reached: SteppingState | None = None

    def count_iterations(self, count: Callable[[], None]) -> None:
        """Have ``count`` called at every Newton iteration and relaxation step."""
        self._stem.count_iterations(count)
        self._branch.monitor = count

    @property
    def present(self) -> SteppingState | BranchState | None:
        """What the path beyond the last point that was yielded depends on.

        Of a limit point or a bifurcation it is that of the point before.
        """
        return self._branch.present or self._reached

    def follow(
        self,
        state: ShellState,
        t_end: float,
        times: Sequence[float] = (),
        resumed: SteppingState | BranchState | None = None,
    ) -> Iterator[PathPoint]:
        """Yield the states up to the first loss of symmetry, and those of the branch.

        Args:
            state: First guess of the equilibrium at t_n = 0.
            t_end: Last normalised time of both.
            times: Normalised times to land on before the bifurcation.
            resumed: Go on from there instead; its point is not yielded again.
        """
        if isinstance(resumed, BranchState):
            yield from self._branch.resume(resumed, (0.0, t_end))
            return
        for point in self._stem.follow(state, t_end, times, resumed=resumed):
            lost = [one for one in point.critical if one.kind == "bifurcation" and one.lost]
            if lost:
                yield from self._branch.follow(lost[0], (0.0, t_end))
                return
            self._reached = self._stem.present
            yield point

    def between(self, low: PathPoint, high: PathPoint, t_n: float) -> PathPoint | None:
        """Return the state at a time between two neighbours of the stem, see ``LoadStepping``.

        Returns:
            None on the branch, where a time does not tell a state.
        """
        return self._stem.between(low, high, t_n) if self._branch.is_empty else None

    def failure(self) -> OpticCupError | None:
        """Return why the path ended early, None if it did not."""
        return self._stem.failure() or self._branch.failure()


class BranchPath:
    """The branch that leaves a bifurcation, followed by arc length.

    Arc length is the r.m.s. move of the surface over R, and t_n.

    Attributes:
        problem: The shell's global problem.
        control: Steps.
        monitor: Called at every Newton iteration.
        present: What the branch beyond its last state, limit points excepted, depends on.
    """

    def __init__(
        self, problem: Problem, points: CriticalPoints | None = None, control: ArcControl = CONTROL
    ) -> None:
        """Keep the parts.

        Args:
            problem: The shell's global problem.
            points: Finds the modes of limit points; None leaves these unexplained.
            control: Steps.
        """
        self.problem, self.points, self.control = problem, points, control
        self.monitor: Callable[[], None] | None = None
        self.present: BranchState | None = None
        self._ending: Ending | None = None
        self._accepted = 0

    def follow(
        self,
        critical: CriticalPoint,
        bounds: tuple[float, float],
        longest: float = LONGEST,
    ) -> Iterator[PathPoint]:
        """Yield the states of the branch, stable or not, limit points included (collective).

        Args:
            critical: The bifurcation; the state beside it is the first.
            bounds: The branch is followed while t_n lies between them.
            longest: Longest arc.
        """
        self.problem.shell.set_time(critical.at)
        chart = critical.state
        equations = ShellEquations(self.problem, chart)
        continuation = Continuation(equations, self.control, monitor=self.monitor)
        motion = equations.pack_motion(critical.mode)
        motion /= math.sqrt(equations.inner(motion, motion))
        last: PathState | None = None
        for push in PUSHES:
            guess = equations.pack(critical.mode.moved(chart, push))
            across = Direction(math.copysign(1.0, push) * motion, 0.0)
            last = continuation.start(guess, critical.at, across)
            if last is not None:
                break
        if last is None:
            self._ending = Ending(critical.at, min(map(abs, PUSHES)), None)
            return
        yield self._bifurcation(equations, critical)
        point = self._point(equations, last)
        self._note(equations, point, last, None, 0)
        yield point
        yield from self._onward(equations, point, last, None, 0, bounds, longest)

    def resume(
        self, saved: BranchState, bounds: tuple[float, float], longest: float = LONGEST
    ) -> Iterator[PathPoint]:
        """Yield the states of the branch beyond one of them; see ``follow`` (collective)."""
        self.present, self._accepted = saved, saved.accepted
        equations = ShellEquations(self.problem, saved.state)
        t_n, dt, arc, iterations = saved.numbers
        x = equations.pack(saved.state)
        last = PathState(t_n, x, equations.pack(saved.along), dt, arc, iterations)
        before = None
        if saved.before is not None and saved.numbers_before is not None:
            dt, arc = saved.numbers_before
            before = PathState(t_n, x, equations.pack(saved.before), dt, arc)
        yield from self._onward(equations, saved.point, last, before, saved.count, bounds, longest)

    def _onward(
        self,
        equations: ShellEquations,
        point: PathPoint,
        last: PathState,
        before: PathState | None,
        count: int,
        bounds: tuple[float, float],
        longest: float,
    ) -> Iterator[PathPoint]:
        """Yield the states after ``point``, whose solution is ``last`` (collective).

        ``count`` steps were made in its chart.
        """
        while last.arc < longest:
            if count >= CHART:
                chart = self.problem.shell.with_updated_directors(equations.unpack(last.x))
                equations = ShellEquations(self.problem, chart)
                last, before, count = replace(last, x=equations.pack(chart)), None, 0
            continuation = Continuation(equations, self.control, monitor=self.monitor)
            steps = continuation.onward(
                last, bounds[1], lowest=bounds[0], longest=longest, before=before
            )
            for found in steps:
                if not bounds[0] < found.t < bounds[1]:
                    return
                reached, point = point, self._point(equations, found)
                count += 1
                if not found.is_fold:
                    before, last = last, found
                    self._note(equations, point, last, before, count)
                else:
                    point = self._explained(reached, point)
                yield point
                if count >= CHART and not found.is_fold:
                    break
            else:
                self._ending = None if last.arc >= longest else continuation.ending
                return

    def _note(
        self,
        equations: ShellEquations,
        point: PathPoint,
        last: PathState,
        before: PathState | None,
        count: int,
    ) -> None:
        """Note what the branch beyond a state depends on (collective)."""
        self.present = BranchState(
            point,
            self._accepted,
            equations.unpack(last.x),
            equations.unpack(last.dx),
            None if before is None else equations.unpack(before.dx),
            (last.t, last.dt, last.arc, last.iterations - last.turns),
            None if before is None else (before.dt, before.arc),
            count,
        )

    @property
    def is_empty(self) -> bool:
        """Whether no state has been found on it."""
        return self._accepted == 0

    def _bifurcation(self, equations: ShellEquations, critical: CriticalPoint) -> PathPoint:
        """Return the state beside a bifurcation as the first point of its branch (collective)."""
        residual = equations.linearise(equations.pack(critical.state), critical.at).residual
        return PathPoint(
            critical.at,
            critical.state,
            False,
            sum(value < 0 for value in critical.eigenvalues),
            0,
            residual,
            self.problem.shell.energy(critical.state),
            (critical,),
        )

    def _point(self, equations: ShellEquations, solution: PathState) -> PathPoint:
        """Return a solution as a point of a path; the tangent is that of its last iterate."""
        shell, state = self.problem.shell, equations.unpack(solution.x)
        shell.set_time(solution.t)
        inertia = self.problem.inertia()
        self._accepted += 1
        return PathPoint(
            solution.t,
            shell.with_updated_directors(state),
            False,
            None if inertia is None else inertia.negative,
            solution.iterations,
            solution.residual,
            shell.energy(state),
        )

    def _explained(self, before: PathPoint, fold: PathPoint) -> PathPoint:
        """Return a limit point with its mode, as far as stability is known (collective)."""
        if self.points is None or before.negative_eigenvalues is None:
            return fold
        known = Known(before.t_n, before.state, before.negative_eigenvalues)
        critical = self.points.at_limit_point(known, fold.t_n, fold.state)
        return replace(fold, critical=(critical,))

    def failure(self) -> OpticCupError | None:
        """Return why the branch could not be followed any farther, None if it was."""
        ending = self._ending
        if ending is None:
            return None
        lost = None if ending.cause is None else ending.cause.__cause__
        if isinstance(lost, LostPlaceError):
            fibre, place = lost.place
            closure = self.problem.shell.closure
            return ClosureBreakdown(
                closure, fibre.layer, fibre.height, [*map(float, place)], ending.t
            )
        reason = f"arc length step below {ending.step:.2g}"
        return ConvergenceError(reason, ending.t, self._accepted, 0, float("nan"))
