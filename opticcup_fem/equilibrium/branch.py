"""The branch that leaves a bifurcation, by arc length through all its limit points."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

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
from opticcup_fem.equilibrium.path import PathPoint
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


class BranchStepping:
    """Follows the axisymmetric states to their first bifurcation, and then what branches off."""

    def __init__(self, stem: AxisymmetricStepping, branch: BranchPath) -> None:
        """Keep the two parts.

        Args:
            stem: Stepping along the axisymmetric states.
            branch: The branch that leaves them.
        """
        self.problem, self._stem, self._branch = stem.problem, stem, branch

    def count_iterations(self, count: Callable[[], None]) -> None:
        """Have ``count`` called at every Newton iteration and relaxation step."""
        self._stem.count_iterations(count)
        self._branch.monitor = count

    def follow(
        self, state: ShellState, t_end: float, times: Sequence[float] = ()
    ) -> Iterator[PathPoint]:
        """Yield the states up to the first loss of symmetry, and those of the branch.

        Args:
            state: First guess of the equilibrium at t_n = 0.
            t_end: Last normalised time of both.
            times: Normalised times to land on before the bifurcation.
        """
        for point in self._stem.follow(state, t_end, times):
            lost = [one for one in point.critical if one.kind == "bifurcation" and one.lost]
            if lost:
                yield from self._branch.follow(lost[0], (0.0, t_end))
                return
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
        yield point
        while last.arc < longest:
            continuation = Continuation(equations, self.control, monitor=self.monitor)
            steps = continuation.onward(last, bounds[1], lowest=bounds[0], longest=longest)
            for count, last in enumerate(steps, start=1):
                if not bounds[0] < last.t < bounds[1]:
                    return
                before, point = point, self._point(equations, last)
                if last.is_fold:
                    point = self._explained(before, point)
                yield point
                if count >= CHART and not last.is_fold:
                    break
            else:
                self._ending = None if last.arc >= longest else continuation.ending
                return
            chart = self.problem.shell.with_updated_directors(equations.unpack(last.x))
            equations = ShellEquations(self.problem, chart)
            last = replace(last, x=equations.pack(chart))

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
