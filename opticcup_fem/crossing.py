"""Whether the middle surface passes through itself, by IPC Toolkit on flat triangles.

A free shell's equilibrium may be one that no tissue can take, with one part of the surface inside
another.  The cubic surface is replaced by the flat triangles between its nodes; their edges are
tested against triangles with which they share no vertex.
"""

from dataclasses import dataclass

import ipctk
import numpy as np
from numpy.typing import NDArray

from opticcup_fem.snapshot import (
    Floats,
    Integers,
    Snapshot,
    Subdivision,
    colatitudes,
    subdivide,
)


@dataclass(frozen=True)
class Crossing:
    """Where a surface crosses itself: k places at which an edge pierces a triangle.

    Attributes:
        edges: Vertices of the piercing edges, shape (k, 2).
        triangles: Indices of the pierced triangles, shape (k,).
        positions: Where they meet, shape (k, 3).
        colatitudes: Reference colatitudes (rad) of the edge's and the triangle's centre, (k, 2).
    """

    edges: Integers
    triangles: Integers
    positions: Floats
    colatitudes: Floats

    def describe(self) -> dict[str, float | list[float]]:
        """Return fields for an event: number of places, one of them, its two colatitudes."""
        return {
            "places": len(self.triangles),
            "position": self.positions[0].tolist(),
            "colatitudes_deg": np.rad2deg(self.colatitudes[0]).tolist(),
        }


class CrossingCheck:
    """Looks for self-crossings of one triangulation, in any number of states."""

    def __init__(self, reference: Floats, triangles: NDArray[np.int32]) -> None:
        """Build the collision mesh.

        Args:
            reference: Reference positions of the vertices, shape (n, 3).
            triangles: Their triangles, shape (m, 3).
        """
        self._colatitude = colatitudes(reference)
        faces = np.asfortranarray(triangles, dtype=np.int32)
        self._mesh = ipctk.CollisionMesh(np.asfortranarray(reference), ipctk.edges(faces), faces)

    def __call__(self, vertices: Floats) -> Crossing | None:
        """Return the places at which the surface crosses itself, None if it does not.

        Args:
            vertices: Current positions of the vertices, shape (n, 3).
        """
        positions = np.asfortranarray(vertices, dtype=float)
        if not ipctk.has_intersections(self._mesh, positions):
            return None
        return self._places(positions)

    def _places(self, positions: Floats) -> Crossing | None:
        """Return all piercings among the pairs that a broad phase finds."""
        edges, faces = self._mesh.edges, self._mesh.faces
        broad = ipctk.LBVH()
        broad.build(positions, edges, faces)
        pairs = np.array([(p.edge_id, p.face_id) for p in broad.detect_edge_face_candidates()])
        shared = (edges[pairs[:, 0], :, None] == faces[pairs[:, 1], None, :]).any(axis=(1, 2))
        pairs = pairs[~shared]
        hits, where = [], []
        for (edge, face), ends, corners in zip(
            pairs, positions[edges[pairs[:, 0]]], positions[faces[pairs[:, 1]]], strict=True
        ):
            if ipctk.is_edge_intersecting_triangle(*ends, *corners):
                hits.append((edge, face))
                where.append(_meeting_point(ends, corners))
        if not hits:
            return None
        found = np.array(hits, dtype=np.int64)
        pierced = found[:, 1]
        piercing = edges[found[:, 0]].astype(np.int64)
        theta = [self._colatitude[piercing].mean(axis=1), self._colatitude[faces[pierced]].mean(1)]
        return Crossing(piercing, pierced, np.array(where), np.column_stack(theta))


def _meeting_point(ends: Floats, corners: Floats) -> Floats:
    """Return where an edge (2, 3) meets the plane of a triangle (3, 3), within the edge."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    rise, height = normal @ (ends[1] - ends[0]), normal @ (corners[0] - ends[0])
    # an edge in the triangle's plane has no single point: take its middle
    along = np.clip(height / rise, 0, 1) if abs(rise) > abs(height) * 1e-12 else 0.5
    place: Floats = (1 - along) * ends[0] + along * ends[1]
    return place


def surface_check(snapshot: Snapshot, n: int = 3) -> tuple[CrossingCheck, Subdivision]:
    """Return the check of a cubic surface, and the subdivision that gives its vertices.

    Args:
        snapshot: Any state on the mesh; its reference is taken to be free of crossings.
        n: Parts of each cell's edge; with 3 the vertices are the nodes.
    """
    subdivision = subdivide(snapshot.cells, n)
    check = CrossingCheck(subdivision.matrix @ snapshot.reference, subdivision.triangles)
    return check, subdivision


def self_crossings(snapshot: Snapshot, n: int = 3) -> Crossing | None:
    """Return where the surface of one state crosses itself, None if it does not.

    For many states on one mesh keep a `surface_check` instead.
    """
    check, subdivision = surface_check(snapshot, n)
    return check(subdivision.matrix @ snapshot.position)
