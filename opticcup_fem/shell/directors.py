r"""Directors of the edges: d_0 is the mean of the two cell normals, lagged between load steps.

The director of an edge is d = cos(alpha) d_0 + sin(alpha) t x d_0, with t the current edge tangent
from the low to the high global vertex and d_0 made normal to t.
"""

from __future__ import annotations

import numpy as np
from dolfinx import la
from numpy.typing import NDArray

from opticcup_fem.shell.spaces import EDGE_VERTICES, ShellSpaces

Array = NDArray[np.float64]


def _unit(vectors: Array) -> Array:
    lengths: Array = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths > 0, lengths, 1.0)


def _normal_to(vectors: Array, tangents: Array) -> Array:
    """Return the unit vectors along the parts of ``vectors`` normal to unit ``tangents``."""
    along = np.sum(vectors * tangents, axis=-1, keepdims=True)
    return _unit(vectors - along * tangents)


class EdgeDirectors:
    """Fields at the Gauss points of the edges of a mesh."""

    def __init__(self, spaces: ShellSpaces) -> None:
        """Tabulate the base vectors at the edges' Gauss points."""
        self._spaces = spaces
        k = spaces.degree
        points = spaces.edge_reference_points().reshape(-1, 2)
        self._gradient = spaces.gradient_operator(points)
        self._values = spaces.position_table(points)
        corners = spaces.coordinates
        run = corners[:, EDGE_VERTICES[:, 1]] - corners[:, EDGE_VERTICES[:, 0]]
        ccw = np.array([1.0, -1.0, 1.0]) * spaces.orientation[:, None]
        low_to_high = run * (ccw * spaces.edge_sign)[:, :, None]
        self._direction = np.einsum("cei,cai->cea", _unit(low_to_high), spaces.frame[:, :2])
        self._slots = spaces.edges[:, :, None] * k + spaces.edge_points
        index_map = spaces.mesh.topology.index_map(1)
        self._exchange = la.vector(index_map, bs=3 * k)

    def per_cell(self, field: Array) -> Array:
        """Return an edge field in the cells' own order.

        Args:
            field: Shape (n_edges, k, ...).

        Returns:
            Shape (n_cells, 3, k, ...).
        """
        flat = field.reshape(-1, *field.shape[2:])
        return flat[self._slots]

    def from_cells(self, values: Array) -> Array:
        """Return the edge field that the cells see as ``values``, the inverse of ``per_cell``.

        Args:
            values: Shape (n_cells, 3, k, ...), equal on both sides of an edge.

        Returns:
            Shape (n_edges, k, ...).
        """
        shape = values.shape[3:]
        flat = np.zeros((self._spaces.n_edges * self._spaces.degree, *shape))
        flat[self._slots] = values
        return flat.reshape(-1, self._spaces.degree, *shape)

    def _base_vectors(self, r: Array) -> Array:
        """Return r_,a at the edges' Gauss points as the cells see them, (cells, 3, k, 2, 3)."""
        spaces = self._spaces
        base = np.einsum("cqna,cni->cqai", self._gradient, r[spaces.nodes])
        return base.reshape(spaces.n_cells, 3, spaces.degree, 2, 3)

    def places(self, r: Array) -> Array:
        """Return the positions of the edges' Gauss points, shape (n_edges, k, 3) (collective)."""
        spaces = self._spaces
        values = np.einsum("qn,cni->cqi", self._values, r[spaces.nodes])
        return self._shared(self.from_cells(values.reshape(spaces.n_cells, 3, -1, 3)))

    def tangents(self, r: Array) -> Array:
        """Return the current unit edge tangents, low to high vertex, shape (n_edges, k, 3)."""
        tangent: Array = np.einsum("ceqai,cea->ceqi", self._base_vectors(r), self._direction)
        out = np.zeros((self._spaces.n_edges * self._spaces.degree, 3))
        out[self._slots] = _unit(tangent)
        return self._shared(out)

    def mean_normals(self, r: Array) -> Array:
        """Return the unit mean normals, normal to the edges, shape (n_edges, k, 3) (collective)."""
        base = self._base_vectors(r)
        normal: Array = np.cross(base[..., 0, :], base[..., 1, :]).astype(np.float64)
        normals = _unit(normal)
        total = np.zeros((self._spaces.n_edges * self._spaces.degree, 3))
        np.add.at(total, self._slots.ravel(), normals.reshape(-1, 3))
        self._exchange.array[:] = total.ravel()
        self._exchange.scatter_reverse(la.InsertMode.add)
        self._exchange.scatter_forward()
        mean = self._exchange.array.reshape(-1, self._spaces.degree, 3).copy()
        return _normal_to(mean, self.tangents(r))

    def _shared(self, values: Array) -> Array:
        """Return the owner's values of an edge vector field on all ranks."""
        self._exchange.array[:] = values.ravel()
        self._exchange.scatter_forward()
        shared: Array = self._exchange.array.reshape(-1, self._spaces.degree, 3).copy()
        return shared

    def re_expressed(self, r: Array, alpha: Array, old: Array, new: Array) -> Array:
        """Return the angles, from the frames of ``new``, of the directors that ``alpha`` gave.

        Args:
            r: Current positions, shape (n_nodes, 3).
            alpha: Angles from ``old``, shape (n_edges, k).
            old: Directors d_0 that ``alpha`` refers to, shape (n_edges, k, 3).
            new: Directors that the result refers to.
        """
        t = self.tangents(r)
        from_old, from_new = _normal_to(old, t), _normal_to(new, t)
        turn = np.arctan2(
            np.sum(from_old * np.cross(t, from_new), axis=-1), np.sum(from_old * from_new, axis=-1)
        )
        angle = alpha + turn
        return (angle + np.pi) % (2 * np.pi) - np.pi
