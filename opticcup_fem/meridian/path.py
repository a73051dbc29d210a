"""Whole axisymmetric paths in t_n: states, their numbers and their stability."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from opticcup_fem.equilibrium.continuation import ArcControl, Continuation, PathState
from opticcup_fem.errors import (
    ClosureBreakdown,
    ConvergenceError,
    OpticCupError,
    UnbalancedLayer,
)
from opticcup_fem.meridian.ellipticity import ellipticity
from opticcup_fem.meridian.problem import MeridianProblem
from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.meridian.transport import commit, settle
from opticcup_fem.meridian.waves import Spectrum, Waves
from opticcup_fem.shell.fibres import LostFibre

LOOSE = 1e-3
"""Newton step, in arc length, to which a state is solved that growth with flux is yet to follow."""

LOWEST = -0.1
"""A deeply inverted cap may pass through t_n < 0, as one that stays inverted without growth does;
the laws of growth go on to there."""

NEARLY_LOST = 0.05
"""Share of the stiffness against short waves at t_n = 0 that explains the end of a path."""


@dataclass(frozen=True)
class MeridianPoint:
    """An equilibrium on the path, stable or not.

    Attributes:
        path: The solution in the continuation's terms.
        state: The same as a state of the shell.
        spectra: Eigenvalues in each wavenumber; of a limit point the vanishing eigenvalue counts as
            negative or not by its last digits.
        followed: Whether a cup that loses its axisymmetric stability at a limit point, falls to
            the next axisymmetrically stable state of this path, and never goes back in time
            passes here.
        jump: Whether it arrives here by such a fall.
    """

    path: PathState
    state: MeridianState
    spectra: dict[int, Spectrum]
    followed: bool
    jump: bool

    @property
    def t_n(self) -> float:
        """Normalised time."""
        return self.path.t

    @property
    def negative(self) -> dict[int, int]:
        """Number of negative eigenvalues in each wavenumber."""
        return {m: spectrum.negative for m, spectrum in self.spectra.items()}

    @property
    def stable(self) -> bool:
        """Whether no eigenvalue of any wavenumber is negative; of a limit point, none but its."""
        return all(count == 0 for m, count in self.negative.items() if m or not self.path.is_fold)


class MeridianPath:
    """Follows the path of a shell from t_n = 0.

    Attributes:
        problem: The shell's equations.
        waves: Its second variations.
        continuation: Their continuation, also used to find states between two others.
    """

    def __init__(
        self, shell: MeridianShell, waves: Waves, control: ArcControl | None = None
    ) -> None:
        """Set the continuation up.

        Args:
            shell: The shell.
            waves: Second variations of its states; m = 0 is among them.
            control: Steps along the path.
        """
        self.problem, self.waves = MeridianProblem(shell), waves
        balance = shell.balance
        self.continuation = Continuation(
            self.problem,
            control or ArcControl(),
            settle=None if balance is None else self.problem.settle,
            loose=LOOSE if balance is not None and balance.has_flux else 0.0,
        )
        self._accepted = 0
        self._last: MeridianState | None = None
        self._first_stiffness = 0.0

    def count_iterations(self, count: Callable[[], None]) -> None:
        """Have ``count`` called at every Newton iteration."""
        self.continuation.monitor = count

    def follow(self, t_end: float, times: Sequence[float] = ()) -> Iterator[MeridianPoint]:
        """Yield all states in their order along the path, limit points included.

        Args:
            t_end: The path ends where it first has this t_n.
            times: Normalised times to land on, on every passage.
        """
        x = self.problem.pack(self.problem.shell.reference_state())
        front, fell = -1.0, False
        landings = [t for t in times if t > 0]
        for solution in self.continuation.follow(x, 0.0, t_end, landings, lowest=LOWEST):
            state = self.problem.unpack(solution.x)
            settle(self.problem.shell, state, solution.t)
            if self._last is None:
                self._first_stiffness = ellipticity(self.problem.shell, state, solution.t).value
            spectra = self.waves.spectra(state, solution.t)
            keeps = solution.t > front and not fell
            arrives = fell and solution.t >= front and solution.dt > 0 and not spectra[0].negative
            followed = keeps or (arrives and not solution.is_fold)
            self._accepted += 1
            self._last = state
            yield MeridianPoint(solution, state, spectra, followed, followed and fell)
            if followed and solution.t not in landings:
                commit(self.problem.shell, state, solution.t)
            if followed:
                front, fell = solution.t, solution.is_fold

    def point_between(
        self, low: MeridianPoint, high: MeridianPoint, share: float
    ) -> tuple[PathState, MeridianState]:
        """Return the state at a share of the arc between two neighbouring points.

        Raises:
            ConvergenceError: Newton's method found none.
        """
        found = self.continuation.between(low.path, high.path, share)
        if found is None:
            raise ConvergenceError("no state between two neighbours", low.t_n, 0, 0, float("nan"))
        return found, self.problem.unpack(found.x)

    def failure(self) -> OpticCupError | None:
        """Return why the path ended early, None if it did not."""
        ending = self.continuation.ending
        if ending is None:
            return None
        lost = None if ending.cause is None else ending.cause.__cause__
        if isinstance(lost, UnbalancedLayer):
            return lost
        if isinstance(lost, LostFibre):
            shell = self.problem.shell
            cell, point = divmod(lost.index, shell.points.shape[1])
            assert self._last is not None
            r, z = shell.basis[cell, point] @ self._last.r[shell.mesh.cells[cell]]
            return ClosureBreakdown(shell.closure, lost.layer, lost.height, (r, 0.0, z), ending.t)
        reason = f"arc length step below {ending.step:.2g}"
        if self._last is not None:
            least = ellipticity(self.problem.shell, self._last, ending.t)
            if least.value < NEARLY_LOST * self._first_stiffness:
                r, z = least.position
                reason += (
                    f", and at (r, z) = ({r:.4g}, {z:.4g}) the closure "
                    f"{self.problem.shell.closure} hardly resists short waves any more"
                )
        return ConvergenceError(reason, ending.t, self._accepted, 0, float("nan"))
