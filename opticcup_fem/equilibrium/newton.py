"""One equilibrium: Newton's method on the mixed shell, driven by PETSc SNES.

SNES sees the condensed unknowns u = (r, alpha); curvature and multiplier are carried along with
every step (``condensation``), so that the iterates are those of the uncondensed system.  Full
steps, no line search on the residual: it may rise by four orders of magnitude in the first
iteration of a good solve.  The only cut is to stay admissible: a step that would turn a layer
inside out is halved.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.equilibrium.problem import Inertia, Problem
from opticcup_fem.equilibrium.transport import settle
from opticcup_fem.shell.condensation import CondensedCells
from opticcup_fem.shell.model import LostPlace, ShellState

Array = NDArray[np.float64]
Reason = PETSc.SNES.ConvergedReason

DIVERGED_RESIDUAL = 1e8
"""A residual above this (unit: mu_IOV R^2) has left every basin of attraction."""

NEAR_SOLUTION = 1e-5
"""The inertia at an iterate of a smaller residual (unit: mu_IOV R^2) is that of the solution."""

MARGIN = 0.3
"""Share of the tolerance that a step with the tangent of the iterate before is to end below."""

SMALLEST_FRACTION = 0.02
"""Newton steps are not cut below this fraction."""

MOST_IDLE = 5
"""Iterations without a smaller residual that end a solve with contact: it goes to and fro between
pairs that touch and do not, and descent goes on better."""

LONGEST_IN_TOUCH = 0.1
"""Longest move of a node in one iteration where things touch, unit of length of the mesh: a tangent
of contact knows nothing of the pairs that a long step would meet."""

MOST_RENEWALS = 30
"""Solves for one state while faces and obstacles are brought up to date."""

SETTLING = 1e-3
"""Residual, unit mu_IOV R^2, below which contact data are brought up to date within a solve."""

CONTACT_AHEAD = "CONTACT_AHEAD"
"""Reason of a solve that was not begun: contact stops the way to its first iterate too early."""


MOST_TURNS = 20
"""Solves for one state while growth by mass balance is brought up to date."""

LOOSE = 1e-4
"""Residual, unit mu_IOV R^2, to which a deformation is solved that growth with flux is yet to
follow."""

WANDERING = 10.0
"""A residual this many times the smallest one before ends a solve; measured on growing cups."""


class Drag(NamedTuple):
    """Viscous term rate M (u - u_start) of a backward Euler step.

    Attributes:
        mass: Diagonal of M.
        rate: One over the step of fictitious time.
    """

    mass: PETSc.Vec
    rate: float


@dataclass(frozen=True)
class Solution:
    """Outcome of one Newton solve.

    Attributes:
        state: Last iterate; an equilibrium only where ``converged``.
        converged: Whether the residual fell below the tolerance.
        reason: PETSc's name of the reason, "LOST_FIBRE" where no admissible step exists, or
            ``CONTACT_AHEAD``.
        iterations: Newton iterations, each one factorisation, but for the first of a turn in which
            the deformation follows growth with flux, and for a last one that the tangent before
            serves well enough.
        residual: Final residual norm.
        lost: The fibre that allowed no step, and its place, where that was the reason.
        best: The iterate with the smallest residual, None where none was admissible.
        least: Its residual norm.
        turns: Iterations among these that followed changes of growth by mass balance.
    """

    state: ShellState
    converged: bool
    reason: str
    iterations: int
    residual: float
    lost: LostPlace | None = None
    best: ShellState | None = None
    least: float = np.inf
    turns: int = 0


class MixedNewton:
    """Reusable Newton solver of a problem."""

    def __init__(
        self,
        problem: Problem,
        tolerance: float = 1e-8,
        max_iterations: int = 15,
        wandering: float = WANDERING,
    ) -> None:
        """Set SNES up.

        Args:
            problem: Assembly and factorisation.
            tolerance: Absolute tolerance on the norm of all residuals, condensed and local.
            max_iterations: Iterations after which a solve is given up.
            wandering: A residual this many times the smallest one since the second iteration
                ends a solve: beyond a limit point the iteration wanders for ever.  The default
                is measured on growing cups; large rotations under dead loads need ``inf``.
        """
        self.problem, self.wandering = problem, wandering
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self._target = tolerance
        self._keeps_tangent = False
        self.monitor: Callable[[int, float], None] | None = None
        self._residual = problem.vector.duplicate()
        self._x = problem.vector.duplicate()
        self._snes = self._make_snes()

    def _make_snes(self) -> PETSc.SNES:
        problem = self.problem
        options = PETSc.Options()
        snes = PETSc.SNES().create(problem.comm)
        prefix = f"opticcup_{id(self):x}_"
        snes.setOptionsPrefix(prefix)
        options[f"{prefix}snes_linesearch_type"] = "basic"
        # the residual may grow by orders of magnitude: no test of divergence (-3 switches it off)
        options[f"{prefix}snes_divergence_tolerance"] = -3
        snes.setType(PETSc.SNES.Type.NEWTONLS)
        snes.setFunction(self._function, self._residual)
        snes.setJacobian(self._jacobian, problem.matrix)
        snes.setKSP(problem.ksp)
        snes.setFromOptions()
        for key in ("snes_linesearch_type", "snes_divergence_tolerance"):
            options.delValue(prefix + key)
        snes.setTolerances(max_it=self.max_iterations)
        snes.setConvergenceTest(self._converged)
        snes.setLineSearchPreCheck(self._shorten)
        return snes

    def solve(
        self,
        state: ShellState,
        drag: Drag | None = None,
        before: ShellState | None = None,
        least_way: float = 0.0,
    ) -> Solution:
        """Solve for equilibrium at the shell's present growth, starting at ``state`` (collective).

        Args:
            state: First iterate.
            drag: Viscous term against moving away from ``state``.
            before: An equilibrium from which ``state`` was guessed.  Where contact is resisted, the
                solution is one that can be reached from there, and no contact is evaluated on a
                way on which nothing touches.
            least_way: Share of the way from ``before`` that must be free, where contact is
                evaluated, for a solve to be begun.

        Where layers grow by their mass balance, growth and deformation are solved for in turn until
        neither changes the other; with flux, the deformation loosely until growth has settled,
        each turn beginning with the tangent of the one before.

        Returns:
            The outcome; a failure is a value, not an exception.

        Raises:
            UnbalancedLayer: A mass balance has no solution.
        """
        balance = self.problem.shell.balance
        coupled = balance is not None and balance.has_flux and drag is None
        self._target = max(LOOSE, self.tolerance) if coupled else self.tolerance
        self._keeps_tangent = False
        solution = self._solve_at_growth(state, drag, before, least_way)
        spent, balanced = solution.iterations, solution
        for _ in range(MOST_TURNS):
            if drag is not None or not balanced.converged:
                return replace(balanced, iterations=spent, turns=spent - solution.iterations)
            if not self._settle(balanced.state):
                if self._target == self.tolerance:
                    return replace(balanced, iterations=spent, turns=spent - solution.iterations)
                self._target = self.tolerance
            self._keeps_tangent = spent > 0 and self._target > self.tolerance
            balanced = self._solve_at_growth(balanced.state, None, before)
            spent += balanced.iterations
        return replace(balanced, converged=False, reason="MASS_NOT_SETTLED", iterations=spent)

    def _settle(self, state: ShellState) -> bool:
        """Solve the mass balance in a state; return whether growth changed (collective)."""
        shell = self.problem.shell
        return shell.balance is not None and settle(shell, state)

    def _solve_at_growth(
        self,
        state: ShellState,
        drag: Drag | None,
        before: ShellState | None,
        least_way: float = 0.0,
    ) -> Solution:
        """Solve for equilibrium with the growth as it is (collective)."""
        problem, contact = self.problem, self.problem.contact
        if contact is None:
            return self._solve(state, drag)
        problem.forget_contacts()
        before = problem.with_contact(state if before is None else before)
        state = replace(state, contact=before.contact)
        spent = 0
        if before.contact is not None and not before.contact.touches:
            problem.awake = False
            solution = self._solve(state, drag)
            problem.awake = True
            if not solution.converged:
                return solution
            passed = contact.passes(before, solution.state)
            if passed is not None:
                return replace(solution, state=passed)
            spent, state = solution.iterations, solution.state
        state, share = contact.reachable(before, state)
        if share < least_way:
            return Solution(state, False, CONTACT_AHEAD, spent, np.nan)
        if share < 1.0:
            state = problem.with_mean_directors(state, before)
        for _ in range(MOST_RENEWALS):
            solution = self._solve(state, drag)
            spent += solution.iterations
            if not solution.converged:
                return replace(solution, iterations=spent)
            state, done = contact.renewed(solution.state)
            if done:
                return replace(solution, state=state, iterations=spent)
        return replace(solution, converged=False, reason="CONTACT_NOT_SETTLED", iterations=spent)

    def _solve(self, state: ShellState, drag: Drag | None) -> Solution:
        """Solve with contact data as they are (collective)."""
        self._state, self._drag = state, drag
        self._cells: CondensedCells | None = None
        self._resultants, self._lost = self.problem.shell.evaluate(state)
        self._norm = self._smallest = self._factorised_norm = self._best_norm = np.inf
        self._best: ShellState | None = None
        self._best_iteration, self._is_renewed = 0, False
        self._x.array[:] = self.problem.unknowns.owned_values(state.r, state.alpha)
        self._start = self._x.array.copy()
        self._snes.solve(None, self._x)
        reason = self._snes.getConvergedReason()
        name = _reason_name(reason) if self._lost is None else "LOST_FIBRE"
        return Solution(
            self._state,
            reason > 0 and self._lost is None,
            name,
            self._snes.getIterationNumber(),
            self._norm,
            self._lost,
            self._best,
            self._best_norm,
        )

    def inertia(self) -> Inertia | None:
        """Return the inertia of the tangent at the last solution (collective).

        SNES factorises at iterates, of which the solution is not one.  The last of them serves
        where its residual was small already; else the tangent is factorised at the solution.  Of
        a tangent that is not symmetric that of the symmetric part is returned: no negative
        eigenvalue means stable, some need not mean unstable (``NegativeEigenvalues``).

        Returns:
            None where there was no admissible iterate.
        """
        if self._cells is None:
            return None
        if not self.problem.symmetric:
            return self.problem.inertia_of_symmetric_part(self._cells)
        if self._factorised_norm > NEAR_SOLUTION:
            self.problem.assemble_tangent(self._cells, self.problem.contact_stiffness(self._state))
            self.problem.factorise()
        return self.problem.inertia()

    # --- callbacks ----------------------------------------------------------------------------

    def _function(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        """Return the condensed residual at ``x``, where ``_shorten`` has moved the state."""
        problem = self.problem
        if self._resultants is None:
            self._norm = np.inf
            f.set(np.inf)
            return
        self._cells = problem.shell.condensed(self._state, self._resultants)
        problem.assemble_gradient(self._cells, self._state, f)
        if self._drag is not None:
            f.array[:] += self._drag.rate * self._drag.mass.array_r * (x.array_r - self._start)
        local = self._cells.local_residual(self._state.sigma)
        local_square = sum(float(np.sum(part * part)) for part in local)
        total = problem.comm.allreduce(local_square + float(np.sum(f.array_r**2)))
        self._norm = float(np.sqrt(total))

    def _jacobian(
        self, snes: PETSc.SNES, x: PETSc.Vec, matrix: PETSc.Mat, preconditioner: PETSc.Mat
    ) -> None:
        assert self._cells is not None
        if self._keeps_tangent and snes.getIterationNumber() == 0:
            return  # that of the last turn is near enough for one step
        near = self._factorised_norm
        if near < NEAR_SOLUTION and self._norm * (self._norm / near) < self._target * MARGIN:
            return  # the last one leads below the tolerance, too
        self.problem.assemble_tangent(self._cells, self.problem.contact_stiffness(self._state))
        if self._drag is not None:
            self.problem.add_diagonal(self._drag.mass, self._drag.rate)
        self._factorised_norm = self._norm if self._drag is None else np.inf

    def _shorten(self, x: PETSc.Vec, y: PETSc.Vec) -> bool:
        """Halve the step y (the iterate becomes x - y) until every layer stays admissible.

        It goes no farther than contact allows.  Moves the state to the iterate.
        """
        problem, full = self.problem, -y.array_r.copy()
        assert self._cells is not None
        moves, _ = problem.unknowns.split(problem.unknowns.to_local(full))
        fraction = self._bound_in_touch(moves)
        fraction *= problem.free_fraction(self._state, fraction * moves)
        allowed = fraction
        while True:
            trial = problem.stepped(self._state, self._cells, fraction * full, fraction)
            self._resultants, self._lost = problem.shell.evaluate(trial)
            free = fraction == allowed or problem.is_free(self._state, trial)
            if (self._lost is None and free) or fraction < SMALLEST_FRACTION:
                break
            fraction /= 2
        self._state = self._brought_up_to_date(trial)
        if fraction < 1.0:
            y.scale(fraction)
        return fraction < 1.0

    def _brought_up_to_date(self, state: ShellState) -> ShellState:
        """Return a state near the solution with contact data that are up to date (collective).

        Done once on the way, this saves the solve that they would call for behind it.
        """
        contact = self.problem.contact
        if contact is None or not self.problem.awake or self._is_renewed or self._norm > SETTLING:
            return state
        self._is_renewed = True
        return contact.renewed(state)[0]

    def _bound_in_touch(self, moves: Array) -> float:
        """Return the share of a step that is no longer than touching parts may go (collective)."""
        contact = self._state.contact
        if contact is None or not (self.problem.awake and contact.touches):
            return 1.0
        longest = self.problem.largest(np.linalg.norm(moves, axis=1))
        return min(1.0, LONGEST_IN_TOUCH / longest) if longest > 0 else 1.0

    def _converged(
        self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]
    ) -> Any:
        if self.monitor is not None:
            self.monitor(iteration, self._norm)
        if self._lost is not None or not np.isfinite(self._norm):
            return Reason.DIVERGED_FUNCTION_DOMAIN
        if self._norm < self._best_norm:
            self._best, self._best_norm, self._best_iteration = self._state, self._norm, iteration
        if self._norm < self._target:
            return Reason.CONVERGED_FNORM_ABS
        wandering = self._norm > self.wandering * self._smallest
        if iteration >= 2:
            self._smallest = min(self._norm, self._smallest)
        idle = self.problem.awake and iteration - self._best_iteration > MOST_IDLE
        if wandering or idle or self._norm > DIVERGED_RESIDUAL:
            return Reason.DIVERGED_DTOL
        if iteration >= self.max_iterations:
            return Reason.DIVERGED_MAX_IT
        return Reason.ITERATING


def _reason_name(reason: int) -> str:
    """Return PETSc's name of a converged reason."""
    for name, value in vars(Reason).items():
        if value == reason and not name.startswith("_"):
            return name
    return str(reason)
