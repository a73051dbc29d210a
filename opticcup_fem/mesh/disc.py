"""Planar discs meshed by Gmsh, and the map that puts them on a sphere.

The stereographic map is conformal and takes circles to circles.  A well-shaped Delaunay mesh of the
plane disc therefore stays one on the sphere, and neither a pole nor a seam is special.
"""

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from opticcup_fem.errors import MeshError
from opticcup_fem.mesh.gmsh_session import gmsh_model

__all__ = ["SizeField", "jitter", "mesh_disc", "on_sphere", "plane_radius"]

Array = npt.NDArray[np.float64]
SizeField = Callable[[float, float], float]

_FRONTAL_DELAUNAY = 6
_TRIANGLE = 2

_SAME = 1e-9
"""Vertices of mirrored copies that are nearer to each other are one; the disc's radius is 1."""


def plane_radius(angle: float) -> float:
    """Return ``2 tan(angle/2)``, the plane's radius for an angle from the pole [rad]."""
    return 2.0 * math.tan(0.5 * angle)


def on_sphere(x: Array) -> Array:
    """Return the unit sphere's points above the plane points ``x``, pole at +z.

    Stereographic projection from the pole -z: ``(x, 1 - rho^2/4) / (1 + rho^2/4)``.

    Args:
        x: Plane points, shape (n, 2).

    Returns:
        Shape (n, 3), unit length.
    """
    quarter = 0.25 * np.einsum("ni,ni->n", x, x)[:, None]
    lifted = np.hstack([x, 1.0 - quarter]) / (1.0 + quarter)
    unit: Array = lifted / np.linalg.norm(lifted, axis=1, keepdims=True)
    return unit


def jitter(seed: int) -> Callable[[Array], float]:
    """Return a smooth random field around 1, a few per cent up and down.

    Multiplying cell sizes with it makes different seeds give different meshes of one quality.

    Args:
        seed: Any integer from 0.

    Returns:
        Function of a position, shape (3,) and of order one.
    """
    rng = np.random.default_rng(seed)
    waves = rng.normal(size=(4, 3)) * 3.0
    phases = rng.uniform(0.0, 2.0 * np.pi, size=4)
    return lambda x: 1.0 + 0.02 * float(np.sin(waves @ x + phases).sum())


def mesh_disc(
    rim: Array, cell_size: SizeField, seed: int, symmetry: int = 0
) -> tuple[Array, npt.NDArray[np.int64]]:
    """Triangulate the polygon ``rim`` with a vertex at the origin.

    Args:
        rim: Corners of the polygon, counter-clockwise, shape (n, 2); every one becomes a vertex,
            every side one edge of the mesh.
        cell_size: Wanted edge length at a plane point (x, y).
        seed: Seed of Gmsh's own random numbers.
        symmetry: k of a mesh that has k mirror lines through the origin, the first one y = 0; 0
            for a mesh without symmetry.  The rim must have it, with a corner on both ends of
            every line.

    Returns:
        Vertices, shape (p, 2): first the rim's n in order, then the origin, then the others; and
        counter-clockwise triangles, shape (m, 3).

    Raises:
        MeshError: Gmsh cannot mesh the polygon.
    """
    origin = np.zeros((1, 2))
    if symmetry == 0:
        first, triangles = _mesh_polygon(rim, origin, [], cell_size, seed)
        return first, triangles
    sides = len(rim) // (2 * symmetry)
    corners = np.vstack([origin, rim[: sides + 1]])
    wedge = _mesh_polygon(corners, np.empty((0, 2)), [0, len(corners) - 1], cell_size, seed)
    return _unfolded(*wedge, symmetry, np.vstack([rim, origin]))


def _mesh_polygon(
    corners: Array, inside: Array, free: list[int], cell_size: SizeField, seed: int
) -> tuple[Array, npt.NDArray[np.int64]]:
    """Triangulate a polygon.

    Args:
        corners: Counter-clockwise, shape (n, 2).
        inside: Further points that become vertices, shape (k, 2).
        free: Sides, by their first corner, that are cut as the cell size asks; the others are one
            edge each.
        cell_size: Wanted edge length at a plane point (x, y).
        seed: Seed of Gmsh's own random numbers.

    Returns:
        Vertices, first the corners and the points inside; counter-clockwise triangles.

    Raises:
        MeshError: Gmsh cannot mesh the polygon.
    """
    with gmsh_model(
        Mesh_Algorithm=_FRONTAL_DELAUNAY,
        Mesh_ElementOrder=1,
        Mesh_RandomSeed=seed,
        Mesh_MaxNumThreads2D=1,
        Mesh_MeshSizeExtendFromBoundary=0,
        Mesh_MeshSizeFromPoints=0,
        Mesh_MeshSizeFromCurvature=0,
        Mesh_MeshSizeMin=0.0,
        Mesh_MeshSizeMax=1e22,
    ) as gmsh:
        geo, mesh = gmsh.model.geo, gmsh.model.mesh
        ring = [geo.addPoint(x, y, 0.0) for x, y in corners]
        others = [geo.addPoint(x, y, 0.0) for x, y in inside]
        sides = [geo.addLine(a, b) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]
        surface = geo.addPlaneSurface([geo.addCurveLoop(sides)])
        geo.synchronize()
        for k, side in enumerate(sides):
            if k not in free:
                mesh.setTransfiniteCurve(side, 2)
        mesh.embed(0, others, 2, surface)
        mesh.setSizeCallback(lambda dim, tag, x, y, z, size: cell_size(x, y))
        mesh.generate(2)
        mesh.optimize("Relocate2D", niter=3)  # gains two degrees on the smallest angles
        special = [int(mesh.getNodes(0, point)[0][0]) for point in [*ring, *others]]
        tags, coordinates, _ = mesh.getNodes()
        triangles = mesh.getElementsByType(_TRIANGLE)[1].astype(np.int64).reshape(-1, 3)
    if len(triangles) == 0:
        raise MeshError("Gmsh returned no triangles; try other cell sizes or another seed")
    place = dict(zip(tags.astype(int).tolist(), coordinates.reshape(-1, 3)[:, :2], strict=True))
    used = [tag for tag in np.unique(triangles).tolist() if tag not in set(special)]
    order = special + used
    number = np.zeros(max(order) + 1, dtype=np.int64)
    number[order] = np.arange(len(order))
    return np.array([place[tag] for tag in order]), number[triangles]


def _unfolded(
    points: Array, triangles: npt.NDArray[np.int64], symmetry: int, first: Array
) -> tuple[Array, npt.NDArray[np.int64]]:
    """Mirror and turn the mesh of the wedge 0 <= phi <= pi/symmetry all the way round.

    Args:
        points: Vertices of the wedge, shape (p, 2).
        triangles: Counter-clockwise triangles, shape (m, 3).
        symmetry: Number of mirror lines.
        first: Vertices that come first in the mesh of the disc, in order, shape (n, 2).

    Returns:
        Vertices and counter-clockwise triangles of the disc.
    """
    copies: list[Array] = [first]
    cells: list[npt.NDArray[np.int64]] = []
    for k in range(symmetry):
        cos, sin = math.cos(2 * math.pi * k / symmetry), math.sin(2 * math.pi * k / symmetry)
        turn = np.array([[cos, sin], [-sin, cos]])
        for mirror in (1.0, -1.0):
            start = sum(map(len, copies))
            copies.append(points * np.array([1.0, mirror]) @ turn)
            cells.append(start + (triangles if mirror > 0 else triangles[:, ::-1]))
    together, corners = np.vstack(copies), np.vstack(cells)
    # the first of the copies of a vertex stands for all of them
    twins = cKDTree(together).query_pairs(_SAME, output_type="ndarray")
    stands: npt.NDArray[np.int64] = np.arange(len(together), dtype=np.int64)
    np.minimum.at(stands, twins.max(axis=1), twins.min(axis=1))
    kept, number = np.unique(stands, return_inverse=True)
    return together[kept], number[corners]
