"""Load stepping in t_n along stable equilibria, with jumps where stability is lost."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from opticcup_fem.equilibrium.critical import CriticalPoint, CriticalPoints, Known
from opticcup_fem.equilibrium.descents import Descents
from opticcup_fem.equilibrium.jumps import Relaxation
from opticcup_fem.equilibrium.newton import CONTACT_AHEAD, MOST_TURNS, MixedNewton, Solution
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.relaxation import Relaxed, Stays
from opticcup_fem.equilibrium.spectrum import Mode
from opticcup_fem.equilibrium.stability import NegativeEigenvalues
from opticcup_fem.equilibrium.steps import Course, History, StepControl
from opticcup_fem.equilibrium.tangent import on_tangent
from opticcup_fem.equilibrium.transport import begin_step, commit, settle
from opticcup_fem.errors import (
    CaseError,
    ClosureBreakdown,
    ConvergenceError,
    OpticCupError,
    UnbalancedLayer,
)
from opticcup_fem.shell.model import ShellState

PUSHES = (0.01, 0.02, 0.04, 0.08, 0.16)
"""Moves along a critical mode, largest of a node over R, that are tried one after the other until
relaxation leaves the path that lost its stability."""

LARGEST_ACROSS = 1e-6
"""Largest force on a node, unit mu_IOV R^2, that keeping mirrors may take up: rounding is 1e-12."""

LOST_MOVE = 2.0
"""Distance from the guess, over a jump, at which a descent on a long step is given up."""

TANGENT_STEP = 1e-4
"""Difference in t_n that gives the tangent of a path."""

LEAST_WAY = 0.75
"""Share of the way to a guess that must be free of contact: else a shorter step costs less than the
way that is left for Newton's method."""


@dataclass(frozen=True)
class PathPoint:
    """An accepted equilibrium.

    Attributes:
        t_n: Normalised time.
        state: The equilibrium.
        jump: Whether it was reached by relaxation from a state that had lost its stability.
        negative_eigenvalues: Of the tangent; None where they were not counted.
        iterations: Newton iterations or descent steps that the point took, failures included.
        residual: Norm of the residual.
        energy: Strain energy (for closures without one: the integral of Psi_0).
        critical: The critical points between the point before and this one.
    """

    t_n: float
    state: ShellState
    jump: bool
    negative_eigenvalues: int | None
    iterations: int
    residual: float
    energy: float
    critical: tuple[CriticalPoint, ...] = ()

    @property
    def stable(self) -> bool:
        """Whether no negative eigenvalue is known."""
        return not self.negative_eigenvalues


@dataclass(frozen=True)
class Attempt:
    """One Newton solve: an accepted point, an equilibrium that is not accepted, or neither.

    Where there was nothing to solve for, ``unbalanced`` tells why.
    """

    solution: Solution
    point: PathPoint | None = None
    unstable: ShellState | None = None
    unbalanced: UnbalancedLayer | None = None


@dataclass(frozen=True)
class PathEnd:
    """Why a path ended before its end.

    Attributes:
        t_n: Normalised time of the last attempt.
        attempt: The last attempt.
        unbalanced: The mass balance that has no solution, where that was the reason.
        critical: The critical point at which stability was lost, where it was looked for.
    """

    t_n: float
    attempt: Solution | Relaxed
    unbalanced: UnbalancedLayer | None = None
    critical: CriticalPoint | None = None


@dataclass(frozen=True)
class SteppingState:
    """All that the path beyond an accepted point depends on.

    Attributes:
        point: The point.
        accepted: Number of accepted steps.
        dt: Length of the next step, unless the history limits it.
        states: Normalised times and states from which the path is extrapolated.
        blocked: Signed time that a step failed to reach, inf for none.
        lost_by: Time by which stability was found to be lost, None where it was not.
    """

    point: PathPoint
    accepted: int
    dt: float
    states: tuple[tuple[float, ShellState], ...]
    blocked: float
    lost_by: float | None


class LoadStepping:
    """Follows stable equilibria as growth goes on, or as it is undone.

    Attributes:
        end: Set when the path could not be followed to its end.
        accepted: Number of accepted steps.
        present: What the path beyond the last point that was yielded depends on.
        memory: Number of states from which the path is extrapolated.
    """

    memory = 3

    def __init__(
        self,
        problem: Problem,
        newton: MixedNewton,
        relaxation: Relaxation,
        control: StepControl,
        critical: CriticalPoints | None = None,
        switch_wavenumber: int = 0,
    ) -> None:
        """Keep the parts.

        Args:
            problem: The shell's global problem.
            newton: Solver of one state.
            relaxation: Way down from a lost state.
            control: Step control.
            critical: Localises and classifies critical points; None leaves them unexplained.
            switch_wavenumber: m of the mode along which a state is left at a bifurcation; 0 for
                the critical mode.
        """
        self.problem, self.newton, self.relaxation = problem, newton, relaxation
        self.control, self.critical = control, critical
        self.switch_wavenumber = switch_wavenumber
        spectrum = None if critical is None else critical.spectrum
        self._negative_eigenvalues = NegativeEigenvalues(newton, spectrum)
        self.end: PathEnd | None = None
        self.accepted = 0
        self._descents = Descents(control.smallest)
        self.present: SteppingState | None = None

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
        if self.end.unbalanced is not None:
            return self.end.unbalanced
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
        resumed: SteppingState | None = None,
    ) -> Iterator[PathPoint]:
        """Yield the accepted states from ``t_start`` to ``t_end``, exactly at ``times`` too.

        Args:
            state: First guess of the equilibrium at ``t_start``, the first point.
            t_end: Last normalised time; growth is undone where it is less than ``t_start``.
            times: Normalised times to land on.
            t_start: First normalised time.
            resumed: Go on from there instead; its point is not yielded again.
        """
        control = self.control
        course = Course(t_start, t_end, times)
        if resumed is not None:
            point, dt, self.accepted = resumed.point, resumed.dt, resumed.accepted
            self._descents.begin(resumed.lost_by)
            history = History.restored(
                self.problem, course, resumed.states, resumed.blocked, self.memory
            )
        else:
            self._descents.begin()
            first = self._attempt(t_start, state, None)
            if first.point is None:
                self.end = PathEnd(t_start, first.solution)
                return
            point, dt = first.point, control.initial
            history = self._history(course, point)
            self._commit(point)
            self._note(point, dt, history)
            yield point
        spent = 0
        while not course.is_over(point.t_n):
            step = history.limited(dt, control.smallest)
            target, step = course.next(point.t_n, step)
            attempt = self._attempt(target, self._guess(history, target, point), point)
            found, solution = attempt.point, attempt.solution
            spent += solution.iterations
            if found is not None:
                if found.jump or (_touches(found.state) and not _touches(point.state)):
                    history = self._history(course, found)
                else:
                    history.add(found.t_n, self._remembered(found))
                dt = control.after(dt, step, solution.iterations - solution.turns)
            elif self._shows_kink(solution, history, point):
                history = self._history(course, point)
                continue
            elif attempt.unbalanced is not None and step <= control.smallest * (1 + 1e-6):
                self.end = PathEnd(target, solution, attempt.unbalanced)
                return
            elif attempt.unbalanced is not None or not self._gives_up(
                step, history.states, target, attempt
            ):
                history.block(step)
                dt = control.cut * step
                continue
            else:
                found = self._leave(history, target, attempt, point)
                if found is None:
                    return
                spent += found.iterations
                history = self._history(course, found)
                dt = control.initial
            point = replace(found, iterations=spent)
            self._descents.accept(found.jump)
            self.accepted += 1
            spent = 0
            self._commit(point)
            self._note(point, dt, history)
            yield point

    def _commit(self, point: PathPoint) -> None:
        """Set the shell to an accepted point, with its growth (collective).

        Raises:
            CaseError: Mirrors are kept that the tissue does not have.
        """
        self.problem.shell.set_time(point.t_n)
        self._check_mirrors(point)
        commit(self.problem.shell, point.state)

    def _check_mirrors(self, point: PathPoint) -> None:
        """Check that mirrors which are kept are those of the tissue, too (collective).

        Raises:
            CaseError: Keeping them takes a force.
        """
        if not self.problem.unknowns.mirrors:
            return
        force = self.problem.force_across_mirrors(point.state)
        if force > LARGEST_ACROSS:
            raise CaseError(
                f"run.keep_mirrors = true is not possible: at t_n = {point.t_n:.4g} it takes a "
                f"force of {force:.2g} mu_IOV R^2 on a node; layers and growth must be their own "
                "mirror images in x = 0 and y = 0"
            )

    def between(self, low: PathPoint, high: PathPoint, t_n: float) -> PathPoint | None:
        """Return the state at a time between two neighbouring points, None if there is none.

        The shell is left at ``t_n`` (collective).
        """
        share = (t_n - low.t_n) / (high.t_n - low.t_n)
        guess = self.problem.along(low.state, high.state, share)
        lost_by = self._descents.lost_by
        point = self._attempt(t_n, guess, low).point
        self._descents.begin(lost_by)  # as behind any accepted point
        return point

    def _shows_kink(self, failed: Solution, history: History, point: PathPoint) -> bool:
        """Return whether more contact begins than the states before a point tell."""
        is_stopped = failed.reason == CONTACT_AHEAD and _touches(point.state)
        return is_stopped and len(history.states) > 1

    def _guess(self, history: History, t_n: float, point: PathPoint) -> ShellState:
        """Return the guess at ``t_n`` (collective).

        The path has a kink where contact begins, or more of it: the states before tell nothing
        there, but the tangent does.
        """
        if len(history.states) == 1 and _touches(point.state):
            ahead = math.copysign(TANGENT_STEP, t_n - point.t_n)
            near = on_tangent(self.problem, point.state, point.t_n, ahead)
            if near is not None:
                return self.problem.along(point.state, near, (t_n - point.t_n) / ahead)
        return history.predict(t_n)

    def _history(self, course: Course, point: PathPoint) -> History:
        """Return the history of a path that begins with a point (collective)."""
        remembered = self._remembered(point)
        return History(self.problem, course, point.t_n, remembered, self.memory)

    def _note(self, point: PathPoint, dt: float, history: History) -> None:
        """Note what the path beyond a point depends on."""
        states = tuple(history.passed)
        self.present = SteppingState(
            point, self.accepted, dt, states, history.blocked, self._descents.lost_by
        )

    def _attempt(self, t_n: float, guess: ShellState, before: PathPoint | None) -> Attempt:
        """Solve at ``t_n``; accept what is converged, near and stable enough (collective)."""
        near = guess if before is None else before.state
        try:
            return self._solve(t_n, guess, before)
        except UnbalancedLayer as unbalanced:
            failed = Solution(near, False, str(unbalanced), 0, np.nan)
            return Attempt(failed, unbalanced=unbalanced)

    def _solve(self, t_n: float, guess: ShellState, before: PathPoint | None) -> Attempt:
        """See ``_attempt``.

        Raises:
            UnbalancedLayer: A mass balance has no solution.
        """
        shell = self.problem.shell
        begin_step(shell, t_n, guess)
        near = guess if before is None else before.state
        may_shorten = before is not None and not self._descents.is_short(before.t_n, t_n)
        solution = self.newton.solve(
            guess, before=near, least_way=LEAST_WAY if may_shorten else 0.0
        )
        if solution.reason == CONTACT_AHEAD:
            return Attempt(solution)
        if not solution.converged:
            return self._descended(t_n, guess, before, solution) or Attempt(solution)
        if self._moved(solution.state, near) > self.control.max_move:
            return Attempt(solution)
        state = shell.with_updated_directors(solution.state)
        negative = self._negative_eigenvalues.at_solution(state)
        if negative and not self._admits(Known(t_n, state, negative), before):
            descended = self._descended(t_n, guess, before, replace(solution, best=None))
            return descended or Attempt(solution, unstable=state)
        energy = shell.energy(state)
        point = PathPoint(
            t_n, state, False, negative, solution.iterations, solution.residual, energy
        )
        try:
            return Attempt(solution, replace(point, critical=self._passed(before, point)))
        except ConvergenceError:  # too far apart: a shorter step finds them
            return Attempt(solution)

    def _descended(
        self, t_n: float, guess: ShellState, before: PathPoint | None, failed: Solution
    ) -> Attempt | None:
        """Go on by descent where Newton's method wanders, or ends in an unstable state, in touch.

        Where Newton's method came not near, a shorter step is tried first: it costs less.  Descent
        starts where it came nearest, or at the guess.  What comes to rest farther than a jump from
        the guess has lost its stability on the way: it is accepted on a short step only, and not
        looked for again before (collective).

        Returns:
            None where descent is not tried.
        """
        if before is None or not _touches(before.state):
            return None
        if not self._descents.follows(before.t_n, t_n, failed.least):
            return None
        contact = self.problem.contact
        assert contact is not None
        start = failed.best
        if start is None:
            turned = self.problem.with_mean_directors(guess, before.state)
            start, _ = contact.reachable(before.state, turned)
        is_short, most = self._descents.is_short(before.t_n, t_n), self.control.jump_move

        def stays(state: ShellState) -> bool:
            return is_short or self._moved(state, guess) <= LOST_MOVE * most

        relaxed = self._balanced_rest(start, stays)
        spent = replace(failed, iterations=failed.iterations + relaxed.factorisations)
        near = self._moved(relaxed.state, guess) <= most
        if not relaxed.converged or not (near or is_short):
            self._descents.lost_by = t_n
            return Attempt(spent)
        point = PathPoint(
            t_n,
            relaxed.state,
            not near,
            relaxed.negative_eigenvalues,
            spent.iterations,
            relaxed.residual,
            relaxed.energy,
        )
        return Attempt(spent, point)

    def _admits(self, state: Known, before: PathPoint | None) -> bool:
        """Return whether an unstable state may be accepted (collective)."""
        return False

    def _passed(self, before: PathPoint | None, after: PathPoint) -> tuple[CriticalPoint, ...]:
        """Return the critical points between two accepted points (collective)."""
        return ()

    def _remembered(self, point: PathPoint) -> ShellState:
        """Return the state from which later ones are extrapolated (collective)."""
        return point.state

    def _gives_up(
        self,
        step: float,
        states: Sequence[tuple[float, ShellState]],
        t_n: float,
        attempt: Attempt,
    ) -> bool:
        """Return whether, after a failed step, the path is left instead of trying a shorter one."""
        return step <= self.control.smallest * (1 + 1e-6)

    def _leave(
        self, history: History, t_n: float, attempt: Attempt, point: PathPoint
    ) -> PathPoint | None:
        """Leave the last state for a stable one at ``t_n``; None ends the path (collective).

        Past a limit point the descent finds its way by itself.  At a bifurcation the state is
        moved along the critical mode first: by symmetry nothing else would leave the path.  Where
        parts touch, the tangent jumps with every part that touches, and has no critical modes.
        """
        if self.critical is None or _touches(point.state):
            return self._relaxed(point, point.state, t_n, attempt.solution)
        critical = self.critical.at_loss(history.states, (t_n, attempt.unstable))
        starts = [point.state]
        mode = self._way_out(critical, attempt, point)
        if mode is not None:
            starts = [mode.moved(point.state, push) for push in PUSHES]
        spent = 0
        for start in starts:
            found = self._relaxed(point, start, t_n, attempt.solution)
            if found is None:
                assert self.end is not None
                self.end = replace(self.end, critical=critical)
                return None
            spent += found.iterations
            if found.jump:
                break
        assert found is not None
        known = (critical,) if found.jump or attempt.unstable is not None else ()
        return replace(found, iterations=spent, critical=known)

    def _way_out(self, critical: CriticalPoint, attempt: Attempt, point: PathPoint) -> Mode | None:
        """Return the mode to move along, None where the descent finds its way by itself."""
        if critical.kind != "bifurcation":
            return None
        if self.switch_wavenumber and self.critical is not None:
            return self.critical.softest(point.t_n, point.state, self.switch_wavenumber)
        return None if attempt.unstable is None else critical.mode

    def _relaxed(
        self, point: PathPoint, start: ShellState, t_n: float, attempt: Solution
    ) -> PathPoint | None:
        """Relax from ``start`` onto a stable state at ``t_n``; None ends the path (collective)."""
        self.problem.shell.set_time(t_n)
        try:
            relaxed = self._balanced_rest(start)
        except UnbalancedLayer as unbalanced:
            self.end = PathEnd(t_n, attempt, unbalanced)
            return None
        if not relaxed.converged:
            self.end = PathEnd(t_n, relaxed)
            return None
        negative = relaxed.negative_eigenvalues
        if negative is None:  # the flow ends in a solution of Newton's method
            negative = self._negative_eigenvalues.at_solution(relaxed.state)
        return PathPoint(
            t_n,
            relaxed.state,
            self._moved(relaxed.state, point.state) > self.control.jump_move,
            negative,
            relaxed.factorisations,
            relaxed.residual,
            relaxed.energy,
        )

    def _balanced_rest(self, start: ShellState, stays: Stays | None = None) -> Relaxed:
        """Relax from a state, and again while that changes growth by mass balance (collective).

        Args:
            start: The state.
            stays: Tells of a state on the way whether it is worth going on from there.

        Raises:
            UnbalancedLayer: A mass balance has no solution on the way.
        """
        relaxed = self.relaxation.relax(start, stays)
        spent = relaxed.factorisations
        for _ in range(MOST_TURNS):
            if not relaxed.converged or not settle(self.problem.shell, relaxed.state):
                return replace(relaxed, factorisations=spent)
            relaxed = self.relaxation.relax(relaxed.state, stays)
            spent += relaxed.factorisations
        return replace(relaxed, converged=False, factorisations=spent)

    def _moved(self, after: ShellState, before: ShellState) -> float:
        """Return the largest move of a node between two states (collective)."""
        return self.problem.largest(np.linalg.norm(after.r - before.r, axis=1))


def _touches(state: ShellState) -> bool:
    return state.contact is not None and state.contact.touches
