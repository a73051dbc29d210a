"""A triangulation as plain arrays: what the builders make, before it is distributed."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

__all__ = ["Triangulation", "corner_angles"]


@dataclass(frozen=True)
class Triangulation:
    """Flat triangles with named regions and curves, on one process.

    Attributes:
        points: Vertices, shape (n, 3).
        cells: Vertex numbers of the triangles, shape (m, 3).
        cell_region: Region id of each triangle, shape (m,).
        edges: Vertex numbers of the edges on named curves, shape (l, 2).
        edge_curve: Curve id of each such edge, shape (l,).
        regions: Region name to id.
        curves: Curve name to id.
    """

    points: npt.NDArray[np.float64]
    cells: npt.NDArray[np.int64]
    cell_region: npt.NDArray[np.int32]
    edges: npt.NDArray[np.int64]
    edge_curve: npt.NDArray[np.int32]
    regions: dict[str, int] = field(default_factory=dict)
    curves: dict[str, int] = field(default_factory=dict)


def corner_angles(
    points: npt.NDArray[np.floating], cells: npt.NDArray[np.integer]
) -> npt.NDArray[np.float64]:
    """Return the corner angles of flat triangles [rad], shape (m, 3).

    Args:
        points: Vertices, shape (n, 3).
        cells: Vertex numbers, shape (m, 3).
    """
    corners = points[cells]
    to_next = np.roll(corners, -1, axis=1) - corners
    to_last = np.roll(corners, 1, axis=1) - corners
    cross = np.linalg.norm(np.cross(to_next, to_last), axis=-1)
    angles: npt.NDArray[np.float64] = np.arctan2(cross, np.einsum("mij,mij->mi", to_next, to_last))
    return angles
