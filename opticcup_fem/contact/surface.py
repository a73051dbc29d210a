r"""The surfaces that can touch: both faces of a shell, and rigid obstacles, as flat triangles.

The faces are cut into flat triangles whose corners are linear in the places of the face at the
nodes (``faces.ShellFaces``): v = P x, P the cubic interpolation of ``snapshot.subdivide``.
Vertices are numbered: inner face, outer face, obstacles.

A shell's layers are thicker than its vertices are apart, so that neighbours along the shell are
always "near".  Parts nearer than a given distance in the reference surface never collide.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from functools import cached_property, reduce

import ipctk
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from opticcup_fem.contact.obstacles import Obstacle, ObstacleMesh, joined
from opticcup_fem.snapshot import Floats, Integers, subdivide


class ContactSurface:
    """Collision mesh of a shell's two faces and of obstacles; serial.

    Attributes:
        n_sites: Sites at which the faces are given.
        n_face: Vertices of one face.
        exempt: Parts nearer than this, and the sizes of their triangles, never collide.
        closed: Whether the shell lies between its two faces everywhere.
        parts: Parts of each cell's edge.
        map: P, shape (n_face, n_sites).
        face_triangles: Triangles of one face, cell by cell, winding as the outside demands, shape
            (m parts^2, 3).
        triangles: Triangles of all, shape (n_triangles, 3).
    """

    def __init__(
        self,
        reference: Floats,
        cells: Integers,
        orientation: Floats,
        exempt: float,
        parts: int = 3,
        obstacles: Sequence[Obstacle] = (),
        closed: bool | None = None,
        nodes: Integers | None = None,
    ) -> None:
        """Build the mesh.

        Args:
            reference: Reference positions of the sites at which faces are given, shape
                (n_sites, 3).
            cells: Sites of the cubic cells, shape (m, 10).
            orientation: +1 where a cell's nodes wind as the outside demands, else -1, shape (m,).
            exempt: Parts nearer than this in the reference position never collide.
            parts: Parts of each cell's edge; with 3 the vertices are the nodes.
            obstacles: Rigid bodies.
            closed: Whether the cells are of a closed surface; None to find out from them.
            nodes: Node that each site is at, shape (n_sites,); the faces pass through the middle
                of the sites at a node.  If None every site is a node.
        """
        self.n_sites, self.exempt, self.parts = len(reference), exempt, parts
        nodes = np.arange(self.n_sites) if nodes is None else nodes
        cut = subdivide(
            nodes[cells], parts, orientation=orientation, n_nodes=int(nodes.max(initial=-1)) + 1
        )
        self.map = sparse.csr_array(cut.matrix @ node_means(nodes))
        self.face_triangles: NDArray[np.int32] = cut.triangles
        self.n_face = n = self.map.shape[0]
        self.obstacles = tuple(obstacles)
        self._rigid: ObstacleMesh = joined(self.obstacles, 0.0)
        outer = self.face_triangles + n
        inner = self.face_triangles[:, ::-1]
        rigid = self._rigid.triangles + 2 * n
        self.triangles: NDArray[np.int32] = np.concatenate([inner, outer, rigid]).astype(np.int32)
        self._rest: Floats = self.map @ reference
        self.closed = _is_closed(self.face_triangles) if closed is None else closed

    @cached_property
    def mesh(self) -> ipctk.CollisionMesh:
        """IPC Toolkit's mesh."""
        rest, faces = self._rest, np.asfortranarray(self.triangles)
        places = np.concatenate([rest, rest, _shrunk(self._rigid, rest, self.face_triangles)])
        mesh = ipctk.CollisionMesh(np.asfortranarray(places), ipctk.edges(faces), faces)
        mesh.init_adjacencies()
        mesh.can_collide = self._filter(rest, self.face_triangles, self.exempt)
        return mesh

    @cached_property
    def _pull(self) -> sparse.csr_array:
        """Map from the faces at the sites to all vertices, shape (3 n_vertices, 6 n_sites)."""
        faces = sparse.block_diag([self.map, self.map], format="csr")
        held = sparse.csr_array((len(self._rigid.vertices), 2 * self.n_sites))
        both = sparse.vstack([faces, held])
        return sparse.csr_array(sparse.kron(both, sparse.eye_array(3)))

    @cached_property
    def _pull_back(self) -> sparse.csr_array:
        return sparse.csr_array(self._pull.T)

    def _filter(
        self,
        rest: Floats,
        triangles: NDArray[np.int32],
        exempt: float,
    ) -> ipctk.CollisionFilter:
        """Return which vertices can collide: no neighbours, no two of obstacles.

        The faces of a closed surface have the shell between them everywhere: only an open one
        can touch its inner face with its outer.
        """
        n, obstacles = self.n_face, len(self._rigid.vertices)
        apart = ipctk.make_sparse_filter(
            _neighbours(rest, triangles, exempt, across=not self.closed), True
        )
        rules = [apart]
        if self.closed:
            side = np.repeat([0, 1, 2], [n, n, obstacles]).astype(np.int32)
            same_side = ~ipctk.make_vertex_patches_filter(side)
            body = np.repeat([0, 1], [2 * n, obstacles]).astype(np.int32)
            of_obstacle = ipctk.make_vertex_patches_filter(body)
            rules.insert(0, same_side | of_obstacle if obstacles else same_side)
        if obstacles:
            rules.insert(0, ipctk.make_static_obstacle_filter(2 * n))
        return reduce(operator.and_, rules)

    def vertices(self, faces: Floats, time: float = 0.0) -> Floats:
        """Return the places of all vertices, shape (n_vertices, 3), in Fortran's order.

        Args:
            faces: Places of the inner and the outer face at the sites, shape (2, n_sites, 3).
            time: Normalised time, for obstacles that move.
        """
        placed = joined(self.obstacles, time).vertices
        return np.asfortranarray(np.concatenate([*(self.map @ face for face in faces), placed]))

    def holds_obstacle(self, half: float) -> bool:
        """Return whether an obstacle's vertex lies in the wall of the shell at its start.

        Args:
            half: Half the shell's thickness.
        """
        if len(self._rigid.vertices) == 0:
            return False
        distances, _ = cKDTree(self._rest).query(self._rigid.vertices)
        return bool(distances.min() < half)

    def pull_back(self, forces: Floats) -> Floats:
        """Return forces on the vertices, shape (n_vertices, 3), as ones on the faces at the sites.

        Returns:
            Shape (2, n_sites, 3).
        """
        pulled: Floats = (self._pull_back @ forces.ravel()).reshape(2, -1, 3)
        return pulled

    def pull_back_matrix(self, hessian: sparse.csc_matrix) -> sparse.csr_array:
        """Return a Hessian in the vertices as one in the faces, shape (6 n_sites, 6 n_sites)."""
        pulled = sparse.csr_array(self._pull_back @ sparse.csr_array(hessian) @ self._pull)
        pulled.eliminate_zeros()
        return pulled

    def side(self, vertices: Integers) -> Integers:
        """Return 0 for vertices of the inner face, 1 of the outer, 2 of an obstacle."""
        sides: Integers = np.minimum(vertices // self.n_face, 2)
        return sides


def node_means(nodes: Integers) -> sparse.csr_array:
    """Return the map from values at sites to their means at nodes, shape (n_nodes, n_sites)."""
    every = np.arange(len(nodes))
    return sparse.csr_array((1 / np.bincount(nodes)[nodes], (nodes, every)))


def _is_closed(triangles: NDArray[np.int32]) -> bool:
    """Return whether every edge is that of two triangles."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] == 2).all())


def _shrunk(rigid: ObstacleMesh, rest: Floats, triangles: NDArray[np.int32]) -> Floats:
    """Return obstacles' vertices drawn together until their triangles are no larger than a face's.

    The toolkit takes weights from the rest positions: a pair weighs as the area of its parts, and
    the edge between the two large triangles of a plate would weigh as much as the plate.
    """
    if len(rigid.triangles) == 0:
        return rigid.vertices
    areas = [_areas(rest, triangles), _areas(rigid.vertices, rigid.triangles)]
    shrink = min(1.0, float(np.sqrt(np.median(areas[0]) / areas[1].max())))
    shrunk: Floats = shrink * rigid.vertices
    return shrunk


def _areas(vertices: Floats, triangles: NDArray[np.int32]) -> Floats:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    areas: Floats = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return areas


def longest_edges(corners: Floats) -> Floats:
    """Return the longest edge of triangles with corners (n, 3, 3), shape (n,)."""
    longest: Floats = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return longest


def vertex_sizes(vertices: Floats, triangles: NDArray[np.int32]) -> Floats:
    """Return the length of the longest edge at each vertex, shape (n,)."""
    size = np.zeros(len(vertices))
    for first, second in ((0, 1), (1, 2), (2, 0)):
        ends = triangles[:, [first, second]]
        length = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
        np.maximum.at(size, ends, length[:, None])
    return size


def _neighbours(
    rest: Floats, triangles: NDArray[np.int32], distance: float, across: bool
) -> dict[tuple[int, int], bool]:
    """Return pairs of vertices that do not collide, each with False.

    Parts collide if any of their vertices may.  So that no parts nearer than the distance do,
    vertices are exempt up to that distance and the sizes of their triangles more.

    Args:
        rest: Reference positions of one face's vertices, shape (n, 3).
        triangles: Its triangles.
        distance: In the reference position.
        across: Whether to return pairs of one vertex on each face, too.
    """
    n, size = len(rest), vertex_sizes(rest, triangles)
    near = cKDTree(rest).query_pairs(distance + 2 * size.max(), output_type="ndarray")
    apart = np.linalg.norm(rest[near[:, 0]] - rest[near[:, 1]], axis=1)
    near = np.sort(near[apart < distance + size[near].sum(axis=1)], axis=1)
    pairs = [near, near + n]
    if across:
        other = np.array([0, n])
        same = np.repeat(np.arange(n)[:, None], 2, axis=1)
        pairs += [near + other, near[:, ::-1] + other, same + other]
    low, high = np.concatenate(pairs).T.tolist()
    return dict.fromkeys(zip(low, high, strict=True), False)
