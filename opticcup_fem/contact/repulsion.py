r"""Contact of a shell with itself: points of its cubic faces repel each other.

The potential is a double integral over the faces,

    E_s = 1/2 int int c(X, Y) k/(2 pi d_hat) psi(|x - y|^2/d_hat^2) dA_X dA_Y,

x and y the places of X and Y, areas those of the reference position, psi of ``contact.law``: two
flat parallel faces have the energy k d_hat b(g/d_hat) per area.  There are no closest points, no
normals and no triangles in it, so that it is as smooth as the faces are when they slide on each
other.  c(X, Y) is nought for neighbours along the shell, nearer than the distance in the reference
position that the collision mesh exempts, and grows smoothly to 1 where they are farther.  Only
parts of one face touch: the shell is closed.

It is summed over the midpoints of triangles that are .4 d_hat large where the faces are *now*;
they are laid out anew with ``forget``, and kept in between.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from opticcup_fem.contact.law import repulsion, rise
from opticcup_fem.contact.surface import ContactSurface, longest_edges
from opticcup_fem.snapshot import (
    Floats,
    Integers,
    lagrange_basis,
    lagrange_gradient,
    lattice,
    midpoints,
)

SPACING = 0.4
"""Size of the triangles that points stand for, over d_hat."""

ROOM = 0.25
"""How far points may move, over d_hat, before those that are near are looked for again."""

RAMP = 1.0
"""Range of reference distances, over the thickness, in which c grows from 0 to 1."""

SKEWED = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
"""From coordinates in a triangle to an equilateral one, where the nearest midpoint is that of the
part that a point is in."""

BULGE = 1.15
"""Radius of a curved patch over that of its corners: a bound for looking."""


class _Parts(NamedTuple):
    """Some of the n^2 equal parts of patches, which stand for their midpoints; shape (k,) each.

    Attributes:
        patch: Patch of each, counted over both faces.
        n: Parts of the patch's edge.
        number: Which of its n^2 parts, in the order of ``midpoints``.
    """

    patch: Integers
    n: Integers
    number: Integers

    def of(self, some: Integers) -> _Parts:
        """Return some of them."""
        return _Parts(*(values[some] for values in self))


class _Points(NamedTuple):
    """Points of a face that stand for the triangles around them, shape (n, ...).

    Attributes:
        map: From both faces at the nodes to the points, shape (n, 2 n_nodes).
        patch: The patch that each is in.
        rest: Reference places.
        area: Reference areas: for all of a patch the mean of its own.
    """

    map: sparse.csr_array
    patch: Integers
    rest: Floats
    area: Floats


class _Near(NamedTuple):
    """Points that are near each other, and their pairs.

    Attributes:
        faces: Faces for which it was made.
        map: From both faces at the nodes to the points, shape (n_points, 2 n_nodes).
        pairs: Points of each pair, shape (n_pairs, 2).
        weights: c times the areas of both points, shape (n_pairs,).
    """

    faces: Floats
    map: sparse.csr_array
    pairs: Integers
    weights: Floats


class _Touching(NamedTuple):
    """Pairs nearer than d_hat at some places of the faces.

    Attributes:
        pairs: Their points, shape (n, 2).
        apart: Difference of these points' places, over d_hat, shape (n, 3).
        square: Its square, shape (n,).
        weights: Weights, shape (n,).
    """

    pairs: Integers
    apart: Floats
    square: Floats
    weights: Floats


class Repulsion:
    """Contact potential of a shell's faces with themselves; serial.

    Places of faces have shape (2, n_nodes, 3), the inner one first.

    Attributes:
        distance: d_hat, the gap at which it begins.
        stiffness: k [stress].
    """

    def __init__(
        self,
        reference: Floats,
        cells: Integers,
        surface: ContactSurface,
        thickness: float,
        distance: float,
        stiffness: float,
    ) -> None:
        """Take the triangles of a collision mesh as patches of which near ones are looked for.

        Args:
            reference: Reference positions of the nodes, shape (n_nodes, 3).
            cells: Nodes of the cubic cells, shape (m, 10).
            surface: Collision mesh of these cells.
            thickness: Thickness of the shell.
            distance: d_hat.
            stiffness: k.
        """
        self.distance, self.stiffness = distance, stiffness
        self._reference, self._cells = reference, cells
        self._exempt, self._ramp = surface.exempt, RAMP * thickness
        points, triangles = lattice(surface.parts)
        self._corners = points[triangles] / surface.parts
        self._basis = lagrange_basis(self._corners).reshape(-1, 3, 10)
        rest = self._patches(reference)
        self._radius = _radius(rest)
        slopes = lagrange_gradient(self._corners.mean(axis=1))
        base = np.einsum("tja,cji->ctai", slopes, reference[cells]).reshape(-1, 2, 3)
        area = np.linalg.norm(np.cross(base[:, 0], base[:, 1]), axis=1)
        self._area = area / (2 * len(self._corners))
        self._levels: Integers | None = None
        self._near: _Near | None = None
        self._touching: tuple[Floats, _Touching] | None = None

    def forget(self) -> None:
        """Lay the points out anew at the next places: what begins here repeats."""
        self._levels = self._near = self._touching = None

    # --- which points are near ----------------------------------------------------------------

    def _patches(self, x: Floats) -> Floats:
        """Return the corners of all patches, cell by cell, shape (n_patches, 3, 3)."""
        corners: Floats = np.einsum("tkj,cji->ctki", self._basis, x[self._cells])
        return corners.reshape(-1, 3, 3)

    def _list(self, faces: Floats) -> _Near:
        """Return the points that are near each other at places of the faces."""
        corners = [self._patches(face) for face in faces]
        if self._levels is None:
            size = np.maximum(*(longest_edges(c) for c in corners))
            self._levels = np.ceil(size / (SPACING * self.distance)).astype(int)
        reach = (1 + 2 * ROOM) * self.distance
        radius = np.concatenate([_radius(c) for c in corners])
        points = self._points(self._parts_near(faces, radius, reach))
        x = points.map @ faces.reshape(-1, 3)
        pairs = self._pairs(x, points.patch, np.zeros(len(x)), reach)
        beyond = (_distances(points.rest, pairs) - self._exempt) / self._ramp
        weights = rise(np.asarray(beyond, dtype=np.float64)) * points.area[pairs].prod(axis=1)
        return _Near(faces.copy(), points.map, pairs[weights > 0], weights[weights > 0])

    def _parts_near(self, faces: Floats, radius: Floats, reach: float) -> _Parts:
        """Return the parts of patches, as small as points stand for, that others are near to.

        Pairs of patches that are near each other are cut into pairs of their quarters, again and
        again, until these are two to four times as large as points stand for.

        Args:
            faces: Places of the faces.
            radius: Radii of the patches of both faces.
            reach: What is near.
        """
        assert self._levels is not None
        count = len(self._radius)
        every: Integers = np.arange(2 * count)
        parts = _Parts(every, np.ones_like(every), np.zeros_like(every))
        x, rest = self._midpoints(parts, faces)
        pairs = self._pairs(x, parts.patch, radius, reach)
        while True:
            large = radius[parts.patch] / parts.n
            extent = self._radius[parts.patch % count] / parts.n
            apart = _distances(x, pairs) - large[pairs].sum(axis=1)
            far = _distances(rest, pairs) + extent[pairs].sum(axis=1)
            some, numbers = np.unique(
                pairs[(far > self._exempt) & (apart < reach)], return_inverse=True
            )
            parts, pairs = parts.of(some), numbers.reshape(-1, 2)
            level = self._levels[parts.patch % count]
            cut = 4 * parts.n <= level
            if not cut.any():
                return _cut_to(level, parts)
            parts, pairs = _quartered(parts, pairs, cut)
            x, rest = self._midpoints(parts, faces)

    def _pairs(self, x: Floats, patch: Integers, radius: Floats, reach: float) -> Integers:
        """Return pairs of balls that are nearer than the reach and whose faces can touch.

        Args:
            x: Their centres, shape (k, 3).
            patch: The patch that each is in.
            radius: Their radii, shape (k,).
            reach: Distance.

        Returns:
            Shape (n, 2); some that are farther apart as well.
        """
        outer = patch >= len(self._radius)
        groups = [np.flatnonzero(~outer), np.flatnonzero(outer)]
        found = [group[_balls_near(x[group], radius[group], reach)] for group in groups]
        pairs: Integers = np.concatenate(found)
        return pairs

    def _interpolation(self, parts: _Parts) -> tuple[Floats, Integers]:
        """Return the basis at midpoints of parts and its nodes, both of shape (k, 10)."""
        cell, kind = np.divmod(parts.patch % len(self._radius), len(self._corners))
        basis = np.empty((len(cell), 10))
        for n in np.unique(parts.n):
            middle = midpoints(int(n))
            weights = np.column_stack([1 - middle.sum(axis=1), middle])
            inside = np.einsum("qk,tka->tqa", weights, self._corners).reshape(-1, 2)
            table = lagrange_basis(inside).reshape(len(self._corners), len(middle), 10)
            some = parts.n == n
            basis[some] = table[kind[some], parts.number[some]]
        return basis, self._cells[cell]

    def _midpoints(self, parts: _Parts, faces: Floats) -> tuple[Floats, Floats]:
        """Return where the midpoints of parts are, now and in the reference, shape (k, 3) each."""
        basis, nodes = self._interpolation(parts)
        side = parts.patch // len(self._radius)
        x = np.einsum("qj,qji->qi", basis, faces[side[:, None], nodes])
        return x, np.einsum("qj,qji->qi", basis, self._reference[nodes])

    def _points(self, parts: _Parts) -> _Points:
        """Return the points that stand for parts."""
        basis, nodes = self._interpolation(parts)
        side, patch = np.divmod(parts.patch, len(self._radius))
        rest = np.einsum("qj,qji->qi", basis, self._reference[nodes])
        n_nodes = len(self._reference)
        where = ((nodes + side[:, None] * n_nodes).ravel(), 10 * np.arange(len(side) + 1))
        matrix = sparse.csr_array((basis.ravel(), *where), shape=(len(side), 2 * n_nodes))
        return _Points(matrix, parts.patch, rest, self._area[patch] / parts.n**2)

    def _listed(self, faces: Floats) -> _Near:
        """Return the list of near points, made afresh where it does not hold."""
        if self._near is not None:
            moved = np.linalg.norm(faces - self._near.faces, axis=2).max()
            if moved > ROOM / BULGE * self.distance:
                self._near = None
        if self._near is None:
            self._near = self._list(faces)
        return self._near

    def _touch(self, faces: Floats) -> _Touching:
        """Return the pairs nearer than d_hat."""
        if self._touching is None or self._touching[0] is not faces:
            near = self._listed(faces)
            x = near.map @ faces.reshape(-1, 3) / self.distance
            apart = x[near.pairs[:, 0]] - x[near.pairs[:, 1]]
            square = np.einsum("pi,pi->p", apart, apart)
            within = square < 1
            parts = (near.pairs[within], apart[within], square[within], near.weights[within])
            self._touching = faces, _Touching(*parts)
        return self._touching[1]

    # --- the potential ------------------------------------------------------------------------

    @property
    def _scale(self) -> float:
        return self.stiffness / (2 * np.pi * self.distance)

    def energy(self, faces: Floats) -> float:
        """Return E_s."""
        touching = self._touch(faces)
        return self._scale * float(touching.weights @ repulsion(touching.square)[0])

    def gap(self, faces: Floats) -> float:
        """Return the least distance of points, inf where it exceeds d_hat."""
        square = self._touch(faces).square
        return self.distance * float(np.sqrt(square.min())) if len(square) else np.inf

    def _pushes(self, faces: Floats) -> Floats:
        """Return dE_s/dx at the listed points, shape (n_points, 3)."""
        touching = self._touch(faces)
        size = 2 * self._scale / self.distance * touching.weights * repulsion(touching.square)[1]
        pulls = size[:, None] * touching.apart
        return _difference(pulls, touching.pairs, self._listed(faces).map.shape[0])

    def gradient(self, faces: Floats) -> Floats | None:
        """Return dE_s/dx of the faces at the nodes, shape (2, n_nodes, 3), None without touch."""
        if len(self._touch(faces).square) == 0:
            return None
        value: Floats = (self._listed(faces).map.T @ self._pushes(faces)).reshape(2, -1, 3)
        return value

    def hessian(self, faces: Floats, convex: bool = False) -> sparse.csr_array | None:
        """Return d2E_s/dx2, shape (6 n_nodes, 6 n_nodes), None without touch.

        Args:
            faces: Places of the faces.
            convex: Without negative eigenvalues: only what the pairs give along the forces on their
                points, where it is positive.
        """
        touching, near = self._touch(faces), self._listed(faces)
        if len(touching.square) == 0:
            return None
        _, slope, bend = repulsion(touching.square)
        scale = 2 * self._scale / self.distance**2 * touching.weights
        along, across = 2 * scale * bend, scale * slope
        direction = touching.apart
        if convex:
            push = self._pushes(faces)
            direction = push[touching.pairs[:, 0]] - push[touching.pairs[:, 1]]
            direction /= np.linalg.norm(direction, axis=1, keepdims=True) + np.finfo(float).tiny
            part = np.einsum("pi,pi->p", direction, touching.apart)
            along, across = np.maximum(along * part**2 + across, 0.0), np.zeros_like(across)
        points, pairs = np.unique(touching.pairs, return_inverse=True)
        rows = near.map[points]
        columns, indices = np.unique(rows.indices, return_inverse=True)
        narrow = sparse.csr_array(
            (rows.data, indices.ravel(), rows.indptr), shape=(len(points), len(columns))
        )
        pairs, n = pairs.reshape(-1, 2), 2 * len(self._reference)
        data, row, column = [], [], []
        for a in range(3):
            for b in range(a, 3):
                stiffness = along * direction[:, a] * direction[:, b] + (a == b) * across
                between = _laplacian(stiffness, pairs, len(points))
                block = sparse.coo_array(narrow.T @ between @ narrow)
                first, second = 3 * columns[block.coords[0]], 3 * columns[block.coords[1]]
                for i, j in {(a, b), (b, a)}:
                    data.append(block.data)
                    row.append(first + i)
                    column.append(second + j)
        where = (np.concatenate(row), np.concatenate(column))
        return sparse.csr_array((np.concatenate(data), where), shape=(3 * n, 3 * n))


def _parents(n: int, parts: int) -> Integers:
    """Return for each of n^2 equal parts of a triangle in which of parts^2 its midpoint is."""
    _, nearest = cKDTree(midpoints(parts) @ SKEWED).query(midpoints(n) @ SKEWED)
    parents: Integers = nearest
    return parents


def _cut_to(level: Integers, parts: _Parts) -> _Parts:
    """Return the parts of patches whose edges have ``level`` parts that lie in given ones."""
    found = [_Parts(*np.empty((3, 0), dtype=np.int64))]
    for k, n in np.unique(np.column_stack([level, parts.n]), axis=0):
        some = np.flatnonzero((level == k) & (parts.n == n))
        inside = _parents(int(k), int(n)) == parts.number[some, None]
        place, number = np.nonzero(inside)
        found.append(_Parts(parts.patch[some][place], np.full_like(number, k), number))
    return _Parts(*(np.concatenate(values) for values in zip(*found, strict=True)))


def _quartered(parts: _Parts, pairs: Integers, cut: NDArray[np.bool_]) -> tuple[_Parts, Integers]:
    """Return some parts cut into four, with the others, and the pairs of all that pairs become.

    Args:
        parts: Parts.
        pairs: Numbers of the parts of each pair, shape (n_pairs, 2).
        cut: Which parts are cut.
    """
    count = np.where(cut, 4, 1)
    first = np.cumsum(count) - count
    whole = np.repeat(np.arange(len(cut)), count)
    quarter = np.arange(len(whole)) - first[whole]
    number = parts.number[whole]
    for n in np.unique(parts.n[cut]):
        inside = np.argsort(_parents(2 * int(n), int(n)), kind="stable").reshape(-1, 4)
        some = cut[whole] & (parts.n[whole] == n)
        number[some] = inside[number[some], quarter[some]]
    finer = _Parts(parts.patch[whole], parts.n[whole] * (1 + cut[whole]), number)
    ways = count[pairs]
    pair = np.repeat(np.arange(len(pairs)), ways.prod(axis=1))
    start = np.cumsum(ways.prod(axis=1)) - ways.prod(axis=1)
    one, other = np.divmod(np.arange(len(pair)) - start[pair], ways[pair, 1])
    return finer, first[pairs[pair]] + np.column_stack([one, other])


def _distances(x: Floats, pairs: Integers) -> Floats:
    """Return the distances of pairs of points, shape (n,)."""
    first, second = np.ascontiguousarray(pairs.T)
    square = np.zeros(len(pairs))
    for along in np.ascontiguousarray(x.T):  # by columns: pairs are many
        square += (along[first] - along[second]) ** 2
    return np.sqrt(square)


def _balls_near(x: Floats, radius: Floats, reach: float) -> Integers:
    """Return pairs of balls that are nearer than the reach, and some more, shape (n, 2).

    Balls are searched in classes of like radius: a few large ones would else be near to all.
    """
    found = [np.empty((0, 2), dtype=np.int64)]
    kind = np.ceil(np.log2(np.maximum(radius, reach) / reach)).astype(int)
    classes = [np.flatnonzero(kind == k) for k in np.unique(kind)]
    trees = [(c, cKDTree(x[c]), radius[c].max()) for c in classes]
    for (first, tree, size), (second, other, larger) in itertools.combinations(trees, 2):
        within = size + larger + reach
        met = tree.sparse_distance_matrix(other, within, output_type="ndarray")
        found.append(np.column_stack([first[met["i"]], second[met["j"]]]))
    for members, tree, size in trees:
        found.append(members[tree.query_pairs(2 * size + reach, output_type="ndarray")])
    pairs: Integers = np.concatenate(found)
    return pairs


def _radius(corners: Floats) -> Floats:
    """Return the radii of patches around the means of their corners, shape (n,)."""
    away = np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max(axis=1)
    radius: Floats = BULGE * away
    return radius


def _difference(values: Floats, pairs: Integers, n: int) -> Floats:
    """Return the sum of values (n_pairs, 3) at first points less that at second ones, (n, 3)."""
    first, second = pairs.T
    parts = [np.bincount(first, v, n) - np.bincount(second, v, n) for v in values.T]
    return np.stack(parts, axis=1)


def _laplacian(stiffness: Floats, pairs: Integers, n: int) -> sparse.csr_array:
    """Return the matrix of sum s (v_i - v_j)^2 over pairs (i, j), shape (n, n)."""
    i, j = pairs.T
    sums = np.bincount(i, stiffness, n) + np.bincount(j, stiffness, n)
    values = np.concatenate([-stiffness, -stiffness, sums])
    every = np.arange(n)
    where = (np.concatenate([i, j, every]), np.concatenate([j, i, every]))
    return sparse.csr_array((values, where), shape=(n, n))
