"""The meshes with a circle: cup, open cap and disk."""

from collections.abc import Sequence

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from opticcup_fem.mesh.checks import check_angle, check_symmetry, edge_count, positive
from opticcup_fem.mesh.disc import jitter, mesh_disc, on_sphere, plane_radius
from opticcup_fem.mesh.distribute import distribute
from opticcup_fem.mesh.refinement import STEEPEST, Refinement, refined
from opticcup_fem.mesh.surface_mesh import SurfaceMesh
from opticcup_fem.mesh.surfaces import Plane, Sphere
from opticcup_fem.mesh.triangulation import Triangulation

__all__ = ["cup_mesh", "disk_mesh", "open_cap_mesh"]

Array = npt.NDArray[np.float64]

TRANSITION = 0.5
"""Default distance from the circle, per radius, over which the cell size changes linearly.

It does not shrink with the sizes: halved sizes halve every cell, as convergence studies need.
"""


def cup_mesh(
    opening_angle: float,
    cell_size_cap: float,
    cell_size_interface: float,
    cell_size_oov: float,
    seed: int = 1,
    comm: MPI.Comm = MPI.COMM_WORLD,
    radius: float = 1.0,
    transition: float | None = None,
    symmetry: int = 0,
    refinements: Sequence[Refinement] = (),
) -> SurfaceMesh:
    """Mesh the closed sphere made of cap and OOV (collective).

    Regions "cap" (colatitude up to ``opening_angle``) and "oov", curve "interface" between them.
    Both poles and the interface's point at phi = 0 are vertices.

    Args:
        opening_angle: Colatitude alpha of the interface circle [rad], between 0 and pi.
        cell_size_cap: Edge length in the cap, away from the interface [length of ``radius``].
        cell_size_interface: Edge length on the interface circle.
        cell_size_oov: Edge length in the OOV, away from the interface.
        seed: Each seed gives its own mesh; the same seed always the same one.
        comm: Communicator; the mesh is made on rank 0 and distributed.
        radius: Radius R of the sphere.
        transition: Distance from the interface over which the cell size changes; half the radius
            unless given.
        symmetry: k of a mesh with k mirror planes through the z axis, the first one y = 0, and so
            of a k-fold axis; 0 for none.  Waves cos m phi with k = 2 m or more break its symmetry.
        refinements: Where cells are smaller than that; on a mesh with mirror planes in all images
            of these places, too.

    Raises:
        MeshError: An argument is out of range, or the interface circle would have fewer than
            eight edges.
    """
    surface = Sphere(radius)
    width = TRANSITION * radius if transition is None else transition
    *sizes, width = positive(
        cell_size_cap=cell_size_cap,
        cell_size_interface=cell_size_interface,
        cell_size_oov=cell_size_oov,
        transition=width,
    )
    cap, interface, oov = (size / radius for size in sizes)
    check_angle(opening_angle)
    check_symmetry(symmetry)
    edges = edge_count(np.sin(opening_angle), interface, "cell_size_interface", radius, symmetry)

    def build() -> Triangulation:
        phi = _angles(edges)
        shared = (interface, seed, width / radius, symmetry)
        spots = [spot.folded(symmetry).in_radii(radius) for spot in refinements]
        below = [spot.upside_down() for spot in spots]
        top, top_cells = _cap(opening_angle, phi, cap, *shared, spots)
        bottom, bottom_cells = _cap(np.pi - opening_angle, phi, oov, *shared, below)
        bottom = bottom * np.array([1.0, 1.0, -1.0])
        # one copy of the circle's vertices: the OOV's first ones are the cap's first ones
        others = np.arange(edges, len(bottom)) + len(top) - edges
        number = np.concatenate([np.arange(edges), others])
        return Triangulation(
            points=radius * np.vstack([top, bottom[edges:]]),
            cells=np.vstack([top_cells, number[bottom_cells][:, ::-1]]),
            cell_region=np.repeat([1, 2], [len(top_cells), len(bottom_cells)]).astype(np.int32),
            edges=_closed_loop(edges),
            edge_curve=np.ones(edges, dtype=np.int32),
            regions={"cap": 1, "oov": 2},
            curves={"interface": 1},
        )

    return distribute(build, surface, comm, circles=("interface",))


def open_cap_mesh(
    opening_angle: float,
    cell_size: float,
    cell_size_rim: float | None = None,
    seed: int = 1,
    comm: MPI.Comm = MPI.COMM_WORLD,
    radius: float = 1.0,
) -> SurfaceMesh:
    """Mesh the cap alone, an open shell (collective): region "cap", curve "rim".

    The apex and the rim's point at phi = 0 are vertices.

    Args:
        opening_angle: Colatitude of the rim [rad], between 0 and pi.
        cell_size: Edge length away from the rim.
        cell_size_rim: Edge length on the rim; ``cell_size`` unless given.
        seed: Each seed gives its own mesh.
        comm: Communicator; the mesh is made on rank 0 and distributed.
        radius: Radius of the sphere.

    Raises:
        MeshError: An argument is out of range, or the rim would have fewer than eight edges.
    """
    surface = Sphere(radius)
    rim_size = cell_size if cell_size_rim is None else cell_size_rim
    inner, rim = (s / radius for s in positive(cell_size=cell_size, cell_size_rim=rim_size))
    check_angle(opening_angle)
    edges = edge_count(np.sin(opening_angle), rim, "cell_size_rim", radius)

    def build() -> Triangulation:
        points, cells = _cap(opening_angle, _angles(edges), inner, rim, seed)
        return _single_region(radius * points, cells, "cap", edges)

    return distribute(build, surface, comm, circles=("rim",))


def disk_mesh(
    radius: float,
    cell_size: float,
    cell_size_rim: float | None = None,
    seed: int = 1,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> SurfaceMesh:
    """Mesh the flat disk about the origin (collective): region "disk", curve "rim".

    The centre and the rim's point at phi = 0 are vertices.

    Args:
        radius: Radius of the disk.
        cell_size: Edge length away from the rim.
        cell_size_rim: Edge length on the rim; ``cell_size`` unless given.
        seed: Each seed gives its own mesh.
        comm: Communicator; the mesh is made on rank 0 and distributed.

    Raises:
        MeshError: An argument is out of range, or the rim would have fewer than eight edges.
    """
    rim_size = cell_size if cell_size_rim is None else cell_size_rim
    positive(radius=radius)
    inner, rim = (s / radius for s in positive(cell_size=cell_size, cell_size_rim=rim_size))
    edges = edge_count(1.0, rim, "cell_size_rim", radius)

    def build() -> Triangulation:
        phi = _angles(edges)
        circle = np.stack([np.cos(phi), np.sin(phi)], axis=1)
        noise = jitter(seed)

        def size(x: float, y: float) -> float:
            place = np.array([x, y, 0.0])
            return _graded(1.0 - np.hypot(x, y), rim, inner) * noise(place)

        plane, cells = mesh_disc(circle, size, seed)
        points = np.hstack([plane, np.zeros((len(plane), 1))])
        points[:edges, :2] = circle
        return _single_region(radius * points, cells, "disk", edges)

    return distribute(build, Plane(), comm, circles=("rim",))


def _cap(
    angle: float,
    phi: Array,
    inner: float,
    rim: float,
    seed: int,
    width: float = TRANSITION,
    symmetry: int = 0,
    refinements: Sequence[Refinement] = (),
) -> tuple[Array, npt.NDArray[np.int64]]:
    """Mesh the unit sphere's cap about +z: rim vertices at ``phi`` first, then the pole."""
    noise = jitter(seed)

    def size(x: float, y: float) -> float:
        place = on_sphere(np.array([[x, y]]))[0]
        distance = angle - np.arccos(np.clip(place[2], -1.0, 1.0))
        wanted = refined(_graded(distance, rim, inner, width), place, refinements)
        # 1 + rho^2/4 is the stereographic map's local scale, plane over sphere
        return wanted * noise(place) * (1.0 + 0.25 * (x * x + y * y))

    circle = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    plane, cells = mesh_disc(plane_radius(angle) * circle, size, seed, symmetry)
    points = on_sphere(plane)
    points[: len(phi), :2] = np.sin(angle) * circle
    points[: len(phi), 2] = np.cos(angle)
    return points, cells


def _graded(distance: float, at_circle: float, inside: float, width: float = TRANSITION) -> float:
    """Return the cell size at a distance from the circle, all in units of the radius."""
    change = inside - at_circle
    width = max(width, abs(change) / STEEPEST)
    return at_circle + change * min(max(distance, 0.0) / width, 1.0)


def _angles(edges: int) -> Array:
    """Return equally spaced azimuths from phi = 0 [rad], shape (edges,)."""
    return 2.0 * np.pi * np.arange(edges) / edges


def _closed_loop(edges: int) -> npt.NDArray[np.int64]:
    """Return the edges (0, 1), (1, 2), ..., (edges - 1, 0), shape (edges, 2)."""
    start = np.arange(edges)
    return np.stack([start, np.roll(start, -1)], axis=1)


def _single_region(
    points: Array, cells: npt.NDArray[np.int64], region: str, edges: int
) -> Triangulation:
    """Return a triangulation of one region whose first ``edges`` vertices are its rim."""
    return Triangulation(
        points=points,
        cells=cells,
        cell_region=np.ones(len(cells), dtype=np.int32),
        edges=_closed_loop(edges),
        edge_curve=np.ones(edges, dtype=np.int32),
        regions={region: 1},
        curves={"rim": 1},
    )
