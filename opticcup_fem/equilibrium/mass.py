"""The metric of motions: what a unit of position and of director angle weigh.

Positions carry the reference area around them; angles that of a strip along their edge times
h^2/12, a small rotary inertia, so that a shift or an eigenvalue means the same on every mesh.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.equilibrium.problem import Problem

Array = NDArray[np.float64]


def lumped_mass(problem: Problem) -> PETSc.Vec:
    """Return the diagonal metric M of shifts, larger than zero (collective)."""
    positions = np.repeat(np.abs(problem.shell.nodal_areas()), 3, axis=1)
    mass = problem.vector.duplicate()
    cells = np.concatenate([positions, _rotary_inertia(problem)], axis=1)
    problem.unknowns.add_cells(cells, mass, power=2)
    return mass


def consistent_mass(problem: Problem) -> PETSc.Mat:
    """Return the metric M of motions, int |dr|^2 dA_ref and rotary inertia (collective).

    Held unknowns have a zero row and column, which makes their eigenvalues infinite.
    """
    basis = _table(problem)
    scalar = np.einsum("cq,qi,qj->cij", problem.shell.weights, basis, basis)
    n, n_nodes = len(scalar), basis.shape[1]
    rotary = _rotary_inertia(problem)
    size = 3 * n_nodes + rotary.shape[1]
    cells = np.zeros((n, size, size))
    for i in range(3):
        cells[:, i : 3 * n_nodes : 3, i : 3 * n_nodes : 3] = scalar
    angles = np.arange(3 * n_nodes, size)
    cells[:, angles, angles] = rotary
    matrix = problem.matrix.duplicate(copy=False)
    problem.insert(matrix, cells)
    matrix.assemble()
    return matrix


def _table(problem: Problem) -> Array:
    shell = problem.shell
    return shell.spaces.position_table(shell.forms.quadrature_points)


def _rotary_inertia(problem: Problem) -> Array:
    """Return each cell's share of the inertia of its edges' angles, shape (n_cells, 3 k)."""
    shell, spaces = problem.shell, problem.shell.spaces
    corners = spaces.coordinates
    lengths = np.linalg.norm(corners[:, [2, 2, 1]] - corners[:, [1, 0, 0]], axis=2)
    gauss = np.polynomial.legendre.leggauss(spaces.degree)[1] / 2
    strip: Array = 0.5 * lengths[:, :, None] * gauss * shell.thickness**3 / 12
    return strip.reshape(spaces.n_cells, -1)
