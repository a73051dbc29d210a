r"""Equilibrium of a meridian as equations F(x, t_n) = 0 for ``equilibrium.continuation``.

x holds positions, vertex angles, curvature and multiplier; one Newton step for all of them is
condensed cell by cell (``shell.condensation``) and solved densely.  The derivative in t_n, which
growth laws need not supply, is a central difference of the stresses at fixed strains.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.equilibrium.continuation import Direction, Inadmissible, solve_bordered
from opticcup_fem.errors import UnbalancedLayer
from opticcup_fem.meridian.pressure import PressureWork
from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.meridian.transport import settle
from opticcup_fem.shell import condensation
from opticcup_fem.shell.condensation import CondensedCells
from opticcup_fem.shell.fibres import LostFibre

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

TIME_STEP = 1e-5
"""Step of the central difference in t_n: its error is about 1e-10, far below that of a path."""


class MeridianProblem:
    """The equations of an axisymmetric shell whose axial translation is held.

    Attributes:
        shell: The shell.
        free: Numbers of the free unknowns among (positions, angles).
        n_u: Number of positions and angles.
    """

    def __init__(self, shell: MeridianShell) -> None:
        """Number the unknowns; r and the angle are held at the poles, z at the last node."""
        self.shell = shell
        mesh = shell.mesh
        self._split = 2 * mesh.n_nodes
        self.n_u = self._split + mesh.n_cells + 1
        self._shapes = [
            (mesh.n_nodes, 2),
            (mesh.n_cells + 1,),
            (mesh.n_cells, mesh.degree + 1),
            (mesh.n_cells, mesh.degree + 1),
        ]
        held = np.zeros(self.n_u, dtype=bool)
        poles = np.flatnonzero(mesh.is_pole)
        held[2 * mesh.degree * poles] = True
        held[self._split + poles] = True
        held[self._split - 1] = True
        self.free: Indices = np.flatnonzero(~held)
        self.cell_unknowns: Indices = cell_unknowns(mesh.cells, 2, mesh.n_nodes)
        lumps = (
            mesh.tabulate(shell.forms.quadrature_points, 0)[0]
            * (shell.forms.quadrature_weights * mesh.sizes[:, None])[..., None]
        )
        lengths = np.zeros(mesh.n_nodes)
        np.add.at(lengths, mesh.cells, lumps.sum(axis=1))
        self._weights: Array = np.zeros(self.n_u)
        self._weights[: self._split] = np.repeat(lengths / lengths.sum(), 2)

    def pack(self, state: MeridianState) -> Array:
        """Return the unknowns of a state as one vector."""
        return np.concatenate(
            [part.reshape(-1) for part in (state.r, state.angle, state.kappa, state.sigma)]
        )

    def unpack(self, x: Array) -> MeridianState:
        """Return the state of a vector of unknowns."""
        ends = np.cumsum([int(np.prod(shape)) for shape in self._shapes])
        parts = np.split(x, ends[:-1])
        return MeridianState(
            *(p.reshape(shape) for p, shape in zip(parts, self._shapes, strict=True))
        )

    def inner(self, first: Array, second: Array) -> float:
        """Return the mean over the meridian of the product of two moves."""
        n = self.n_u
        return float(np.dot(self._weights * first[:n], second[:n]))

    def weighted(self, row: Array) -> Array:
        """Return the row of the inner product with ``row`` over the free unknowns."""
        weighted: Array = (self._weights * row[: self.n_u])[self.free]
        return weighted

    def linearise(self, x: Array, t: float) -> MeridianLinearised:
        """Return the equations and their derivatives.

        Raises:
            Inadmissible: A layer has no admissible state; the cause is the ``LostFibre``.
        """
        shell, state = self.shell, self.unpack(x)
        forms = shell.forms_at_points(state)
        try:
            result = shell.resultants_of(forms, t)
        except (LostFibre, UnbalancedLayer) as lost:
            raise Inadmissible("a layer has no admissible state") from lost
        data = shell.kinematic_data(state) | shell.material_data(result)
        cells = condensation.condense(
            shell.kernels,
            data,
            shell.mesh.sizes,
            state.kappa,
            shell.has_energy,
            PressureWork.of(shell, t),
        )
        return MeridianLinearised(self, state, forms, t, cells)

    def settle(self, x: Array, t: float) -> bool:
        """Solve mass balances in a state; return whether that has changed the equations.

        Raises:
            Inadmissible: There is no solution, or a layer has no admissible state.
        """
        try:
            return settle(self.shell, self.unpack(x), t)
        except (LostFibre, UnbalancedLayer) as lost:
            raise Inadmissible("a mass balance has no solution") from lost

    def assemble_vector(self, cells: Array) -> Array:
        """Add up cell vectors and return the free unknowns' rows."""
        whole: Array = np.zeros(self.n_u)
        np.add.at(whole, self.cell_unknowns, cells)
        return whole[self.free]

    def assemble_matrix(self, cells: Array) -> Array:
        """Add up cell matrices and return the free unknowns' rows and columns."""
        return assemble_dense(self.cell_unknowns, cells, self.n_u)[np.ix_(self.free, self.free)]


class MeridianLinearised:
    """The condensed Newton system at one (x, t_n); see ``continuation.Linearised``."""

    def __init__(
        self,
        problem: MeridianProblem,
        state: MeridianState,
        forms: Array,
        t_n: float,
        cells: CondensedCells,
    ) -> None:
        """Keep the condensed cells."""
        self.problem, self.state, self.forms, self.t_n, self.cells = (
            problem,
            state,
            forms,
            t_n,
            cells,
        )

    @cached_property
    def gradient(self) -> Array:
        """Condensed residual of the free unknowns."""
        return self.problem.assemble_vector(self.cells.gradient)

    @cached_property
    def hessian(self) -> Array:
        """Condensed tangent of the free unknowns."""
        return self.problem.assemble_matrix(self.cells.hessian)

    @property
    def residual(self) -> float:
        """Norm of all equations."""
        local = self.cells.local_residual(self.state.sigma)
        parts = (self.gradient, *local)
        return float(np.sqrt(sum(np.sum(part**2) for part in parts)))

    @cached_property
    def load(self) -> tuple[Array, Array]:
        """Derivatives in t_n of the cells' residuals: condensed (n_cells, n_u), bending."""
        shell, h = self.problem.shell, TIME_STEP
        try:
            after = shell.resultants_of(self.forms, self.t_n + h, tangent=False).stress
            before = shell.resultants_of(self.forms, self.t_n - h, tangent=False).stress
        except (LostFibre, UnbalancedLayer) as lost:
            raise Inadmissible("a layer has no admissible state nearby") from lost
        rate = (after - before) / (2 * h) * shell.circumference[..., None]
        data = {**self.cells.data, shell.forms.stress: rate}
        bending = shell.kernels["Fk"](data)
        condensed = np.einsum("cku,ck->cu", self.cells.slope, bending)
        force = shell.kernels["Fr"](data)
        condensed[:, : force.shape[1]] += force
        if shell.pressure is not None:
            slope = (shell.pressure(self.t_n + h) - shell.pressure(self.t_n - h)) / (2 * h)
            condensed -= PressureWork(shell.kernels, slope).gradient(self.cells.data)
        return condensed, bending

    def bordered(self, row: Array, entry: float, value: float) -> tuple[Direction, Direction]:
        """See ``continuation.Linearised``."""
        problem = self.problem
        step, tangent = solve_bordered(
            self.hessian,
            problem.assemble_vector(self.load[0]),
            problem.weighted(row),
            entry,
            -self.gradient,
            value,
        )
        return self._expanded(step, 1.0), self._expanded(tangent, 0.0)

    def _expanded(self, direction: Direction, fraction: float) -> Direction:
        """Add curvature and multiplier to a change of the free unknowns.

        Args:
            direction: Solution of the condensed system.
            fraction: 1 for the Newton step, 0 for a tangent, which leaves the residuals alone.
        """
        du = np.zeros(self.problem.n_u)
        du[self.problem.free] = direction.x
        in_cells = du[self.problem.cell_unknowns]
        dkappa, dsigma = self.cells.local_update(in_cells, self.state.sigma, fraction)
        dsigma = dsigma + direction.t * self.load[1] / self.cells.det_j[:, None]
        return Direction(np.concatenate([du, dkappa.ravel(), dsigma.ravel()]), direction.t)


def cell_unknowns(cells: Indices, components: int, n_nodes: int) -> Indices:
    """Return the numbers of the cells' unknowns (positions, angles at the ends).

    Args:
        cells: Nodes of the cells, shape (n_cells, degree + 1).
        components: Components of the position.
        n_nodes: Number of nodes.

    Returns:
        Shape (n_cells, components (degree + 1) + 2).
    """
    n = len(cells)
    positions = components * cells[:, :, None] + np.arange(components)
    angles = components * n_nodes + np.arange(n)[:, None] + np.arange(2)
    return np.concatenate([positions.reshape(n, -1), angles], axis=1)


def assemble_dense(unknowns: Indices, cells: Array, size: int) -> Array:
    """Return the sum of cell matrices (n_cells, n_u, n_u) as a dense matrix."""
    places = unknowns[:, :, None] * size + unknowns[:, None, :]
    sums = np.bincount(places.ravel(), cells.ravel(), size * size)
    return np.asarray(sums, dtype=np.float64).reshape(size, size)
