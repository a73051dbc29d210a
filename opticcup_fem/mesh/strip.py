"""The flat strip, a structured mesh."""

from mpi4py import MPI

import numpy as np

from opticcup_fem.errors import MeshError
from opticcup_fem.mesh.checks import positive
from opticcup_fem.mesh.distribute import distribute
from opticcup_fem.mesh.surface_mesh import SurfaceMesh
from opticcup_fem.mesh.surfaces import Plane
from opticcup_fem.mesh.triangulation import Triangulation

__all__ = ["strip_mesh"]


def strip_mesh(
    length: float,
    width: float,
    cells_along: int,
    cells_across: int,
    comm: MPI.Comm = MPI.COMM_WORLD,
) -> SurfaceMesh:
    """Mesh the rectangle [0, length] x [0, width] with alternating diagonals (collective).

    Region "strip"; curves "left" (x = 0), "right" (x = length), "bottom" (y = 0), "top".

    Args:
        length: Extent in x.
        width: Extent in y.
        cells_along: Number of rectangles in x, two triangles each.
        cells_across: Number of rectangles in y.
        comm: Communicator; the mesh is made on rank 0 and distributed.

    Raises:
        MeshError: A length is not positive or a count is below one.
    """
    positive(length=length, width=width)
    for name, count in (("cells_along", cells_along), ("cells_across", cells_across)):
        if count < 1:
            raise MeshError(f"{name} is {count}; give a whole number from 1")
    return distribute(lambda: _rectangle(length, width, cells_along, cells_across), Plane(), comm)


def _rectangle(length: float, width: float, along: int, across: int) -> Triangulation:
    """Return the rectangle's grid, each square halved, its diagonals alternating."""
    x, y = np.linspace(0.0, length, along + 1), np.linspace(0.0, width, across + 1)
    grid = np.arange((along + 1) * (across + 1)).reshape(along + 1, across + 1)
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros(grid.shape)], axis=-1)
    i, j = np.meshgrid(np.arange(along), np.arange(across), indexing="ij")
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    even = ((i + j) % 2 == 0)[..., None]
    first = np.where(even, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(even, np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    cells = np.stack([first, second], axis=2).reshape(-1, 3)
    sides = [grid[0], grid[-1], grid[:, 0], grid[:, -1]]
    edges = [np.stack([side[:-1], side[1:]], axis=1) for side in sides]
    return Triangulation(
        points=points.reshape(-1, 3),
        cells=cells,
        cell_region=np.ones(len(cells), dtype=np.int32),
        edges=np.vstack(edges),
        edge_curve=np.repeat([1, 2, 3, 4], [len(e) for e in edges]).astype(np.int32),
        regions={"strip": 1},
        curves={"left": 1, "right": 2, "bottom": 3, "top": 4},
    )
