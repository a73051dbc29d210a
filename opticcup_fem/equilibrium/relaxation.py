r"""Jumps: from a state that has lost its stability down to the next stable equilibrium.

For closures with an energy E(r, alpha) (kappa and sigma in local equilibrium): a Levenberg-
Marquardt descent.  Each step solves (H + s M) p = -g with the smallest tried shift s for which
L D L^T finds no negative pivot, is capped in length, and must lower the energy (Armijo).  It can
therefore only end in a state that is stable, axisymmetric or not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.equilibrium.mass import lumped_mass
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.shell.condensation import CondensedCells
from opticcup_fem.shell.model import LostPlace, Shell, ShellState

Array = NDArray[np.float64]

ARMIJO = 1e-4
"""Least decrease of the energy, as a fraction of what the slope promises."""

LAG = 0.25
"""Change of the faces' heights, over the barrier's distance, that a descent leaves until it has
come to rest: renewed, they change the energy that it lowers."""


FIRST_MOVES = (0.02, 0.005, 0.001)
"""Largest move of a node, in units of length of the mesh, with which a saddle is left."""

MOST_SOLVES = 60
"""Inverse iterations for the motion along which it is left."""


TOO_FAR = "it went too far"
"""Why a relaxation was given up whose state was not worth going on from."""

Stays = Callable[[ShellState], bool]


@dataclass(frozen=True)
class Relaxed:
    """Outcome of a relaxation.

    Attributes:
        state: Last state, in local equilibrium.
        converged: Whether it is a stable equilibrium.
        iterations: Accepted steps.
        factorisations: Factorisations spent.
        energy: Energy of ``state``.
        residual: Norm of the condensed residual.
        reason: What stopped it, in words.
        negative_eigenvalues: Of the tangent; None where the closure has no energy.
        lost: The fibre that stopped it, and its place, where that was the reason.
    """

    state: ShellState
    converged: bool
    iterations: int
    factorisations: int
    energy: float
    residual: float
    reason: str
    negative_eigenvalues: int | None = None
    lost: LostPlace | None = None


def starting_state(shell: Shell, state: ShellState) -> tuple[ShellState, LostPlace | None]:
    """Return ``state`` in local equilibrium, or with the fibre that has none (collective).

    The growth may have moved on since ``state`` was an equilibrium.
    """
    state = shell.with_updated_directors(state)
    state = replace(state, kappa=shell.curvature_of(state))
    _, lost = shell.evaluate(state, tangent=False)
    return (state, lost) if lost is not None else (shell.with_local_equilibrium(state), None)


class EnergyDescent:
    """Levenberg-Marquardt descent of the energy of a problem with a symmetric tangent."""

    def __init__(
        self,
        problem: Problem,
        tolerance: float = 1e-8,
        max_iterations: int = 400,
        max_move: float = 0.1,
    ) -> None:
        """Set the descent up.

        Args:
            problem: Assembly and factorisation; must be symmetric.
            tolerance: Norm of the gradient below which the state counts as an equilibrium.
            max_iterations: Accepted steps after which it gives up.
            max_move: Largest move of a node in one step, unit of length of the mesh.
        """
        assert problem.symmetric
        self.problem, self.tolerance = problem, tolerance
        self.max_iterations, self.max_move = max_iterations, max_move
        self._mass = lumped_mass(problem)
        self._gradient = problem.vector.duplicate()
        self._step = problem.vector.duplicate()
        self.monitor: Callable[[int, float, float], None] | None = None

    def relax(self, state: ShellState, stays: Stays | None = None) -> Relaxed:
        """Descend from ``state`` at the shell's present growth (collective).

        Contact is evaluated from the first step on which anything touches.

        Args:
            state: The start.
            stays: Tells of a state whether it is worth going on from there.
        """
        problem = self.problem
        state, lost = starting_state(problem.shell, state)
        if lost is not None:
            return Relaxed(state, False, 0, 0, np.nan, np.nan, "no admissible start", None, lost)
        state = problem.with_contact(state)
        problem.awake = state.contact is not None and state.contact.touches
        relaxed = self._descend(state, stays)
        problem.awake = problem.contact is not None
        return relaxed

    def _descend(self, state: ShellState, stays: Stays | None) -> Relaxed:
        shell, problem = self.problem.shell, self.problem
        energy = problem.energy(state)
        shift, factorisations = 0.0, 0
        for iteration in range(self.max_iterations + 1):
            cells = shell.condensed(state)
            problem.assemble_gradient(cells, state, self._gradient)
            norm = self._gradient.norm()
            if self.monitor is not None:
                self.monitor(iteration, norm, energy)
            shift, spent = self._factorise(cells, shift, state, norm < self.tolerance)
            factorisations += spent
            if norm < self.tolerance and shift == 0.0:
                state, done = self._renewed(state)
                if done:
                    energy, why = shell.energy(state), "converged"
                    return Relaxed(state, True, iteration, factorisations, energy, norm, why, 0)
                energy = problem.energy(state)
                continue
            accepted = None
            if norm < self.tolerance:  # unstable: no slope leads away
                accepted = self._along_softest(state, energy, shift)
            accepted = accepted or self._line_search(state, energy)
            if accepted is None:
                reason = "no step lowers the energy"
                return Relaxed(state, False, iteration, factorisations, energy, norm, reason)
            after, energy, fraction = accepted
            state, energy = self._moved(state, after, energy)
            if stays is not None and not stays(state):
                return Relaxed(state, False, iteration, factorisations, energy, norm, TOO_FAR)
            shift = shift / 8 if fraction > 0.5 else shift
            if shift < 1e-6:
                shift = 0.0
        reason = f"{self.max_iterations} steps were not enough"
        return Relaxed(state, False, self.max_iterations, factorisations, energy, norm, reason)

    def _renewed(self, state: ShellState) -> tuple[ShellState, bool]:
        """Return a state with up-to-date faces, and whether it needs no further step."""
        contact = self.problem.contact
        return (
            (state, True) if contact is None or not self.problem.awake else contact.renewed(state)
        )

    def _moved(
        self, before: ShellState, after: ShellState, energy: float
    ) -> tuple[ShellState, float]:
        """Return the state after a step with up-to-date faces, and its energy.

        A step on which something would touch unseen is not taken: contact wakes instead.
        """
        problem, contact = self.problem, self.problem.contact
        if contact is None:
            return after, energy
        if problem.awake:
            state, same = contact.renewed(after, LAG)
            return state, energy if same else problem.energy(state)
        passed = contact.passes(before, after)
        if passed is not None:
            return passed, energy
        problem.awake = True
        return before, problem.energy(before)

    def _factorise(
        self, cells: CondensedCells, shift: float, state: ShellState, at_rest: bool
    ) -> tuple[float, int]:
        """Factorise H + s M with s >= ``shift`` raised until no pivot is negative.

        Where H has negative pivots, the convex part of contact's stiffness is tried before a shift,
        which would slow down all motion; at rest only H itself tells whether a state is stable.

        Returns:
            The shift and the number of factorisations.
        """
        problem = self.problem
        far = problem.contact_stiffness(state)
        problem.assemble_tangent(cells, far)
        applied, spent, convex = 0.0, 0, at_rest or far is None
        while True:
            if shift > applied:
                problem.add_diagonal(self._mass, shift - applied)
                applied = shift
            problem.factorise()
            spent += 1
            inertia = problem.inertia()
            assert inertia is not None
            if inertia.negative == 0 and inertia.zero == 0:
                return shift, spent
            if convex:
                shift = max(4 * shift, 1e-3)
                continue
            problem.assemble_tangent(cells, problem.contact_stiffness(state, convex=True))
            applied, convex = 0.0, True

    def _along_softest(
        self, state: ShellState, energy: float, shift: float
    ) -> tuple[ShellState, float, float] | None:
        """Return (state, energy, fraction) after a step along the softest motion, or None.

        From a saddle at which the slope vanishes, as it does by symmetry in every motion that
        breaks it.  The motion is found by inverse iteration with H + s M, which is factorised.
        """
        problem, motion = self.problem, self._step
        still = np.zeros_like(state.alpha)
        motion.array[:] = problem.unknowns.symmetric_part(
            _without_symmetry(problem.shell.reference), still
        )
        weighed, curvature = motion.duplicate(), np.inf
        for _ in range(MOST_SOLVES):
            motion.scale(1 / np.sqrt(self._square(motion)))
            weighed.pointwiseMult(self._mass, motion)
            problem.ksp.solve(weighed, motion)
            last, curvature = curvature, weighed.dot(motion) / self._square(motion) - shift
            if curvature < 0 and abs(curvature - last) < 0.1 * abs(curvature):
                break
        if curvature >= 0:
            return None
        dr, dalpha = problem.unknowns.split(problem.unknowns.to_local(motion.array_r))
        longest = problem.largest(np.linalg.norm(dr, axis=1))
        for amount in FIRST_MOVES:
            for sign in (1, -1):
                share = sign * amount / longest
                share *= problem.free_fraction(state, share * dr)
                trial = replace(state, r=state.r + share * dr, alpha=state.alpha + share * dalpha)
                reached = self._energy_of(trial) if problem.is_free(state, trial) else None
                if reached is not None and reached[1] < energy:
                    return problem.shell.with_updated_directors(reached[0]), reached[1], 1.0
        return None

    def _square(self, motion: PETSc.Vec) -> float:
        """Return x . M x of a motion x (collective)."""
        weighed = motion.duplicate()
        weighed.pointwiseMult(self._mass, motion)
        return float(weighed.dot(motion))

    def _line_search(
        self, state: ShellState, energy: float
    ) -> tuple[ShellState, float, float] | None:
        """Return (state, energy, fraction) after a step that lowers the energy, or None."""
        problem, shell = self.problem, self.problem.shell
        problem.ksp.solve(self._gradient, self._step)
        slope = -self._gradient.dot(self._step)
        local = problem.unknowns.to_local(-self._step.array_r)
        dr, dalpha = problem.unknowns.split(local)
        longest = problem.largest(np.linalg.norm(dr, axis=1))
        fraction = min(1.0, self.max_move / longest) if longest > 0 else 1.0
        fraction *= problem.free_fraction(state, fraction * dr)
        free, smallest_change = fraction, 1e-13 * max(abs(energy), 1e-3)
        while fraction > 1e-6:
            trial = replace(state, r=state.r + fraction * dr, alpha=state.alpha + fraction * dalpha)
            reached = None
            if fraction == free or problem.is_free(state, trial):
                reached = self._energy_of(trial)
            if reached is not None:
                trial, value = reached
                if value <= energy + ARMIJO * fraction * slope + smallest_change:
                    return shell.with_updated_directors(trial), value, fraction
            fraction /= 2
        return None

    def _energy_of(self, trial: ShellState) -> tuple[ShellState, float] | None:
        """Return the trial in local equilibrium with its energy, None if it is inadmissible."""
        shell = self.problem.shell
        trial = replace(trial, kappa=shell.curvature_of(trial))
        if shell.evaluate(trial, tangent=False)[1] is not None:
            return None
        trial = shell.with_local_equilibrium(trial)
        return trial, self.problem.energy(trial)


def _without_symmetry(x: Array) -> Array:
    """Return a smooth vector field that no mirror or turn leaves as it is, shape (n, 3).

    Args:
        x: Reference positions, shape (n, 3): it is the same however they are distributed.
    """
    waves = np.array([[3.0, 5.0, 7.0], [6.0, 4.0, -5.0], [-4.0, 7.0, 3.0]])
    field: Array = np.sin(x @ waves.T + np.array([1.0, 2.0, 3.0]))
    return field
