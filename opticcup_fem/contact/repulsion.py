r"""Contact of a shell with itself: points of its cubic faces repel each other.

The potential is a double integral over the faces,

    E_s = 1/2 int int c(X, Y) k/(2 pi d_hat) psi(|x - y|^2/d_hat^2) dA_X dA_Y,

x and y the places of X and Y, areas those of the reference position, psi of ``contact.law``: two
flat parallel faces have the energy k d_hat b(g/d_hat) per area.  There are no closest points, no
normals and no triangles in it, so that it is as smooth as the faces are when they slide on each
other.  c(X, Y) is nought for neighbours along the shell, nearer than the distance in the reference
position that the collision mesh exempts, and grows smoothly to 1 where they are farther.  Only
parts of one face touch: the shell is closed.

It is summed over the midpoints of triangles that are d_hat large where the faces are *now*,
smaller ones where gaps are narrow; they are laid out anew with ``forget``, and kept in between.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from opticcup_fem.contact.law import repulsion, rise
from opticcup_fem.contact.parts import NearParts, Parts, cut_to
from opticcup_fem.contact.patches import BULGE, balls_near, distances
from opticcup_fem.contact.surface import ContactSurface, longest_edges
from opticcup_fem.snapshot import Floats, Integers, lagrange_gradient

SPACING = 1.0
"""Size of the triangles that points stand for, over d_hat."""

NARROW = 0.3
"""Gap, over d_hat, below which they stand for triangles ``FINE`` d_hat large."""

FINE = 0.4
"""Size of the triangles that points of narrow gaps stand for, over d_hat."""

ROOM = 0.1
"""How far points may move, over d_hat, before those that are near are looked for again."""

FAR = 0.35
"""How far they may move before it is looked anew for those that can come near at all."""

COARSE = 3.0
"""Radius of the parts that are looked for, over the size of the triangles that points stand for."""

MANY = 20_000
"""Pairs of parts with which a quick look ends."""

AHEAD = 4.0
"""Room, over the length of a way, that a quick look looks for beside it."""

MOST_AHEAD = 2.0
"""The most of it, over d_hat: more takes longer to look for than it saves."""

RAMP = 1.0
"""Range of reference distances, over the thickness, in which c grows from 0 to 1."""

SYMMETRIC = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
"""Components of a symmetric matrix."""

SYMMETRIC_OF = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Number of each component among ``SYMMETRIC``."""


class _Points(NamedTuple):
    """Points of a face that stand for the triangles around them, shape (n, ...).

    Attributes:
        map: From both faces at the sites to the points, shape (n, 2 n_sites): ten entries each.
        cell: The cell that each is in, counted over both faces.
        rest: Reference places.
        area: Reference areas: for all of a patch the mean of its own.
    """

    map: sparse.csr_array
    cell: Integers
    rest: Floats
    area: Floats


class _Near(NamedTuple):
    """Points that are near each other, and their pairs.

    Attributes:
        faces: Faces for which it was made.
        points: Points that have others near.
        pairs: Points of each pair, shape (n_pairs, 2).
        weights: c times the areas of both points, shape (n_pairs,).
    """

    faces: Floats
    points: _Points
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

    Places of faces have shape (2, n_sites, 3), the inner one first.

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
        """Take what the reference position tells; points are laid out when they are needed.

        Args:
            reference: Reference positions of the sites, shape (n_sites, 3).
            cells: Sites of the cubic cells, shape (m, 10).
            surface: Surface of these cells.
            thickness: Thickness of the shell.
            distance: d_hat.
            stiffness: k.
        """
        self.distance, self.stiffness = distance, stiffness
        self._reference = reference
        self._exempt, self._ramp = surface.exempt, RAMP * thickness
        self._search = NearParts(reference, cells, surface)
        slopes = lagrange_gradient(self._search.corners.mean(axis=1))
        base = np.einsum("tja,cji->ctai", slopes, reference[cells]).reshape(-1, 2, 3)
        area = np.linalg.norm(np.cross(base[:, 0], base[:, 1]), axis=1)
        self._area = area / (2 * len(self._search.corners))
        self._size = SPACING * distance
        self._levels: Integers | None = None
        self._around: tuple[Floats, _Points] | None = None
        self._near: _Near | None = None
        self._touching: tuple[Floats, _Touching] | None = None
        self._clear: tuple[Floats, float] | None = None

    def forget(self, gap: float = np.inf) -> None:
        """Lay the points out anew at the next places: what begins here repeats.

        Args:
            gap: Gap that is to be resolved.
        """
        self._size = (SPACING if gap > NARROW * self.distance else FINE) * self.distance
        self._levels = self._around = self._near = self._touching = None

    # --- which points are near ----------------------------------------------------------------

    def _list(self, faces: Floats) -> _Near:
        """Return the points that are near each other at places of the faces."""
        points, reach = self._points_near(faces), (1 + 2 * ROOM) * self.distance
        x = points.map @ faces.reshape(-1, 3)
        side = points.cell // len(self._search.cells)
        pairs = balls_near(x, np.zeros(len(x)), reach, side)
        beyond = (distances(points.rest, pairs) - self._exempt) / self._ramp
        weights = rise(np.asarray(beyond, dtype=np.float64)) * points.area[pairs].prod(axis=1)
        return _Near(faces.copy(), points, pairs[weights > 0], weights[weights > 0])

    def _points_near(self, faces: Floats) -> _Points:
        """Return points to which others are near, or come near before they move far."""
        if self._around is None or _farthest(faces, self._around[0]) > FAR / BULGE * self.distance:
            if self._levels is None:
                self._levels = self._cuts(faces)
            reach, size = (1 + 2 * (ROOM + FAR)) * self.distance, COARSE * self._size
            parts, _ = self._search.near([faces], reach, size)
            level = self._levels[parts.patch % self._search.patches.count]
            self._around = faces.copy(), self._points(cut_to(level, parts))
        return self._around[1]

    def _cuts(self, faces: Floats) -> Integers:
        """Return into how many parts the edges of patches are cut for points, shape (count,)."""
        patches = self._search.patches
        sides = (face[patches.triangles] for face in np.split(patches.vertices(faces), 2))
        longest = np.maximum(*(longest_edges(corners) for corners in sides))
        cuts: Integers = np.ceil(longest / self._size).astype(int)
        return cuts

    def is_clear(self, start: Floats, end: Floats) -> bool:
        """Return True if nothing comes near on the straight way between places: a quick look.

        Where nothing does by far it is not looked again until something may have moved as far.
        """
        if self._clear is not None:
            seen, room = self._clear
            if 2 * max(_farthest(start, seen), _farthest(end, seen)) < room:
                return True
        room = AHEAD * _farthest(start, end)
        for more in (room, 0.0) if room < MOST_AHEAD * self.distance else (0.0,):
            reach = self.distance + more
            _, pairs = self._search.near([start, end], reach, self.distance / 2, MANY)
            if len(pairs) == 0:
                self._clear = end.copy(), more
                return True
        return False

    def _points(self, parts: Parts) -> _Points:
        """Return the points that stand for parts."""
        basis, sites = self._search.interpolation(parts)
        side, patch = np.divmod(parts.patch, self._search.patches.count)
        rest = np.einsum("qj,qji->qi", basis, self._reference[sites])
        n_sites = len(self._reference)
        where = ((sites + side[:, None] * n_sites).ravel(), 10 * np.arange(len(side) + 1))
        matrix = sparse.csr_array((basis.ravel(), *where), shape=(len(side), 2 * n_sites))
        cell = parts.patch // len(self._search.corners)
        return _Points(matrix, cell, rest, self._area[patch] / parts.n**2)

    def _listed(self, faces: Floats) -> _Near:
        """Return the list of near points, made afresh where it does not hold."""
        if self._near is not None:
            moved = _farthest(faces, self._near.faces)
            if moved > ROOM / BULGE * self.distance:
                self._near = None
        if self._near is None:
            self._near = self._list(faces)
        return self._near

    def _touch(self, faces: Floats) -> _Touching:
        """Return the pairs nearer than d_hat."""
        if self._touching is None or self._touching[0] is not faces:
            near = self._listed(faces)
            x = near.points.map @ faces.reshape(-1, 3) / self.distance
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
        return _difference(pulls, touching.pairs, len(self._listed(faces).points.cell))

    def gradient(self, faces: Floats) -> Floats | None:
        """Return dE_s/dx of the faces at the sites, shape (2, n_sites, 3), None without touch."""
        if len(self._touch(faces).square) == 0:
            return None
        value: Floats = (self._listed(faces).points.map.T @ self._pushes(faces)).reshape(2, -1, 3)
        return value

    def hessian(self, faces: Floats, convex: bool = False) -> sparse.csr_array | None:
        """Return d2E_s/dx2, shape (6 n_sites, 6 n_sites), None without touch.

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
        stiffness = np.stack(
            [along * direction[:, a] * direction[:, b] + (a == b) * across for a, b in SYMMETRIC],
            axis=1,
        )
        return self._between_cells(near.points, touching.pairs, stiffness)

    def _between_cells(
        self, points: _Points, pairs: Integers, stiffness: Floats
    ) -> sparse.csr_array:
        """Return the matrix of the sum of (x_i - x_j) . s (x_i - x_j) over pairs of points.

        Args:
            points: The points x.
            pairs: Pairs (i, j), shape (n, 2).
            stiffness: Components ``SYMMETRIC`` of s, shape (n, 6).

        Returns:
            In the faces at the sites, shape (6 n_sites, 6 n_sites).
        """
        touched, inverse = np.unique(pairs, return_inverse=True)
        i, j = inverse.reshape(-1, 2).T
        n, cell = len(touched), points.cell[touched]
        basis = points.map.data.reshape(-1, 10)[touched]
        # what points do to themselves, and to one another: cells in which they are, and values
        own = np.stack([np.bincount(i, s, n) + np.bincount(j, s, n) for s in stiffness.T], axis=1)
        every = np.arange(n)
        itself = _blocks(every, every, own, basis, cell)
        other = _blocks(i, j, -stiffness, basis, cell)
        turned = (other[1], other[0], np.swapaxes(other[2], 1, 3))
        data, row, column = [], [], []
        for first, second, blocks in (itself, other, turned):
            whole = blocks[:, :, SYMMETRIC_OF]  # (n, 10, 3, 3, 10)
            rows, columns = (
                3 * self._sites_of(one)[..., None] + np.arange(3) for one in (first, second)
            )
            shape = whole.shape
            row.append(np.broadcast_to(rows[:, :, :, None, None], shape).ravel())
            column.append(np.broadcast_to(np.swapaxes(columns, 1, 2)[:, None, None], shape).ravel())
            data.append(whole.ravel())
        size = 6 * len(self._reference)
        where = (np.concatenate(row), np.concatenate(column))
        return sparse.csr_array((np.concatenate(data), where), shape=(size, size))

    def _sites_of(self, cell: Integers) -> Integers:
        """Return the sites of cells, both counted over both faces, shape (n, 10)."""
        side, number = np.divmod(cell, len(self._search.cells))
        sites: Integers = self._search.cells[number] + side[:, None] * len(self._reference)
        return sites


def _farthest(one: Floats, other: Floats) -> float:
    """Return by how much places differ at most."""
    return float(np.linalg.norm(one - other, axis=-1).max())


def _difference(values: Floats, pairs: Integers, n: int) -> Floats:
    """Return the sum of values (n_pairs, 3) at first points less that at second ones, (n, 3)."""
    first, second = pairs.T
    parts = [np.bincount(first, v, n) - np.bincount(second, v, n) for v in values.T]
    return np.stack(parts, axis=1)


def _blocks(
    i: Integers, j: Integers, values: Floats, basis: Floats, cell: Integers
) -> tuple[Integers, Integers, Floats]:
    """Return sums over pairs of points (i, j) of basis_i x values x basis_j, by pairs of cells.

    Args:
        i: First point of each pair, shape (n_pairs,).
        j: Second point of each.
        values: Shape (n_pairs, k).
        basis: Basis of each point's cell there, shape (n_points, 10).
        cell: The cell of each point, shape (n_points,).

    Returns:
        First cells, second cells, and the sums, shape (n, 10, k, 10).
    """
    # by cells and first point: first sums over second points, then over first ones
    order = np.lexsort((i, cell[j], cell[i]))
    i, j, values = i[order], j[order], values[order]
    first, second = cell[i], cell[j]
    new = np.ones(len(i), dtype=bool)
    new[1:] = (first[1:] != first[:-1]) | (second[1:] != second[:-1])
    newer = new.copy()
    newer[1:] |= i[1:] != i[:-1]
    starts, coarse = np.flatnonzero(newer), np.flatnonzero(new[newer])
    ends, shape = np.append(starts, len(i)), (len(starts), len(basis))
    along = np.stack(
        [sparse.csr_array((v, j, ends), shape=shape) @ basis for v in values.T], axis=1
    ).reshape(len(starts), -1)
    ends, shape = np.append(coarse, len(starts)), (len(coarse), len(starts))
    every = np.arange(len(starts))
    sums = np.stack(
        [sparse.csr_array((b, every, ends), shape=shape) @ along for b in basis[i[starts]].T],
        axis=1,
    )
    pair = starts[coarse]
    return first[pair], second[pair], sums.reshape(len(pair), 10, values.shape[1], 10)
