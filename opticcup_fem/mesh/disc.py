"""Planar discs meshed by Gmsh, and the map that puts them on a sphere.

The stereographic map is conformal and takes circles to circles.  A well-shaped Delaunay mesh of the
plane disc therefore stays one on the sphere, and neither a pole nor a seam is special.
"""

import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from opticcup_fem.errors import MeshError
from opticcup_fem.mesh.gmsh_session import gmsh_model

__all__ = ["SizeField", "jitter", "mesh_disc", "on_sphere", "plane_radius"]

Array = npt.NDArray[np.float64]
SizeField = Callable[[float, float], float]

_FRONTAL_DELAUNAY = 6
_TRIANGLE = 2


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


def mesh_disc(rim: Array, cell_size: SizeField, seed: int) -> tuple[Array, npt.NDArray[np.int64]]:
    """Triangulate the polygon ``rim`` with a vertex at the origin.

    Args:
        rim: Corners of the polygon, counter-clockwise, shape (n, 2); every one becomes a vertex,
            every side one edge of the mesh.
        cell_size: Wanted edge length at a plane point (x, y).
        seed: Seed of Gmsh's own random numbers.

    Returns:
        Vertices, shape (p, 2): first the rim's n in order, then the origin, then the others; and
        counter-clockwise triangles, shape (m, 3).

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
        corners = [geo.addPoint(x, y, 0.0) for x, y in rim]
        origin = geo.addPoint(0.0, 0.0, 0.0)
        sides = [geo.addLine(a, b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
        surface = geo.addPlaneSurface([geo.addCurveLoop(sides)])
        geo.synchronize()
        for side in sides:
            mesh.setTransfiniteCurve(side, 2)
        mesh.embed(0, [origin], 2, surface)
        mesh.setSizeCallback(lambda dim, tag, x, y, z, size: cell_size(x, y))
        mesh.generate(2)
        mesh.optimize("Relocate2D", niter=3)  # gains two degrees on the smallest angles
        special = [int(mesh.getNodes(0, point)[0][0]) for point in [*corners, origin]]
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
