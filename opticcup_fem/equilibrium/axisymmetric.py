"""Load stepping along the axisymmetric equilibria, stable against motions of m >= 1 or not.

An unsymmetric mesh rounds every bifurcation off: the computed path bends towards the motion that
becomes critical, and turns back.  Extrapolating from the azimuthal means of the states, with a
step over what lies right beside the bifurcation, leads back to the axisymmetric states behind it.
"""

from __future__ import annotations

from collections.abc import Sequence

from opticcup_fem.equilibrium.critical import CriticalPoint, CriticalPoints, Known
from opticcup_fem.equilibrium.jumps import Relaxation
from opticcup_fem.equilibrium.newton import MixedNewton
from opticcup_fem.equilibrium.path import (
    Attempt,
    LoadStepping,
    PathEnd,
    PathPoint,
)
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.steps import History, StepControl
from opticcup_fem.shell.model import ShellState

LEAPS = (1.0, 1.6, 2.5, 4.0, 6.0)
"""Steps over a bifurcation that are tried one after the other, over the first step in t_n."""

LONG_BEFORE = 0.25
"""Steps shorter than this share of the first step are not tried before a leap."""


class AxisymmetricStepping(LoadStepping):
    """Follows axisymmetric states through losses of stability in m >= 1; jumps at limit points."""

    memory = 12

    def __init__(
        self,
        problem: Problem,
        newton: MixedNewton,
        relaxation: Relaxation,
        control: StepControl,
        critical: CriticalPoints,
    ) -> None:
        """Keep the parts; see ``LoadStepping``.

        Args:
            problem: The shell's global problem.
            newton: Solver of one state; beside a bifurcation its residual wanders.
            relaxation: Way down from a limit point.
            control: Step control.
            critical: Localises and classifies critical points.
        """
        super().__init__(problem, newton, relaxation, control, critical)
        self._points = critical
        self._losses: dict[float, CriticalPoint] = {}

    def _admits(self, state: Known, before: PathPoint | None) -> bool:
        if before is not None and before.negative_eigenvalues == state.negative:
            return True
        return 0 not in self._points.negative_by_wavenumber(state)

    def _passed(self, before: PathPoint | None, after: PathPoint) -> tuple[CriticalPoint, ...]:
        if before is None:
            return ()
        counts = before.negative_eigenvalues, after.negative_eigenvalues
        if counts[0] is None or counts[1] is None or counts[0] == counts[1]:
            return ()
        low = Known(before.t_n, before.state, counts[0])
        high = Known(after.t_n, after.state, counts[1])
        found = tuple(self._points.between(low, high))
        self.problem.shell.set_time(after.t_n)
        return found

    def _remembered(self, point: PathPoint) -> ShellState:
        return self._points.symmetrise(point.state)

    def _gives_up(
        self,
        step: float,
        states: Sequence[tuple[float, ShellState]],
        t_n: float,
        attempt: Attempt,
    ) -> bool:
        if super()._gives_up(step, states, t_n, attempt):
            return True
        if step > LONG_BEFORE * self.control.initial:
            return False
        return self._ahead(states, t_n, attempt).content.wavenumber > 0

    def _ahead(
        self, states: Sequence[tuple[float, ShellState]], t_n: float, attempt: Attempt
    ) -> CriticalPoint:
        """Return the critical point ahead of the last state, computed once (collective)."""
        last = states[-1][0]
        if last not in self._losses:
            self._losses = {last: self._points.at_loss(states, (t_n, attempt.unstable))}
        return self._losses[last]

    def _leave(
        self, history: History, t_n: float, attempt: Attempt, point: PathPoint
    ) -> PathPoint | None:
        """Leap over a bifurcation, or leave the last state at a limit point (collective)."""
        if self._ahead(history.states, t_n, attempt).content.wavenumber == 0 and point.stable:
            return super()._leave(history, t_n, attempt, point)
        for leap in LEAPS:
            target = history.ahead(leap * self.control.initial)
            guess = history.predict_far(target, self.control.initial)
            found = self._attempt(target, guess, point).point
            if found is not None:
                return found
        self.end = PathEnd(t_n, attempt.solution)
        return None
