"""The shell's equilibrium as equations F(x, t_n) = 0 for ``continuation``.

The unknowns are a rank's own (r, alpha) and the curvature and multiplier of its cells, so that
iterates are those of the mixed Newton method.  Director angles refer to the directors of one
state, the chart.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.equilibrium.continuation import Direction, Inadmissible
from opticcup_fem.equilibrium.mass import lumped_mass
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.spectrum import Mode
from opticcup_fem.shell.condensation import CondensedCells
from opticcup_fem.shell.model import LostPlace, ShellState

Array = NDArray[np.float64]

TIME_STEP = 1e-5
"""Difference in t_n that gives the derivative of the residual."""


class LostPlaceError(ArithmeticError):
    """A layer has no admissible state.

    Attributes:
        place: The fibre and its place.
    """

    def __init__(self, place: LostPlace) -> None:
        """Keep the place."""
        super().__init__(str(place[0]))
        self.place = place


class ShellEquations:
    """Equilibrium of a shell as equations F(x, t_n) = 0 in one chart."""

    def __init__(self, problem: Problem, chart: ShellState) -> None:
        """Keep the parts.

        Args:
            problem: The shell's global problem.
            chart: State to whose directors the angles refer.
        """
        self.problem, self.chart = problem, chart
        self.n_u = problem.unknowns.owned
        mass = lumped_mass(problem).array_r.copy()
        positions = problem.unknowns.owned_values(np.ones_like(chart.r), np.zeros_like(chart.alpha))
        total = problem.comm.allreduce(float(np.sum(mass * positions)))
        self.weights = 3 * mass * positions / total

    def pack(self, state: ShellState) -> Array:
        """Return the unknowns of a state of this chart as one vector."""
        u = self.problem.unknowns.owned_values(state.r, state.alpha)
        return np.concatenate([u, state.kappa.ravel(), state.sigma.ravel()])

    def pack_motion(self, mode: Mode) -> Array:
        """Return a motion of positions and directors as a change of the unknowns."""
        cells = 2 * self.chart.kappa.size
        return np.concatenate(
            [self.problem.unknowns.owned_values(mode.r, mode.alpha), np.zeros(cells)]
        )

    def unpack(self, x: Array) -> ShellState:
        """Return the state of a vector of unknowns (collective)."""
        unknowns = self.problem.unknowns
        r, alpha = unknowns.split(unknowns.to_local(x[: self.n_u]))
        kappa, sigma = np.split(x[self.n_u :], 2)
        shape = self.chart.kappa.shape
        return replace(
            self.chart, r=r, alpha=alpha, kappa=kappa.reshape(shape), sigma=sigma.reshape(shape)
        )

    def inner(self, first: Array, second: Array) -> float:
        """Return the mean over the surface of the product of two moves (collective)."""
        n = self.n_u
        mine = float(np.sum(self.weights * first[:n] * second[:n]))
        return float(self.problem.comm.allreduce(mine))

    def linearise(self, x: Array, t: float) -> ShellLinearised:
        """Return the equations and their derivatives (collective).

        Raises:
            Inadmissible: A layer has no admissible state; the cause is a ``LostPlaceError``.
        """
        shell = self.problem.shell
        shell.set_time(t)
        state = self.unpack(x)
        resultants, lost = shell.evaluate(state)
        if resultants is None:
            assert lost is not None
            raise Inadmissible("a layer has no admissible state") from LostPlaceError(lost)
        return ShellLinearised(self, state, t, shell.condensed(state, resultants))


class ShellLinearised:
    """The condensed Newton system at one (x, t_n); see ``continuation.Linearised``."""

    def __init__(
        self, equations: ShellEquations, state: ShellState, t_n: float, cells: CondensedCells
    ) -> None:
        """Assemble the condensed residual (collective)."""
        self.equations, self.state, self.t_n, self.cells = equations, state, t_n, cells
        problem = equations.problem
        self.gradient = problem.vector.duplicate()
        problem.unknowns.add_cells(cells.gradient, self.gradient)

    @cached_property
    def residual(self) -> float:
        """Norm of all equations (collective)."""
        local = self.cells.local_residual(self.state.sigma)
        mine = sum(float(np.sum(part * part)) for part in (self.gradient.array_r, *local))
        return float(np.sqrt(self.equations.problem.comm.allreduce(mine)))

    @cached_property
    def load(self) -> tuple[PETSc.Vec, Array]:
        """Derivatives in t_n of the residuals: condensed, and bending of the cells (collective).

        Raises:
            Inadmissible: A layer has no admissible state nearby.
        """
        problem = self.equations.problem
        shell, stresses = problem.shell, []
        for t in (self.t_n + TIME_STEP, self.t_n - TIME_STEP):
            shell.set_time(t)
            resultants, lost = shell.evaluate(self.state, tangent=False)
            if resultants is None:
                assert lost is not None
                raise Inadmissible("no admissible state nearby") from LostPlaceError(lost)
            stresses.append(resultants.stress)
        shell.set_time(self.t_n)
        rate = (stresses[0] - stresses[1]) / (2 * TIME_STEP)
        data = {**self.cells.data, shell.forms.stress: rate * shell.area_ref[..., None]}
        bending = shell.kernels["Fk"](data)
        condensed = np.einsum("cku,ck->cu", self.cells.slope, bending)
        force = shell.kernels["Fr"](data)
        condensed[:, : force.shape[1]] += force
        vector = problem.vector.duplicate()
        problem.unknowns.add_cells(condensed, vector)
        return vector, bending

    def bordered(self, row: Array, entry: float, value: float) -> tuple[Direction, Direction]:
        """See ``continuation.Linearised``; by two solutions with one factorisation (collective)."""
        equations, problem = self.equations, self.equations.problem
        load = self.load[0]
        problem.assemble_tangent(self.cells)
        problem.factorise()
        step, slope = problem.vector.duplicate(), problem.vector.duplicate()
        problem.ksp.solve(-self.gradient, step)
        problem.ksp.solve(-load, slope)
        weighted = equations.weights * row[: equations.n_u]
        mine = np.array([np.sum(weighted * step.array_r), np.sum(weighted * slope.array_r)])
        of_step, of_slope = problem.comm.allreduce(mine)
        pivot = of_slope + entry
        if pivot == 0:
            raise np.linalg.LinAlgError("the row is orthogonal to the path")
        dt, unit = (value - of_step) / pivot, 1 / pivot
        return (
            self._expanded(step.array_r + dt * slope.array_r, dt, 1.0),
            self._expanded(unit * slope.array_r, unit, 0.0),
        )

    def _expanded(self, owned: Array, dt: float, fraction: float) -> Direction:
        """Add curvature and multiplier to a change of (r, alpha).

        Args:
            owned: The change of the owned unknowns.
            dt: The change of t_n.
            fraction: 1 for the Newton step, 0 for a tangent, which leaves the residuals alone.
        """
        unknowns = self.equations.problem.unknowns
        in_cells = unknowns.to_local(owned)[unknowns.in_cells]
        dkappa, dsigma = self.cells.local_update(in_cells, self.state.sigma, fraction)
        dsigma = dsigma + dt * self.load[1] / self.cells.det_j[:, None]
        return Direction(np.concatenate([owned, dkappa.ravel(), dsigma.ravel()]), dt)
