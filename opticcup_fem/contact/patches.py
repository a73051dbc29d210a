"""Which parts of a shell's faces may touch: patches in balls, with their normals in cones.

Along a line through a closed shell its faces look forth and back in turn, and those that touch
look at each other.  Two patches of one face whose normals are all within a right angle of each
other are neighbours along the shell, or have other parts of it in between.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.snapshot import Floats, Integers

BULGE = 1.15
"""Radius of a curved patch over that of its corners: a bound for looking."""

SPREAD = 1.3
"""Angle of a curved patch's normals from their mean over that of those at its corners."""

CLASSES = 2
"""Classes of like radius between one radius and its double."""


class Patches:
    """The triangles of both faces' collision mesh; serial, for closed shells without obstacles.

    Patches are counted over both faces, the inner one first.

    Attributes:
        count: Patches of one face.
        extent: Their radii in the reference position, shape (count,).
    """

    def __init__(self, rest: Floats, surface: ContactSurface) -> None:
        """Take the triangles.

        Args:
            rest: Reference positions of one face's vertices, shape (n_face, 3).
            surface: The collision mesh.
        """
        self._face, self._exempt = surface.face.astype(np.int64), surface.exempt
        self.count = len(surface.face)
        self._side = np.repeat([0, 1], self.count)
        self._rest, self.extent = _balls(rest[surface.face])

    def radius(self, *vertices: Floats) -> Floats:
        """Return the radii of all patches, shape (2 count,), the larger of those at all places."""
        radii = [_balls(_of_both(one, self._face))[1] for one in vertices]
        largest: Floats = np.max(radii, axis=0)
        return largest

    def near(self, *vertices: Floats, reach: float) -> Integers:
        """Return the pairs of patches of one face that may touch.

        Args:
            vertices: Places of both faces' vertices, each of shape (2 n_face, 3): one, or two
                between which they go straight.
            reach: Distance below which they touch.

        Returns:
            Shape (n, 2): all pairs that come nearer than the reach somewhere, but for neighbours
            along the shell; some that do not as well.
        """
        balls = [_balls(_of_both(one, self._face)) for one in vertices]
        x = np.stack([centre for centre, _ in balls])
        radius = np.max([radius for _, radius in balls], axis=0)
        middle = x.mean(axis=0)
        swept = radius + np.linalg.norm(x[0] - middle, axis=1)
        pairs = balls_near(middle, swept, reach, self._side)
        pairs = pairs[nearest(x, pairs) < radius[pairs].sum(axis=1) + reach]
        pairs = pairs[self._may_face(pairs, vertices)]
        rest = pairs % self.count
        far = distances(self._rest, rest) + self.extent[rest].sum(axis=1)
        touching: Integers = pairs[far > self._exempt]
        return touching

    def _may_face(self, pairs: Integers, vertices: Sequence[Floats]) -> NDArray[np.bool_]:
        """Return which pairs of patches may look at each other, from the cones of their normals."""
        normals = [_of_both(self._normals(one), self._face) for one in vertices]
        around = np.concatenate(normals, axis=1)
        axis = _unit(around.sum(axis=1))
        cosine = np.einsum("pki,pi->pk", around, axis).min(axis=1)
        angle = SPREAD * np.arccos(np.clip(cosine, -1.0, 1.0))
        first, second = pairs.T
        turned = np.einsum("pi,pi->p", axis[first], axis[second])
        may: NDArray[np.bool_] = turned < np.sin(
            np.minimum(angle[first] + angle[second], np.pi / 2)
        )
        return may

    def _normals(self, vertices: Floats) -> Floats:
        """Return the normals of both faces at their vertices, shape (2 n_face, 3)."""
        found = []
        for face in np.split(vertices, 2):
            a, b, c = (face[self._face[:, k]] for k in range(3))
            flat, corners = np.cross(b - a, c - a), self._face.ravel()
            sums = [np.bincount(corners, np.repeat(v, 3), len(face)) for v in flat.T]
            found.append(_unit(np.stack(sums, axis=1)))
        return np.concatenate(found)


def _of_both(values: Floats, pieces: Integers) -> Floats:
    """Return the values of both faces' vertices at those of pieces of one, (2 n, k, 3)."""
    return np.concatenate([face[pieces] for face in np.split(values, 2)])


def _unit(vectors: Floats) -> Floats:
    """Return vectors (..., 3) over their lengths."""
    tiny = np.finfo(float).tiny
    unit: Floats = vectors / (np.linalg.norm(vectors, axis=-1, keepdims=True) + tiny)
    return unit


def _balls(corners: Floats) -> tuple[Floats, Floats]:
    """Return centres and radii of balls around pieces with vertices (n, k, 3)."""
    centre = corners.mean(axis=1)
    away = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    return centre, BULGE * away


def distances(x: Floats, pairs: Integers) -> Floats:
    """Return the distances of pairs of points x (n, 3), shape (n_pairs,)."""
    return nearest(x[None], pairs)


def nearest(places: Floats, pairs: Integers) -> Floats:
    """Return the least distances of pairs of points that go straight.

    Args:
        places: Points where they are, or at both ends of their ways, shape (1 or 2, n, 3).
        pairs: Shape (n_pairs, 2).
    """
    first, second = np.ascontiguousarray(pairs.T)
    square, along, way = np.zeros((3, len(pairs)))
    for i in range(3):  # by columns: pairs are many
        start, end = (np.ascontiguousarray(places[k, :, i]) for k in (0, -1))
        apart = start[first] - start[second]
        square += apart * apart
        if len(places) > 1:
            change = (end[first] - end[second]) - apart
            along -= apart * change
            way += change * change
    share = np.clip(along / (way + np.finfo(float).tiny), 0.0, 1.0)
    return np.sqrt(np.maximum(square - share * (2 * along - share * way), 0.0))


def balls_near(x: Floats, radius: Floats, reach: float, group: Integers) -> Integers:
    """Return pairs of balls that are nearer than the reach, and some more, shape (n, 2).

    Balls are searched in classes of like radius: a few large ones would else be near to all.

    Args:
        x: Their centres, shape (n, 3).
        radius: Their radii, shape (n,).
        reach: Distance.
        group: Only pairs of one group are returned, shape (n,).
    """
    kind = np.ceil(CLASSES * np.log2(np.maximum(radius, reach) / reach)).astype(int)
    found = [np.empty((0, 2), dtype=np.int64)]
    for one in np.unique(group):
        classes = [np.flatnonzero((kind == k) & (group == one)) for k in np.unique(kind)]
        trees = [(c, cKDTree(x[c]), radius[c].max(initial=0.0)) for c in classes]
        for (first, tree, size), (second, other, larger) in itertools.combinations(trees, 2):
            within = size + larger + reach
            met = tree.sparse_distance_matrix(other, within, output_type="ndarray")
            found.append(np.column_stack([first[met["i"]], second[met["j"]]]))
        for members, tree, size in trees:
            found.append(members[tree.query_pairs(2 * size + reach, output_type="ndarray")])
    pairs: Integers = np.concatenate(found)
    return pairs
