"""Which parts of a shell's faces may touch: patches in balls, with their normals in cones.

Along a line through a closed shell its faces look forth and back in turn, and those that touch
look at each other.  Two patches of one face whose normals are all within a right angle of each
other are neighbours along the shell, or have other parts of it in between.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.snapshot import Floats, Integers

PARTS = 3
"""Parts of each cell's edge: patches are its triangles."""

BULGE = 1.15
"""Radius of a curved patch over that of its corners: a bound for looking."""

SPREAD = 1.3
"""Angle of a curved patch's normals from their mean over that of those at its corners."""

CLASSES = 3
"""Classes of like radius between one radius and its double."""


class Patches:
    """Both faces cut into triangles; serial, for closed shells without obstacles.

    Places are those of the vertices of both faces' triangles, shape (2 n_face, 3).

    Patches are counted over both faces, the inner one first.

    Attributes:
        triangles: Vertices of the patches of one face, shape (count, 3).
        count: Patches of one face.
        extent: Their radii in the reference position, shape (count,).
    """

    def __init__(self, reference: Floats, surface: ContactSurface) -> None:
        """Cut the cells of a surface.

        Args:
            reference: Reference positions of the sites, shape (n_sites, 3).
            surface: The surface.
        """
        self._map, triangles = surface.cut(PARTS)
        self.triangles: Integers = triangles.astype(np.int64)
        self._exempt = surface.exempt
        self.count, self._of_cell = len(triangles), PARTS**2
        in_cells = self.triangles.reshape(-1, 3 * self._of_cell)
        self._cells = np.stack([np.unique(corners) for corners in in_cells])
        rest: Floats = self._map @ reference
        self._rest, self.extent = _balls(rest[self.triangles])

    def vertices(self, faces: Floats) -> Floats:
        """Return the places of the vertices from those of both faces at the sites."""
        return np.concatenate([self._map @ face for face in faces])

    def radius(self, *vertices: Floats) -> Floats:
        """Return the radii of all patches, shape (2 count,), the larger of those at all places."""
        radii = [_balls(_of_both(one, self.triangles))[1] for one in vertices]
        largest: Floats = np.max(radii, axis=0)
        return largest

    def near(self, *vertices: Floats, reach: float) -> Integers:
        """Return the pairs of patches of one face that may touch.

        Args:
            vertices: Places of both faces' vertices, each of shape (2 n_face, 3): one, or two
                between which they go straight.
            reach: Distance below which they touch.

        Returns:
            Shape (n, 2), all pairs that come nearer than the reach somewhere, but for neighbours
            along the shell; some that do not as well.
        """
        normals = [self._normals(one) for one in vertices]
        cells = _Pieces.of(self._cells, vertices, normals)
        patches = _Pieces.of(self.triangles, vertices, normals)
        every = np.arange(len(cells.radius))
        itself = np.column_stack([every, every])
        found = np.concatenate([itself, cells.balls_near(reach)])
        first, second = _meeting(cells, cells, found, reach).T
        # the patches of the one cell with all of the other, then with each of its patches
        n = self._of_cell
        pairs = np.column_stack([_parts(first, n), np.repeat(second, n)])
        first, second = _meeting(patches, cells, pairs, reach).T
        pairs = np.column_stack([np.repeat(first, n), _parts(second, n)])
        same = pairs[:, 0] // n == pairs[:, 1] // n
        pairs = pairs[~same | (pairs[:, 0] < pairs[:, 1])]
        pairs = _meeting(patches, patches, pairs, reach)
        rest = pairs % self.count
        far = distances(self._rest, rest) + self.extent[rest].sum(axis=1)
        touching: Integers = pairs[far > self._exempt]
        return touching

    def _normals(self, vertices: Floats) -> Floats:
        """Return the normals of both faces at their vertices, shape (2 n_face, 3)."""
        found = []
        for face in np.split(vertices, 2):
            a, b, c = (face[self.triangles[:, k]] for k in range(3))
            flat, corners = np.cross(b - a, c - a), self.triangles.ravel()
            sums = [np.bincount(corners, np.repeat(v, 3), len(face)) for v in flat.T]
            found.append(_unit(np.stack(sums, axis=1)))
        return np.concatenate(found)


class _Pieces(NamedTuple):
    """Pieces of both faces at one place, or at the ends of a way: balls, and cones of normals.

    Attributes:
        centres: Centres of the balls at each place, shape (n_places, n, 3).
        radius: Their radii, the larger of those at both places, shape (n,).
        axis: Axes of the cones, which hold the normals at both places, shape (n, 3).
        angle: Their half angles, shape (n,).
    """

    centres: Floats
    radius: Floats
    axis: Floats
    angle: Floats

    @classmethod
    def of(
        cls, corners: Integers, vertices: Sequence[Floats], normals: Sequence[Floats]
    ) -> _Pieces:
        """Return pieces with the given vertices of one face as corners, shape (n, k)."""
        balls = [_balls(_of_both(one, corners)) for one in vertices]
        around = np.concatenate([_of_both(one, corners) for one in normals], axis=1)
        axis = _unit(around.sum(axis=1))
        cosine = np.einsum("pki,pi->pk", around, axis).min(axis=1)
        return cls(
            np.stack([centre for centre, _ in balls]),
            np.max([radius for _, radius in balls], axis=0),
            axis,
            SPREAD * np.arccos(np.clip(cosine, -1.0, 1.0)),
        )

    def balls_near(self, reach: float) -> Integers:
        """Return pairs of one face whose swept balls are near, and some more, shape (n, 2)."""
        middle = self.centres.mean(axis=0)
        swept = self.radius + np.linalg.norm(self.centres[0] - middle, axis=1)
        return balls_near(middle, swept, reach, np.repeat([0, 1], len(middle) // 2))


def _meeting(one: _Pieces, other: _Pieces, pairs: Integers, reach: float) -> Integers:
    """Return the pairs that may look at each other and come nearer than the reach."""
    first, second = np.ascontiguousarray(pairs.T)
    turned = np.zeros(len(pairs))
    for i in range(3):  # by columns: pairs are many
        turned += one.axis[:, i][first] * other.axis[:, i][second]
    within = np.minimum(one.angle[first] + other.angle[second], np.pi / 2)
    pairs = pairs[turned < np.sin(within)]
    first, second = np.ascontiguousarray(pairs.T)
    apart = _least(one.centres, other.centres, first, second)
    some: Integers = pairs[apart < one.radius[first] + other.radius[second] + reach]
    return some


def _parts(cells: Integers, n: int) -> Integers:
    """Return the n parts of each of some cells, shape (n len(cells),)."""
    parts: Integers = (n * cells[:, None] + np.arange(n)).ravel()
    return parts


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
    return _least(places, places, *np.ascontiguousarray(pairs.T))


def _least(one: Floats, other: Floats, first: Integers, second: Integers) -> Floats:
    """Return ``nearest`` of pairs of which one point is of one kind, and one of another."""
    square, along, way = np.zeros((3, len(first)))
    for i in range(3):  # by columns: pairs are many
        a, a_end = (np.ascontiguousarray(one[k, :, i]) for k in (0, -1))
        b, b_end = (np.ascontiguousarray(other[k, :, i]) for k in (0, -1))
        apart = a[first] - b[second]
        square += apart * apart
        if len(one) > 1:
            change = (a_end[first] - b_end[second]) - apart
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
