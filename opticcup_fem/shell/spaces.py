"""Finite-element spaces of the hybridised Hellan-Herrmann-Johnson shell, with their numbering.

Unknowns: the position r, continuous P_k on the flat triangles (equispaced nodes, so that the nodes
are those of a VTK Lagrange triangle), and one director angle alpha at each of the k Gauss points of
every edge.  The curvature kappa and its multiplier sigma are P_{k-1} on each cell, in a basis that
is orthonormal on the reference cell, so that their mass matrix is |det J| times the identity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from numpy.typing import NDArray

from opticcup_fem.compat import cell_corners

Array = NDArray[np.float64]
Index = NDArray[np.int32]

EDGE_VERTICES = np.array([[1, 2], [0, 2], [0, 1]])
"""Local vertices of the three edges of the reference triangle."""


class ShellSpaces:
    """Function spaces on one mesh, the numbering of edges, and reference-cell tables.

    Attributes:
        mesh: Mesh of flat triangles in space.
        degree: Polynomial degree k of the position.
        n_cells: Cells owned by this rank.
        position: Vector Lagrange space of r.
        nodes: Nodes of each owned cell, shape (n_cells, n_cell_nodes), local numbers.
        edges: Edges of each owned cell, shape (n_cells, 3), local numbers.
        edge_sign: +1 where the edge, seen counter-clockwise about the outward normal, runs from
            its low to its high global vertex, else -1; shape (n_cells, 3).
        edge_points: For each cell edge the number (0..k-1) along the global edge of its Gauss
            points in the cell's own order, shape (n_cells, 3, k).
        det_j: |det J| of each owned cell, shape (n_cells,): twice its flat area.
    """

    def __init__(self, mesh: dmesh.Mesh, orientation: Array, degree: int = 3) -> None:
        """Number nodes and edges.

        Args:
            mesh: Affine triangles in three-dimensional space.
            orientation: +1 or -1 for each cell (owned and ghost), see ``SurfaceMesh``.
            degree: Polynomial degree of the position, 2 or more.
        """
        self.mesh, self.degree = mesh, degree
        topology = mesh.topology
        topology.create_entities(1)
        topology.create_connectivity(2, 1)
        topology.create_connectivity(1, 0)
        self.n_cells = topology.index_map(2).size_local
        self.orientation = np.asarray(orientation, dtype=np.float64)[: self.n_cells]
        self.element = basix.ufl.element(
            "Lagrange",
            "triangle",
            degree,
            lagrange_variant=basix.LagrangeVariant.equispaced,
            shape=(3,),
        )
        self.position = fem.functionspace(mesh, self.element)
        self.nodes: Index = self.position.dofmap.list[: self.n_cells]
        self.edges: Index = topology.connectivity(2, 1).array.reshape(-1, 3)[: self.n_cells]
        self._number_edges()
        self._cell_geometry()

    def _number_edges(self) -> None:
        """Find, for every cell edge, its direction and the order of its Gauss points."""
        topology = self.mesh.topology
        cells = topology.connectivity(2, 0).array.reshape(-1, 3)[: self.n_cells]
        vertices = topology.index_map(0).local_to_global(np.ascontiguousarray(cells.ravel()))
        ends = vertices.reshape(-1, 3)[:, EDGE_VERTICES]
        rising = ends[:, :, 0] < ends[:, :, 1]
        k = self.degree
        forward = np.arange(k)
        self.edge_points = np.where(rising[:, :, None], forward, forward[::-1])
        # in the reference cell, edges 0 and 2 run counter-clockwise from first to second vertex
        counter_clockwise = np.array([1.0, -1.0, 1.0]) * self.orientation[:, None]
        self.edge_sign = np.where(rising, counter_clockwise, -counter_clockwise)

    def _cell_geometry(self) -> None:
        """Tabulate frames and gradients of the flat cells."""
        x = self.mesh.geometry.x
        self.coordinates = np.ascontiguousarray(
            x[cell_corners(self.mesh)[: self.n_cells]], dtype=np.float64
        )
        corners = self.coordinates
        jacobian = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=-1)
        normal = np.cross(jacobian[:, :, 0], jacobian[:, :, 1])
        self.det_j = np.linalg.norm(normal, axis=1)
        n_0 = normal * (self.orientation / self.det_j)[:, None]
        t_1 = jacobian[:, :, 0] / np.linalg.norm(jacobian[:, :, 0], axis=1, keepdims=True)
        self.frame = np.stack([t_1, np.cross(n_0, t_1), n_0], axis=1)
        self._inverse = np.linalg.inv(self.frame[:, :2] @ jacobian)

    @cached_property
    def n_edges(self) -> int:
        """Edges known to this rank, owned and ghost."""
        index_map = self.mesh.topology.index_map(1)
        return int(index_map.size_local + index_map.num_ghosts)

    @cached_property
    def n_nodes(self) -> int:
        """Nodes of the position known to this rank, owned and ghost."""
        index_map = self.position.dofmap.index_map
        return int(index_map.size_local + index_map.num_ghosts)

    @cached_property
    def curvature_element(self) -> basix.ufl._ElementBase:
        """Discontinuous P_{k-1} with three components in an orthonormal (Legendre) basis."""
        return basix.ufl.element(
            "Lagrange",
            "triangle",
            self.degree - 1,
            lagrange_variant=basix.LagrangeVariant.legendre,
            discontinuous=True,
            shape=(3,),
        )

    @cached_property
    def n_curvature(self) -> int:
        """Coefficients of kappa on a cell."""
        k = self.degree
        return 3 * k * (k + 1) // 2

    def edge_element(self, shape: tuple[int, ...] = ()) -> basix.ufl._ElementBase:
        """Return the discontinuous element of an edge whose nodes are its k Gauss points."""
        variant = basix.LagrangeVariant.gl_isaac
        kwargs = {"shape": shape} if shape else {}
        return basix.ufl.element(
            "Lagrange",
            "interval",
            self.degree - 1,
            lagrange_variant=variant,
            discontinuous=True,
            **kwargs,
        )

    @cached_property
    def edge_domain(self) -> ufl.Mesh:
        """UFL domain of the edges: straight segments in space."""
        return ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(3,)))

    def _gradient_table(self, points: Array) -> Array:
        """Gradients of the nodal basis in the cell frames, shape (cells, points, nodes, 2)."""
        table = self.position.element.basix_element.tabulate(1, points)[1:, :, :, 0]
        return np.einsum("dqn,cde->cqne", table, self._inverse)

    def gradient_operator(self, points: Array) -> Array:
        """Return the operator from cell nodes to frame gradients.

        Args:
            points: Reference points, shape (n_points, 2).

        Returns:
            Array of shape (n_cells, n_points, n_cell_nodes, 2): r_,a = sum_n op[..., n, a] r_n.
        """
        return self._gradient_table(points)

    def metric(self, cell_positions: Array, gradient: Array) -> Array:
        """Return (a_11, a_22, a_12) of a position field.

        Args:
            cell_positions: Nodal positions, shape (n_cells, n_cell_nodes, 3).
            gradient: Result of ``gradient_operator``.

        Returns:
            Shape (n_cells, n_points, 3).
        """
        base = np.einsum("cqna,cni->cqai", gradient, cell_positions)
        return metric_of(base)

    def position_table(self, points: Array) -> Array:
        """Return the nodal basis at reference points, shape (n_points, n_cell_nodes)."""
        table: Array = self.position.element.basix_element.tabulate(0, points)[0, :, :, 0]
        return table

    def curvature_table(self, points: Array) -> Array:
        """Return the orthonormal basis of kappa's components, shape (n_points, n_k / 3)."""
        scalar = self.curvature_element.basix_element
        table: Array = scalar.tabulate(0, points)[0, :, :, 0]
        return table

    def edge_reference_points(self) -> Array:
        """Return reference-cell coordinates of the Gauss points of the three edges, (3, k, 2)."""
        gauss = (1 + np.polynomial.legendre.leggauss(self.degree)[0]) / 2
        corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        start, end = corners[EDGE_VERTICES[:, 0]], corners[EDGE_VERTICES[:, 1]]
        return start[:, None] + gauss[None, :, None] * (end - start)[:, None]


def metric_of(base: Array) -> Array:
    """Return (a_11, a_22, a_12) of base vectors of shape (..., 2, 3)."""
    first, second = base[..., 0, :], base[..., 1, :]
    return np.stack(
        [(first * first).sum(-1), (second * second).sum(-1), (first * second).sum(-1)], axis=-1
    )


@dataclass(frozen=True)
class GlobalNumbering:
    """Numbers of all unknowns of a rank in the global vector: positions, then edge angles.

    Attributes:
        local_to_global: Global number of every local unknown, shape (n_local,).
        owned: Number of owned unknowns.
        owned_local: Local numbers of the owned unknowns in global order, shape (owned,).
        sign: Factor of every local unknown on the global one, where these are images of each
            other (``shell.mirrors``), shape (n_local,); else None.
    """

    local_to_global: Index
    owned: int
    owned_local: Index
    sign: NDArray[np.float64] | None = None


def number_unknowns(spaces: ShellSpaces) -> GlobalNumbering:
    """Number r (3 per node) and alpha (k per edge) rank by rank, positions first."""
    comm = spaces.mesh.comm
    parts = (
        (spaces.position.dofmap.index_map, 3),
        (spaces.mesh.topology.index_map(1), spaces.degree),
    )
    owned = [imap.size_local * block for imap, block in parts]
    starts = np.array(comm.allgather([*owned, *(imap.local_range[0] for imap, _ in parts)]))
    rank_offset = np.concatenate([[0], np.cumsum(starts[:, :2].sum(axis=1))])
    numbers = []
    for which, (imap, block) in enumerate(parts):
        owners = np.concatenate(
            [np.full(imap.size_local, comm.rank, dtype=np.int64), imap.owners.astype(np.int64)]
        )
        blocks = np.concatenate([np.arange(*imap.local_range), imap.ghosts])
        before = starts[owners, 0] if which == 1 else 0
        first = rank_offset[owners] + before + (blocks - starts[owners, 2 + which]) * block
        numbers.append((first[:, None] + np.arange(block)).ravel())
    n_first = len(numbers[0])
    owned_local = np.concatenate([np.arange(owned[0]), n_first + np.arange(owned[1])])
    return GlobalNumbering(
        np.concatenate(numbers).astype(np.int32), sum(owned), owned_local.astype(np.int32)
    )
