"""Named curves of a mesh as edges of its cells."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from dolfinx import mesh as dmesh
from numpy.typing import NDArray

from opticcup_fem.errors import MeshError
from opticcup_fem.mesh import SurfaceMesh
from opticcup_fem.shell.spaces import ShellSpaces

EdgeMask = NDArray[np.bool_]


def curve_edges(mesh: SurfaceMesh, curve: str) -> NDArray[np.int32]:
    """Return the local numbers of the edges on a named curve.

    Raises:
        MeshError: The mesh has no such curve.
    """
    if curve not in mesh.curves:
        raise MeshError(f"the mesh has no curve {curve!r}; it has {sorted(mesh.curves)}.")
    edges: NDArray[np.int32] = mesh.facet_tags.find(mesh.curves[curve])
    return edges


def region_mask(mesh: SurfaceMesh, spaces: ShellSpaces, region: str | None) -> EdgeMask:
    """Return which owned cells belong to a region, all of them for None, shape (n_cells,).

    Raises:
        MeshError: The mesh has no such region.
    """
    if region is None:
        return np.ones(spaces.n_cells, dtype=bool)
    if region not in mesh.regions:
        raise MeshError(f"the mesh has no region {region!r}; it has {sorted(mesh.regions)}.")
    mask = np.zeros(spaces.n_cells, dtype=bool)
    cells = mesh.cell_tags.find(mesh.regions[region])
    mask[cells[cells < spaces.n_cells]] = True
    return mask


def cell_edges(
    mesh: SurfaceMesh, spaces: ShellSpaces, curve: str, side: str | None = None
) -> EdgeMask:
    """Return which edges of the owned cells lie on a curve, each seen once (collective).

    Args:
        mesh: The mesh.
        spaces: Numbering of cells and edges.
        curve: Name of the curve.
        side: Region from which it is seen; needed where cells lie on both of its sides.

    Returns:
        Shape (n_cells, 3).

    Raises:
        MeshError: The mesh has no such curve or region, or the curve has two sides and none is
            named, or the region does not touch it.
    """
    edges = curve_edges(mesh, curve)
    mask: EdgeMask = np.isin(spaces.edges, edges)
    mask &= region_mask(mesh, spaces, side)[:, None]
    comm: MPI.Comm = spaces.mesh.comm
    if side is None:
        inside = not np.all(np.isin(edges, boundary_edges(spaces)))
        if comm.allreduce(inside, MPI.LOR):
            raise MeshError(
                f"curve {curve!r} has cells on both sides; name the side to see it from, one of "
                f"{sorted(mesh.regions)}."
            )
    elif not comm.allreduce(bool(mask.any()), MPI.LOR):
        raise MeshError(f"curve {curve!r} does not touch region {side!r}.")
    return mask


def boundary_edges(spaces: ShellSpaces) -> NDArray[np.int32]:
    """Return the rank's edges on the boundary of the surface (collective)."""
    topology = spaces.mesh.topology
    topology.create_connectivity(1, 2)
    edges: NDArray[np.int32] = dmesh.exterior_facet_indices(topology)
    return edges


def is_closed(spaces: ShellSpaces) -> bool:
    """Return whether the surface has no boundary (collective)."""
    return int(spaces.mesh.comm.allreduce(len(boundary_edges(spaces)))) == 0
