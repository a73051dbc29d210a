"""From a triangulation on rank 0 to a distributed mesh, through a Gmsh model."""

from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from opticcup_fem.compat import model_to_mesh
from opticcup_fem.errors import MeshError
from opticcup_fem.mesh.gmsh_session import gmsh_model
from opticcup_fem.mesh.surface_mesh import SurfaceMesh
from opticcup_fem.mesh.surfaces import Surface
from opticcup_fem.mesh.triangulation import Triangulation

__all__ = ["distribute", "fill_model"]

_LINE, _TRIANGLE = 1, 2


def distribute(
    build: Callable[[], Triangulation],
    surface: Surface,
    comm: MPI.Comm,
    circles: Sequence[str] = (),
) -> SurfaceMesh:
    """Build a triangulation on rank 0 and share it out (collective).

    Args:
        build: Makes the triangulation; called on rank 0 only.
        surface: The smooth surface on which the vertices lie.
        comm: Communicator of the mesh.
        circles: Names of the curves that are circles about the z axis.

    Raises:
        MeshError: ``build`` failed on rank 0; raised with the same sentence on every rank.
    """
    triangulation: Triangulation | None = None
    failure: Exception | None = None
    if comm.rank == 0:
        try:
            triangulation = build()
        except Exception as error:  # whatever it is, no other rank may wait for ever
            failure = error
    sentence = comm.bcast(None if failure is None else str(failure), root=0)
    if failure is not None:
        raise failure
    if sentence is not None:
        raise MeshError(sentence)
    names = None if triangulation is None else (triangulation.regions, triangulation.curves)
    regions, curves = comm.bcast(names, root=0)
    if triangulation is not None:
        with gmsh_model() as gmsh:
            fill_model(gmsh, triangulation)
            parts = model_to_mesh(gmsh.model, comm)
    else:
        parts = model_to_mesh(None, comm)
    return SurfaceMesh(*parts, regions, curves, surface, frozenset(circles))


def fill_model(gmsh: Any, triangulation: Triangulation) -> None:
    """Put a triangulation into Gmsh's current model as discrete, physically tagged entities.

    Args:
        gmsh: The gmsh module, its current model empty.
        triangulation: What to put there; node tags are vertex numbers plus one.
    """
    tags = np.arange(1, len(triangulation.points) + 1)
    groups = (
        (1, _LINE, triangulation.curves, triangulation.edges, triangulation.edge_curve),
        (2, _TRIANGLE, triangulation.regions, triangulation.cells, triangulation.cell_region),
    )
    nodes_added = False
    for dim, kind, names, topology, values in groups:
        for name, number in names.items():
            gmsh.model.addDiscreteEntity(dim, number)
            if not nodes_added:
                gmsh.model.mesh.addNodes(dim, number, tags, triangulation.points.ravel())
                nodes_added = True
            nodes = topology[values == number] + 1
            gmsh.model.mesh.addElementsByType(number, kind, [], nodes.ravel())
            gmsh.model.addPhysicalGroup(dim, [number], number, name)
