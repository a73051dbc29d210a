r"""Jumps of closures without an energy: implicit viscous flow M du/dtau + F(u) = 0.

Backward Euler in the fictitious time tau.  The flow leaves a state that has lost its stability
and comes to rest in a stable one; near rest, Newton's method with the true tangent finishes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from opticcup_fem.equilibrium.mass import lumped_mass
from opticcup_fem.equilibrium.newton import Drag, MixedNewton
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.relaxation import TOO_FAR, Relaxed, Stays, starting_state
from opticcup_fem.shell.model import LostPlace, ShellState


class ViscousRelaxation:
    """Follows the viscous flow to rest."""

    def __init__(
        self,
        problem: Problem,
        newton: MixedNewton,
        max_steps: int = 200,
        max_move: float = 0.12,
        rest: float = 1e-3,
    ) -> None:
        """Set the flow up.

        Args:
            problem: Assembly and factorisation.
            newton: Solver of the implicit steps.
            max_steps: Steps after which it gives up.
            max_move: Largest move of a node in one step, unit of length of the mesh.
            rest: Speed |F| (unit mu_IOV R^2) below which Newton's method is tried.
        """
        self.problem, self.newton = problem, newton
        self.max_steps, self.max_move, self.rest = max_steps, max_move, rest
        self._mass = lumped_mass(problem)
        self.monitor: Callable[[int, float, float], None] | None = None

    def relax(self, state: ShellState, stays: Stays | None = None) -> Relaxed:
        """Flow from ``state`` at the shell's present growth (collective).

        Args:
            state: The start.
            stays: Tells of a state whether it is worth going on from there.
        """
        shell = self.problem.shell
        state, lost = starting_state(shell, state)
        if lost is not None:
            return Relaxed(state, False, 0, 0, np.nan, np.nan, "no admissible start", None, lost)
        step, spent, speed = 1e-2, 0, np.inf
        for count in range(self.max_steps):
            solution = self.newton.solve(state, Drag(self._mass, 1 / step))
            spent += solution.iterations
            lost = solution.lost
            moved = self.problem.largest(np.linalg.norm(solution.state.r - state.r, axis=1))
            if not solution.converged or moved > self.max_move:
                step *= 0.3
                if step < 1e-8:
                    return self._ended(state, False, count, spent, speed, "the flow stalled", lost)
                continue
            speed = self._speed(state, solution.state, step)
            state = shell.with_updated_directors(solution.state)
            if stays is not None and not stays(state):
                return self._ended(state, False, count, spent, speed, TOO_FAR, None)
            if speed < self.rest:
                final = self.newton.solve(state)
                spent += final.iterations
                if final.converged:
                    rested = shell.with_updated_directors(final.state)
                    return self._ended(
                        rested, True, count, spent, final.residual, "converged", None
                    )
            step *= 2.0
        reason = "the flow did not come to rest"
        return self._ended(state, False, self.max_steps, spent, speed, reason, lost)

    def _speed(self, before: ShellState, after: ShellState, step: float) -> float:
        """Return |F| of a backward Euler step, which is |M du|/dtau."""
        dr, dalpha = after.r - before.r, after.alpha - before.alpha
        move = self.problem.unknowns.owned_values(dr, dalpha)
        return self.problem.norm(self._mass.array_r * move) / step

    def _ended(
        self,
        state: ShellState,
        converged: bool,
        iterations: int,
        spent: int,
        residual: float,
        reason: str,
        lost: LostPlace | None,
    ) -> Relaxed:
        energy = self.problem.shell.energy(state)
        return Relaxed(state, converged, iterations, spent, energy, residual, reason, None, lost)
