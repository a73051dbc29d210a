"""Meshes in Gmsh's .msh files, regions and curves as physical groups."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx.mesh import entities_to_geometry

from opticcup_fem.compat import cell_corners
from opticcup_fem.errors import MeshError
from opticcup_fem.mesh.distribute import distribute, fill_model
from opticcup_fem.mesh.gmsh_session import gmsh_model
from opticcup_fem.mesh.surface_mesh import SurfaceMesh
from opticcup_fem.mesh.surfaces import Surface
from opticcup_fem.mesh.triangulation import Triangulation

__all__ = ["gather", "read_msh", "write_msh"]

_LINE, _TRIANGLE = 1, 2
_CLOSE = 1e-9


def write_msh(surface_mesh: SurfaceMesh, path: Path) -> None:
    """Write a mesh with its physical groups as a .msh file (collective).

    The file does not depend on the number of ranks.

    Raises:
        MeshError: The file cannot be written; raised on every rank.
    """
    triangulation = gather(surface_mesh)
    comm = surface_mesh.mesh.comm
    failure = None
    if triangulation is not None:
        try:
            path.open("a").close()  # Gmsh's own message would not say why
            with gmsh_model(Mesh_Binary=0) as gmsh:
                fill_model(gmsh, triangulation)
                gmsh.write(str(path))
        except (OSError, MeshError) as error:
            failure = f"cannot write the mesh {path}: {error}"
    failure = comm.bcast(failure, root=0)
    if failure is not None:
        raise MeshError(failure)


def read_msh(
    path: Path,
    surface: Surface,
    comm: MPI.Comm = MPI.COMM_WORLD,
    circles: Sequence[str] = ("interface", "rim"),
) -> SurfaceMesh:
    """Read first-order triangles with named physical groups (collective).

    Args:
        path: The .msh file.
        surface: The surface on which its vertices lie.
        comm: Communicator; the file is read on rank 0 and distributed.
        circles: Names of the curves that, where the file has them, are circles about the z axis.

    Raises:
        MeshError: The file is missing, is not such a mesh, or does not lie on the surface.
    """
    found: list[str] = []

    def build() -> Triangulation:
        if not path.is_file():
            raise MeshError(f"there is no mesh file {path}")
        with gmsh_model() as gmsh:
            gmsh.merge(str(path))
            triangulation = _from_model(gmsh, path)
        _check_on_surface(triangulation, surface, path)
        found.extend(name for name in circles if name in triangulation.curves)
        for name in found:
            _check_circle(triangulation, name, path)
        return triangulation

    surface_mesh = distribute(build, surface, comm)
    present = comm.bcast(found, root=0)
    return replace(surface_mesh, circles=frozenset(present))


def gather(surface_mesh: SurfaceMesh) -> Triangulation | None:
    """Return the whole mesh on rank 0, in the order of its first creation (collective).

    Returns:
        The triangulation on rank 0, None on other ranks.
    """
    mesh, comm = surface_mesh.mesh, surface_mesh.mesh.comm
    original = mesh.geometry.input_global_indices
    cell_count = mesh.topology.index_map(2).size_local
    node_count = mesh.geometry.index_map().size_local
    region = np.zeros(cell_count, dtype=np.int32)
    owned_cells = surface_mesh.cell_tags.indices < cell_count
    region[surface_mesh.cell_tags.indices[owned_cells]] = surface_mesh.cell_tags.values[owned_cells]
    mesh.topology.create_connectivity(1, 2)
    tags = surface_mesh.facet_tags
    owned_edges = tags.indices < mesh.topology.index_map(1).size_local
    on_curves: npt.NDArray[np.int32] = np.empty((0, 2), dtype=np.int32)
    if owned_edges.any():  # dolfinx 0.9 divides by the number of entities
        on_curves = entities_to_geometry(mesh, 1, tags.indices[owned_edges])
    parts = comm.gather(
        {
            "node": original[:node_count],
            "point": mesh.geometry.x[:node_count],
            "cell": mesh.topology.original_cell_index[:cell_count],
            "corner": original[cell_corners(mesh)[:cell_count]],
            "region": region,
            "edge": original[on_curves].reshape(-1, 2),
            "curve": tags.values[owned_edges],
        }
    )
    if parts is None:
        return None
    whole = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
    cell_order = np.argsort(whole["cell"])
    edges = np.sort(whole["edge"], axis=1)
    edge_order = np.lexsort((edges[:, 1], edges[:, 0], whole["curve"]))
    return Triangulation(
        points=whole["point"][np.argsort(whole["node"])],
        cells=whole["corner"][cell_order],
        cell_region=whole["region"][cell_order],
        edges=edges[edge_order],
        edge_curve=whole["curve"][edge_order],
        regions=surface_mesh.regions,
        curves=surface_mesh.curves,
    )


def _from_model(gmsh: Any, path: Path) -> Triangulation:
    """Return the named triangles and lines of Gmsh's current model."""
    cells, cell_region, regions = _groups(gmsh, 2, _TRIANGLE, 3)
    edges, edge_curve, curves = _groups(gmsh, 1, _LINE, 2)
    if len(cells) == 0:
        raise MeshError(
            f"the mesh {path} has no first-order triangles in a named physical surface; "
            "name its regions with physical groups"
        )
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    used = np.unique(cells)
    if not np.isin(edges, used).all():
        raise MeshError(f"a named curve of the mesh {path} has vertices outside its named surfaces")
    position = np.full(int(tags.max()) + 1, -1)
    position[tags.astype(np.int64)] = np.arange(len(tags))
    return Triangulation(
        points=coordinates.reshape(-1, 3)[position[used]],
        cells=np.searchsorted(used, cells),
        cell_region=cell_region,
        edges=np.searchsorted(used, edges),
        edge_curve=edge_curve,
        regions=regions,
        curves=curves,
    )


def _groups(
    gmsh: Any, dim: int, kind: int, corners: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32], dict[str, int]]:
    """Return node tags (n, corners), group ids (n,) and names of one dimension's groups."""
    topology, values, names = [np.empty((0, corners), dtype=np.int64)], [], {}
    for _, group in gmsh.model.getPhysicalGroups(dim):
        name = gmsh.model.getPhysicalName(dim, group)
        if not name:
            continue
        names[name] = int(group)
        for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, group):
            nodes = gmsh.model.mesh.getElementsByType(kind, entity)[1]
            topology.append(nodes.astype(np.int64).reshape(-1, corners))
            values += [group] * len(topology[-1])
    return np.concatenate(topology), np.array(values, dtype=np.int32), names


def _check_on_surface(triangulation: Triangulation, surface: Surface, path: Path) -> None:
    """Refuse vertices off the surface."""
    points = triangulation.points
    off = float(np.abs(surface.project(points) - points).max())
    if off > _CLOSE * float(np.abs(points).max()):
        raise MeshError(
            f"the mesh {path} has vertices {off:.3g} off {surface}; "
            "project them onto it, or give the surface that they lie on"
        )


def _check_circle(triangulation: Triangulation, name: str, path: Path) -> None:
    """Refuse a curve that is not a circle about the z axis."""
    chosen = triangulation.edge_curve == triangulation.curves[name]
    points = triangulation.points[triangulation.edges[chosen]].reshape(-1, 3)
    radius_height = np.stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
    spread = float(np.ptp(radius_height, axis=1).max())
    if spread > _CLOSE * float(np.abs(points).max()):
        raise MeshError(
            f"the curve {name!r} of the mesh {path} is not a circle about the z axis (its vertices "
            f"differ by {spread:.3g} in radius or height); move them, or leave it out of circles"
        )
