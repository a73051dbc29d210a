"""One state of the shell's middle surface as plain arrays, and its cubic interpolation.

A `Snapshot` is what the solver hands to observables, records and pictures: nodes of a cubic
triangulation, their current positions, and the layers' data at the nodes of each cell.  Nothing
here knows a finite-element library, so snapshots can come from any solver, or from a formula.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

NODES: Floats = (
    np.array([[0, 0], [3, 0], [0, 3], [2, 1], [1, 2], [0, 1], [0, 2], [1, 0], [2, 0], [1, 1]]) / 3
)
"""Reference coordinates of the ten nodes, shape (10, 2), in basix order: vertices 0, 1, 2, two
nodes on each of the edges (1, 2), (0, 2), (0, 1), the interior node; equispaced."""

EDGES: Integers = np.array([[1, 2, 3, 4], [0, 2, 5, 6], [0, 1, 7, 8]])
"""Local nodes of the three edges, shape (3, 4): first vertex, second vertex, the nodes between."""

_POWERS = np.array([[i, j] for i in range(4) for j in range(4 - i)])


def _monomials(points: Floats) -> Floats:
    """Return xi^i eta^j at points (k, 2) for the ten powers of degree <= 3, shape (k, 10)."""
    monomials: Floats = np.prod(points[:, None, :] ** _POWERS, axis=2)
    return monomials


_COEFFICIENTS = np.linalg.inv(_monomials(NODES))


def lagrange_basis(points: ArrayLike) -> Floats:
    r"""Return the cubic Lagrange basis :math:`\phi_j(\xi, \eta)` of the triangle.

    Args:
        points: Reference coordinates (xi, eta), shape (k, 2); the triangle is
            xi >= 0, eta >= 0, xi + eta <= 1.  Points outside are extrapolated.

    Returns:
        Values, shape (k, 10), in the order of `NODES`; each row sums to 1.
    """
    return _monomials(np.asarray(points, dtype=float).reshape(-1, 2)) @ _COEFFICIENTS


def lagrange_gradient(points: ArrayLike) -> Floats:
    r"""Return :math:`(\partial \phi_j/\partial\xi, \partial\phi_j/\partial\eta)`.

    Args:
        points: Reference coordinates (xi, eta), shape (k, 2).

    Returns:
        First derivatives, shape (k, 10, 2), in the order of `NODES`.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 2)
    parts = []
    for axis in range(2):
        lowered = _POWERS.copy()
        lowered[:, axis] = np.maximum(lowered[:, axis] - 1, 0)
        monomials = _POWERS[:, axis] * np.prod(points[:, None, :] ** lowered, axis=2)
        parts.append(monomials @ _COEFFICIENTS)
    return np.stack(parts, axis=2)


@dataclass(frozen=True)
class Snapshot:
    """One state of a layered shell on a cubic triangulation, in plain arrays.

    Lengths are in units of the sphere's radius R, stresses in mu_IOV.  Layers and their faces are
    listed from the inside to the outside (sphere) or from below to above (plate).

    Attributes:
        t_n: Normalised time, 0 to 1.
        reference: Reference positions of the nodes, shape (n, 3).
        position: Current positions of the nodes, shape (n, 3).
        cells: Nodes of the cells in the order of `NODES`, shape (m, 10).
        region: Region number of each cell, shape (m,).
        orientation: +1 where d_xi r x d_eta r points outside, else -1; shape (m,).
        region_ids: Region number of each region name.
        layers: Layer names of each region, inside first.
        thickness_stretch: For each layer its through-thickness mean of lambda_3 at the nodes of
            the cells, shape (m, 10); NaN in cells without the layer.
        stress: For each layer its stress components at the nodes of the cells, shape (m, 10, 3);
            NaN in cells without the layer.
        faces: For each region the current positions of its layers' faces at the nodes of the
            region's cells (in the order of `cells_of`), shape (m_region, 10, n_layers + 1, 3).
        contact_traction: Force of contact on the nodes per reference area, shape (n, 3), where
            contact is resisted.
        growth: e and rho/rho_0 of layers that grow by their mass balance, ``e_<layer>`` and
            ``rho_<layer>`` at the nodes of the cells, shape (m, 10); NaN in cells without the
            layer.
    """

    t_n: float
    reference: Floats
    position: Floats
    cells: Integers
    region: Integers
    orientation: Floats
    region_ids: Mapping[str, int]
    layers: Mapping[str, tuple[str, ...]]
    thickness_stretch: Mapping[str, Floats]
    stress: Mapping[str, Floats]
    faces: Mapping[str, Floats]
    contact_traction: Floats | None = None
    growth: Mapping[str, Floats] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise ValueError where the arrays do not fit together."""
        if self.cells.ndim != 2 or self.cells.shape[1] != len(NODES):
            raise ValueError(f"cells have shape {self.cells.shape}; ten nodes a cell are needed")
        if self.reference.shape != self.position.shape or self.position.shape[1] != 3:
            raise ValueError(
                f"reference {self.reference.shape} and position {self.position.shape} must have "
                "the same shape (n, 3)"
            )
        for name, faces in self.faces.items():
            expected = (len(self.cells_of(name)), 10, len(self.layers[name]) + 1, 3)
            if faces.shape != expected:
                raise ValueError(f"faces of {name} have shape {faces.shape}, not {expected}")

    def cells_of(self, region: str) -> Integers:
        """Return the indices of a region's cells, shape (m_region,)."""
        return np.flatnonzero(self.region == self.region_ids[region])


def cell_values(values: Floats, cells: Integers, points: ArrayLike) -> Floats:
    """Interpolate a nodal field inside cells.

    Args:
        values: Field at the nodes, shape (n, ...).
        cells: Nodes of the k cells in question, shape (k, 10).
        points: One reference point for each of these cells, shape (k, 2).

    Returns:
        The field at the points, shape (k, ...).
    """
    at_points: Floats = np.einsum("kj,kj...->k...", lagrange_basis(points), values[cells])
    return at_points


def cell_tangents(values: Floats, cells: Integers, points: ArrayLike) -> Floats:
    """Return the derivatives of a nodal field by (xi, eta), shape (k, 2, ...).

    Args and shapes as for `cell_values`.
    """
    tangents: Floats = np.einsum("kjd,kj...->kd...", lagrange_gradient(points), values[cells])
    return tangents


def colatitudes(points: Floats) -> Floats:
    """Return the angles (rad) between the z-axis and points (..., 3), shape (...)."""
    angles: Floats = np.arctan2(np.hypot(points[..., 0], points[..., 1]), points[..., 2])
    return angles


def cell_normals(snapshot: Snapshot) -> Floats:
    """Return the outward unit normals of the cells at their nodes, shape (m, 10, 3)."""
    m = len(snapshot.cells)
    repeated = np.repeat(snapshot.cells, len(NODES), axis=0)
    tangents = cell_tangents(snapshot.position, repeated, np.tile(NODES, (m, 1)))
    normal = np.cross(tangents[:, 0], tangents[:, 1]).reshape(m, len(NODES), 3)
    length = np.linalg.norm(normal, axis=2, keepdims=True)
    outward: Floats = normal * (snapshot.orientation[:, None, None] / length)
    return outward


@dataclass(frozen=True)
class Subdivision:
    """Flat triangles that replace each cubic cell.

    Attributes:
        matrix: Linear map from nodes to vertices, shape (n_vertices, n_nodes): the vertices of a
            nodal field f are ``matrix @ f``.
        triangles: Vertices of the triangles, shape (m n^2, 3), int32; cell by cell, turned so that
            they wind as the outside demands.
        cell: The cell of each triangle, shape (m n^2,).
        source_cell: For each vertex, one cell that holds it, shape (n_vertices,).
        source_point: The vertex in that cell, shape (n_vertices, 2).
    """

    matrix: sparse.csr_array
    triangles: NDArray[np.int32]
    cell: Integers
    source_cell: Integers
    source_point: Floats


def lattice(n: int) -> tuple[Integers, Integers]:
    """Return the points and triangles of a triangle cut into n^2 equal ones.

    Args:
        n: Parts of each edge, at least 1.

    Returns:
        Integer coordinates (i, j) with i, j >= 0 and i + j <= n, shape ((n+1)(n+2)/2, 2), and the
        triangles between them, shape (n^2, 3), counter-clockwise.
    """
    points = [(i, j) for j in range(n + 1) for i in range(n + 1 - j)]
    index = {point: k for k, point in enumerate(points)}
    triangles = []
    for i, j in points:
        if i + j < n:
            triangles.append([index[i, j], index[i + 1, j], index[i, j + 1]])
        if i + j < n - 1:
            triangles.append([index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]])
    return np.array(points), np.array(triangles)


def midpoints(n: int) -> Floats:
    """Return the midpoints of the n^2 triangles of ``lattice``, shape (n^2, 2)."""
    points, triangles = lattice(n)
    middle: Floats = points[triangles].mean(axis=1) / n
    return middle


def _shared_keys(cells: Integers, points: Integers, n: int) -> Integers:
    """Return a key for each lattice point of each cell, equal where cells share the point.

    Corner: (vertex, vertex, 0); on an edge: (low vertex, high vertex, steps from the low one);
    inside: (-1 - cell, 0, number of the point).  Shape (m, n_points, 3).
    """
    corners = cells[:, :3]
    weights = np.column_stack([n - points.sum(axis=1), points])
    keys = np.empty((len(cells), len(points), 3), dtype=np.int64)
    for k, weight in enumerate(weights):
        used = np.flatnonzero(weight)
        if len(used) == 3:
            keys[:, k, 0], keys[:, k, 1], keys[:, k, 2] = -1 - np.arange(len(cells)), 0, k
        elif len(used) == 1:
            keys[:, k, 0] = keys[:, k, 1] = corners[:, used[0]]
            keys[:, k, 2] = 0
        else:
            first, second = corners[:, used[0]], corners[:, used[1]]
            keys[:, k, 0], keys[:, k, 1] = np.minimum(first, second), np.maximum(first, second)
            keys[:, k, 2] = np.where(first < second, weight[used[1]], weight[used[0]])
    return keys


def subdivide(
    cells: Integers, n: int = 3, *, orientation: Floats | None = None, n_nodes: int | None = None
) -> Subdivision:
    """Cut cubic cells into n^2 flat triangles each, whose vertices lie on the cubic surface.

    Args:
        cells: Nodes of the cells, shape (m, 10).
        n: Parts of each edge.  With n = 3 the vertices are the cells' nodes, in the nodes' order.
        orientation: -1 for cells whose triangles are to be turned round, shape (m,).
        n_nodes: Number of nodes of the fields to be mapped; by default the cells' last node + 1.

    Returns:
        The triangles, with vertices on shared edges merged, and the map from nodes to vertices.
    """
    n_nodes = int(cells.max()) + 1 if n_nodes is None else n_nodes
    points, triangles = lattice(n)
    m, n_points = len(cells), len(points)
    if n == 3:
        local = [int(np.argmin(np.abs(NODES - p / 3).sum(axis=1))) for p in points]
        keys = cells[:, local]
        _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    else:
        keys = _shared_keys(cells, points, n).reshape(-1, 3)
        _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    number = inverse.reshape(m, n_points)
    source_cell, source_point = first // n_points, points[first % n_points] / n

    values = lagrange_basis(source_point)
    # vertices that are nodes map to them exactly, free of rounding
    values = np.where(np.abs(values - np.rint(values)) < 1e-13, np.rint(values), values)
    rows = np.repeat(np.arange(len(first)), len(NODES))
    matrix = sparse.csr_array(
        (values.ravel(), (rows, cells[source_cell].ravel())), shape=(len(first), n_nodes)
    )
    matrix.eliminate_zeros()
    faces = number[:, triangles]
    if orientation is not None:
        turned = orientation < 0
        faces[turned] = faces[turned][:, :, ::-1]
    return Subdivision(
        matrix,
        faces.reshape(-1, 3).astype(np.int32),
        np.repeat(np.arange(m), len(triangles)),
        source_cell,
        source_point,
    )
