"""Where a shell first touches itself, its current thickness counted, from snapshots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ipctk
import numpy as np
from scipy.spatial import cKDTree

from opticcup_fem.contact.surface import node_means, vertex_sizes
from opticcup_fem.snapshot import Floats, Integers, Snapshot, colatitudes, subdivide

_REFINED = 20
"""Nearest pairs of vertices around which the surfaces' distance is looked for."""


@dataclass(frozen=True)
class Nearest:
    """The two parts of a shell that are nearest to each other, or deepest in each other.

    Attributes:
        gap: Distance of their mid-surfaces less half the thickness of each: negative where the
            layers overlap.
        position: Place half-way between them, shape (3,).
        colatitudes: Their reference colatitudes (rad), the smaller first.
        inside: For each whether it is the inner face that faces the other.
    """

    gap: float
    position: Floats
    colatitudes: tuple[float, float]
    inside: tuple[bool, bool]

    def describe(self, alpha: float) -> dict[str, Any]:
        """Return fields for an event: what touches what, and where.

        Args:
            alpha: Colatitude of the interface (rad).
        """
        parts = [part_name(theta, alpha) for theta in self.colatitudes]
        return {
            "parts": f"{parts[0]} against {parts[1]}",
            "position": self.position.tolist(),
            "colatitudes_deg": np.rad2deg(self.colatitudes).tolist(),
            "faces": ["inner" if inside else "outer" for inside in self.inside],
        }


def part_name(theta: float, alpha: float) -> str:
    """Return the name of the part of a cup at a reference colatitude (rad).

    >>> [part_name(x, 0.7) for x in (0.1, 0.6, 0.9, 2.0, 3.1)]
    ['apex', 'cap', 'rim', 'wall', 'bottom']
    """
    if theta <= alpha:
        return "apex" if theta < alpha / 2 else "cap"
    if theta < alpha + (np.pi - alpha) / 4:
        return "rim"
    return "bottom" if theta > 0.85 * np.pi else "wall"


class TouchMeter:
    """Finds the nearest parts of one mesh's surface, neighbours apart, in any number of states."""

    def __init__(self, snapshot: Snapshot, exempt: float, parts: int = 3) -> None:
        """Prepare what depends on the mesh alone.

        Args:
            snapshot: Any state on the mesh.
            exempt: Parts nearer than this in the reference position cannot touch.
            parts: Parts of each cell's edge; with 3 the vertices are the nodes.
        """
        cut = subdivide(snapshot.cells, parts)
        self._map, self._triangles = cut.matrix, cut.triangles
        self._means, self._exempt = node_means(snapshot.cells.ravel()), exempt
        self._rest = self._map @ snapshot.reference
        self._size = vertex_sizes(self._rest, self._triangles)
        self._theta = colatitudes(self._rest)

    def __call__(self, snapshot: Snapshot) -> Nearest | None:
        """Return the nearest parts, None where none is nearer than a thickness."""
        vectors = np.empty((len(snapshot.cells), 10, 2, 3))
        for region, faces in snapshot.faces.items():
            cells = snapshot.cells_of(region)
            middle = snapshot.position[snapshot.cells[cells]]
            vectors[cells] = faces[:, :, [0, -1]] - middle[:, :, None]
        offsets = (self._means @ vectors.reshape(-1, 6)).reshape(-1, 2, 3)
        x = self._map @ snapshot.position
        half = self._map @ np.linalg.norm(offsets, axis=2)
        normal = self._map @ (offsets[:, 1] - offsets[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        pairs = cKDTree(x).query_pairs(3 * half.max(), output_type="ndarray")
        apart = np.linalg.norm(self._rest[pairs[:, 0]] - self._rest[pairs[:, 1]], axis=1)
        pairs = pairs[apart >= self._exempt + self._size[pairs].sum(axis=1)]
        if len(pairs) == 0:
            return None
        way = x[pairs[:, 1]] - x[pairs[:, 0]]
        ahead = np.stack([way, -way], axis=1)
        outside = np.einsum("pki,pki->pk", ahead, normal[pairs]) > 0
        room = np.take_along_axis(half[pairs], outside[..., None].astype(int), axis=2)[..., 0]
        gaps = np.linalg.norm(way, axis=1) - room.sum(axis=1)
        best = np.argsort(gaps)[:_REFINED]
        refined = [self._distance(x, pairs[k]) - room[k].sum() for k in best]
        k = int(best[int(np.argmin(refined))])
        order = np.argsort(self._theta[pairs[k]])
        theta = self._theta[pairs[k]][order]
        inner = ~outside[k][order]
        return Nearest(
            float(min(refined)),
            x[pairs[k]].mean(axis=0),
            (float(theta[0]), float(theta[1])),
            (bool(inner[0]), bool(inner[1])),
        )

    def _distance(self, x: Floats, pair: Integers) -> float:
        """Return the least distance of either vertex from the triangles around the other."""
        distances = []
        for vertex, other in (pair, pair[::-1]):
            for triangle in np.flatnonzero((self._triangles == other).any(axis=1)):
                corners = x[self._triangles[triangle]]
                distances.append(ipctk.point_triangle_distance(x[vertex], *corners))
        return float(np.sqrt(min(distances)))
