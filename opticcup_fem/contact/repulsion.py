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

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from opticcup_fem.contact.blocks import SIDE, Blocks
from opticcup_fem.contact.law import repulsion, rise
from opticcup_fem.contact.pairs import (
    BULGE,
    distances,
    farthest,
    near_curved,
    near_points,
    stiffness,
    within,
)
from opticcup_fem.contact.patches import Patches
from opticcup_fem.contact.surface import ContactSurface, longest_edges
from opticcup_fem.snapshot import (
    Floats,
    Integers,
    lagrange_basis,
    lagrange_gradient,
    lattice,
    midpoints,
)

SPACING = 1.0
"""Size of the triangles that points stand for, over d_hat."""

NARROW = 0.3
"""Gap, over d_hat, below which they stand for triangles ``FINE`` d_hat large."""

FINE = 0.4
"""Size of the triangles that points of narrow gaps stand for, over d_hat."""

ROOM = 0.1
"""How far points may move, over d_hat, before those that are near are looked for again."""

REACH = 1 + 2 * ROOM
"""Distance, over d_hat, up to which points are listed as near."""

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

    def of(self, some: NDArray[np.bool_]) -> _Points:
        """Return some of them."""
        return _Points(self.map[some], self.cell[some], self.rest[some], self.area[some])


class _Near(NamedTuple):
    """Points that are near each other, and their pairs.

    Attributes:
        faces: Faces for which it was made.
        points: Points that have others near.
        pairs: Points of each pair, those of the same two cells one after the other, shape
            (n_pairs, 2).
        weights: c times the areas of both points, shape (n_pairs,).
    """

    faces: Floats
    points: _Points
    pairs: Integers
    weights: Floats


class _Touching(NamedTuple):
    """Pairs nearer than d_hat at some places of the faces.

    Attributes:
        pairs: Their points, those of the same two cells one after the other, shape (n, 2).
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
        patches: The patches on which points are laid out.
    """

    def __init__(
        self,
        reference: Floats,
        cells: Integers,
        surface: ContactSurface,
        patches: Patches,
        thickness: float,
        distance: float,
        stiffness: float,
    ) -> None:
        """Take what the reference position tells; points are laid out when they are needed.

        Args:
            reference: Reference positions of the sites, shape (n_sites, 3).
            cells: Sites of the cubic cells, shape (m, 10).
            surface: Surface of these cells.
            patches: Its patches.
            thickness: Thickness of the shell.
            distance: d_hat.
            stiffness: k.
        """
        self.distance, self.stiffness = distance, stiffness
        self._reference, self._cells = reference, cells
        self._exempt, self._ramp = surface.exempt, RAMP * thickness
        self.patches, self._map = patches, surface.map
        self._parts = surface.parts
        slopes = lagrange_gradient(_corners(self._parts).mean(axis=1))
        base = np.einsum("tja,cji->ctai", slopes, reference[cells]).reshape(-1, 2, 3)
        area = np.linalg.norm(np.cross(base[:, 0], base[:, 1]), axis=1)
        self._area = area / (2 * self._parts**2)
        self._size = SPACING * distance
        self._levels: Integers | None = None
        self._near: _Near | None = None
        self._touching: tuple[Floats, _Touching] | None = None

    def forget(self, gap: float = np.inf) -> None:
        """Lay the points out anew at the next places: what begins here repeats.

        Args:
            gap: Gap that is to be resolved.
        """
        self._size = (SPACING if gap > NARROW * self.distance else FINE) * self.distance
        self._levels = self._near = self._touching = None
        self.patches.forget()

    # --- which points are near ----------------------------------------------------------------

    def _list(self, faces: Floats) -> _Near:
        """Return the points that are near each other at places of the faces."""
        patches, reach = self.patches, REACH * self.distance
        vertices = np.concatenate([self._map @ face for face in faces])
        balls = patches.balls(vertices)
        near = patches.near(vertices, reach=reach)
        near = near_curved(near, patches.triangles, balls, vertices, reach)
        if self._levels is None and len(near):
            self._levels = self._cuts(vertices)
        points, first = self._points(near)
        x = points.map @ faces.reshape(-1, 3)
        pairs = near_points(near, first, x, points.rest, balls, reach, self._exempt)
        used = np.zeros(len(points.cell), dtype=bool)
        used[pairs] = True
        points, pairs = points.of(used), (np.cumsum(used) - 1)[pairs]
        beyond = (distances(points.rest, pairs) - self._exempt) / self._ramp
        weights = (
            rise(np.asarray(beyond, dtype=np.float64))
            * points.area[pairs[:, 0]]
            * points.area[pairs[:, 1]]
        )
        return _Near(faces.copy(), points, pairs, weights)

    def _cuts(self, vertices: Floats) -> Integers:
        """Return into how many parts the edges of patches are cut for points, shape (count,)."""
        longest = longest_edges(vertices[self.patches.triangles]).reshape(2, -1).max(axis=0)
        cuts: Integers = np.ceil(longest / self._size).astype(int)
        return cuts

    def _points(self, pairs: Integers) -> tuple[_Points, Integers]:
        """Return the points of all patches in pairs.

        Returns:
            The points, and the number of the first one of each patch, shape (2 count + 1,).
        """
        count, n_sites = self.patches.count, len(self._reference)
        wanted = np.zeros(2 * count, dtype=bool)
        wanted[pairs] = True
        levels = np.zeros(count, dtype=int) if self._levels is None else self._levels
        level = np.tile(levels, 2) * wanted
        first = np.concatenate([[0], np.cumsum(level**2)])
        patch = np.repeat(np.arange(2 * count), level**2)
        number, n = np.arange(len(patch)) - first[patch], level[patch]
        side, of_face = np.divmod(patch, count)
        cell, kind = np.divmod(of_face, self._parts**2)
        basis = np.empty((len(patch), 10))
        for k in np.unique(n):
            some = n == k
            table = _basis(self._parts, int(k))
            basis[some] = table[kind[some], number[some]]
        sites = self._cells[cell]
        both = (sites + side[:, None] * n_sites).ravel()
        ends = 10 * np.arange(len(patch) + 1)
        matrix = sparse.csr_array((basis.ravel(), both, ends), shape=(len(patch), 2 * n_sites))
        rest = matrix @ np.tile(self._reference, (2, 1))
        cell += side * len(self._cells)
        return _Points(matrix, cell, rest, self._area[of_face] / n**2), first

    def _listed(self, faces: Floats) -> _Near:
        """Return the list of near points, made afresh where it does not hold."""
        if self._near is not None:
            moved = farthest(faces, self._near.faces)
            if moved > ROOM / BULGE * self.distance:
                self._near = None
        if self._near is None:
            self._near = self._list(faces)
        return self._near

    def _touch(self, faces: Floats) -> _Touching:
        """Return the pairs nearer than d_hat."""
        if self._touching is None or self._touching[0] is not faces:
            near = self._listed(faces)
            x = near.points.map @ (faces.reshape(-1, 3) / self.distance)
            which, apart = within(near.pairs, x, 1.0)
            square = np.einsum("pi,pi->p", apart, apart)
            touching = _Touching(near.pairs[which], apart, square, near.weights[which])
            self._touching = faces, touching
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

    def hessian(self, faces: Floats, convex: bool = False) -> Blocks | None:
        """Return d2E_s/dx2 between cells, counted over both faces; None without touch.

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
        values = np.stack(
            [along * direction[:, a] * direction[:, b] + (a == b) * across for a, b in SYMMETRIC],
            axis=1,
        )
        return _between_cells(near.points, touching.pairs, values)


@cache
def _corners(parts: int) -> Floats:
    """Return the corners of the patches of a cell in it, shape (parts^2, 3, 2)."""
    points, triangles = lattice(parts)
    corners: Floats = points[triangles] / parts
    return corners


@cache
def _basis(parts: int, n: int) -> Floats:
    """Return the basis of a cell at the points of its patches, shape (parts^2, n^2, 10).

    Args:
        parts: Parts of a cell's edge.
        n: Parts of a patch's edge.
    """
    middle, corners = midpoints(n), _corners(parts)
    weights = np.column_stack([1 - middle.sum(axis=1), middle])
    inside = np.einsum("qk,tka->tqa", weights, corners)
    return lagrange_basis(inside.reshape(-1, 2)).reshape(len(corners), -1, 10)


def _difference(values: Floats, pairs: Integers, n: int) -> Floats:
    """Return the sum of values (n_pairs, 3) at first points less that at second ones, (n, 3)."""
    first, second = pairs.T
    parts = [np.bincount(first, v, n) - np.bincount(second, v, n) for v in values.T]
    return np.stack(parts, axis=1)


def _between_cells(points: _Points, pairs: Integers, values: Floats) -> Blocks:
    """Return the matrix of the sum of (x_i - x_j) . s (x_i - x_j) over pairs of points.

    Args:
        points: The points x.
        pairs: Pairs (i, j), those of the same two cells one after the other, shape (n, 2).
        values: Components ``SYMMETRIC`` of s, shape (n, 6).
    """
    between = points.cell[pairs]
    new = np.ones(len(pairs), dtype=bool)
    new[1:] = np.any(between[1:] != between[:-1], axis=1)
    of_pair = np.cumsum(new) - 1
    touched = np.zeros(len(points.cell), dtype=bool)
    touched[pairs] = True
    cells, number = np.unique(points.cell[touched], return_inverse=True)
    of_point = np.full(len(points.cell), -1, dtype=np.int64)
    of_point[touched] = new.sum() + number
    first, second = (np.concatenate([c, cells]) for c in between[new].T)
    basis = points.map.data.reshape(-1, 10)
    blocks = stiffness(pairs, values, of_pair, basis, of_point, len(first))
    # (n, 10, 3, 3, 10) with the two components of s apart
    whole = np.swapaxes(blocks[:, :, SYMMETRIC_OF], 3, 4).reshape(-1, SIDE, SIDE)
    # within a cell what points do to each other is to be given with its transposed
    within_cell = (first == second) & (np.arange(len(first)) < new.sum())
    whole[within_cell] += np.swapaxes(whole[within_cell], 1, 2)
    return Blocks(first, second, whole)
