"""The differences between versions of what we stand on, one small function each.

dolfinx 0.9 and later, with their UFL and FFCx; PyVista 0.44 and later.  Nothing heavy is imported
at the top: pictures need no dolfinx.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import inspect
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from mpi4py import MPI

    from dolfinx import fem, mesh

__all__ = [
    "KERNEL_HAS_CUSTOM_DATA",
    "cell_corners",
    "cell_name",
    "interpolation_points",
    "model_to_mesh",
    "outer_surface",
]


def _version(distribution: str) -> tuple[int, int]:
    """Return (major, minor) of an installed distribution."""
    major, minor = importlib.metadata.version(distribution).split(".")[:2]
    return int(major), int(minor)


def model_to_mesh(model: Any, comm: MPI.Comm) -> tuple[mesh.Mesh, mesh.MeshTags, mesh.MeshTags]:
    """Distribute a Gmsh model that lives on rank 0 (collective).

    Module ``gmshio`` and a tuple in dolfinx 0.9, ``gmsh`` and a ``MeshData`` in later versions.

    Args:
        model: ``gmsh.model`` on rank 0; ignored elsewhere.
        comm: Communicator of the mesh.

    Returns:
        Mesh with gdim 3 and no ghost cells, cell tags (dim 2) and facet tags (dim 1).
    """
    if _version("fenics-dolfinx") < (0, 10):
        gmshio = importlib.import_module("dolfinx.io.gmshio")
        msh, cell_tags, facet_tags = gmshio.model_to_mesh(model, comm, 0, gdim=3)
        return msh, cell_tags, facet_tags
    data = importlib.import_module("dolfinx.io.gmsh").model_to_mesh(model, comm, 0, gdim=3)
    if data.facet_tags is None:
        none = np.empty(0, dtype=np.int32)
        meshtags = importlib.import_module("dolfinx.mesh").meshtags
        return data.mesh, data.cell_tags, meshtags(data.mesh, 1, none, none)
    return data.mesh, data.cell_tags, data.facet_tags


def interpolation_points(space: fem.FunctionSpace) -> npt.NDArray[np.float64]:
    """Return the reference points of a space's element, shape (number of points, 2).

    A method in dolfinx 0.9, a property in later versions.  For Lagrange spaces these are
    the element's nodes, in the order of a cell's degrees of freedom.
    """
    points = space.element.interpolation_points
    return np.asarray(points() if callable(points) else points)


def cell_name(element: Any) -> str:
    """Return the name of an element's cell, such as "interval".

    A method of UFL's cells up to version 2024.2 (dolfinx 0.9), later a property.
    """
    name = element.cell.cellname
    return str(name() if callable(name) else name)


def cell_corners(msh: mesh.Mesh) -> npt.NDArray[np.int32]:
    """Return the geometry nodes of all cells of a rank, shape (cells, corners).

    ``dofmap`` of the geometry in dolfinx 0.9 and 0.10, the first of its ``dofmaps`` from 0.11.
    """
    geometry: Any = msh.geometry
    is_old = _version("fenics-dolfinx") < (0, 11)
    return np.asarray(geometry.dofmap if is_old else geometry.dofmaps[0])


def outer_surface(grid: Any) -> Any:
    """Return the outer faces of a PyVista grid as PolyData, by VTK's dataset surface filter.

    The filter is an argument since PyVista 0.47, and will have another default.
    """
    named = "algorithm" in inspect.signature(grid.extract_surface).parameters
    return grid.extract_surface(**({"algorithm": "dataset_surface"} if named else {}))


KERNEL_HAS_CUSTOM_DATA = _version("fenics-ffcx") >= (0, 10)
"""Whether FFCx kernels take a seventh argument, a pointer to custom data."""
