"""Parts of the patches of a shell's faces: which of them may come near each other.

Patches of the cubic faces (``patches``) are cut into equal parts, as small as needed, but only
where others are near.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from opticcup_fem.contact.patches import PARTS, Patches, distances, nearest
from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.snapshot import Floats, Integers, lagrange_basis, lattice, midpoints

SKEWED = np.array([[1.0, 0.0], [0.5, np.sqrt(0.75)]])
"""From coordinates in a triangle to an equilateral one, where the nearest midpoint is that of the
part that a point is in."""


class Parts(NamedTuple):
    """Some of the n^2 equal parts of patches, which stand for their midpoints; shape (k,) each.

    Attributes:
        patch: Patch of each, counted over both faces.
        n: Parts of the patch's edge.
        number: Which of its n^2 parts, in the order of ``midpoints``.
    """

    patch: Integers
    n: Integers
    number: Integers

    def of(self, some: Integers) -> Parts:
        """Return some of them."""
        return Parts(*(values[some] for values in self))


class NearParts:
    """Search for parts of a shell's faces that may come near each other; serial.

    Places of faces have shape (2, n_sites, 3), the inner one first.

    Attributes:
        patches: The patches of which they are parts.
        cells: Sites of the cubic cells, shape (m, 10).
        corners: Corners of the patches of a cell in it, shape (n, 3, 2).
    """

    def __init__(self, reference: Floats, cells: Integers, surface: ContactSurface) -> None:
        """Cut the cells into patches.

        Args:
            reference: Reference positions of the sites, shape (n_sites, 3).
            cells: Sites of the cubic cells, shape (m, 10).
            surface: Surface of these cells.
        """
        self._reference, self._exempt, self.cells = reference, surface.exempt, cells
        points, triangles = lattice(PARTS)
        self.corners: Floats = points[triangles] / PARTS
        self.patches = Patches(reference, surface)

    def near(
        self, places: Sequence[Floats], reach: float, size: float, most: float = np.inf
    ) -> tuple[Parts, Integers]:
        """Return parts of patches that may come near each other, and their pairs.

        Pairs of patches that are near each other are cut into pairs of their quarters, again and
        again, until these are small enough.

        Args:
            places: Places of the faces, one or the ends of a way.
            reach: What is near.
            size: Radius that is small enough.
            most: Number of pairs that are cut no further.
        """
        count, vertices = self.patches.count, [self.patches.vertices(faces) for faces in places]
        some, numbers = np.unique(self.patches.near(*vertices, reach=reach), return_inverse=True)
        parts = Parts(some, np.ones_like(some), np.zeros_like(some))
        pairs: Integers = numbers.reshape(-1, 2)
        radius = self.patches.radius(*vertices)
        while len(pairs) < most:
            cut = radius[parts.patch] > size * parts.n
            if not cut.any():
                break
            parts, pairs = _quartered(parts, pairs, cut)
            x, rest = self._midpoints(parts, places)
            large = radius[parts.patch] / parts.n
            extent = self.patches.extent[parts.patch % count] / parts.n
            apart = nearest(x, pairs) - large[pairs].sum(axis=1)
            far = distances(rest, pairs) + extent[pairs].sum(axis=1)
            some, numbers = np.unique(
                pairs[(far > self._exempt) & (apart < reach)], return_inverse=True
            )
            parts, pairs = parts.of(some), numbers.reshape(-1, 2)
        return parts, pairs

    def interpolation(self, parts: Parts) -> tuple[Floats, Integers]:
        """Return the basis at midpoints of parts and its sites, both of shape (k, 10)."""
        cell, kind = np.divmod(parts.patch % self.patches.count, len(self.corners))
        basis = np.empty((len(cell), 10))
        for n in np.unique(parts.n):
            middle = midpoints(int(n))
            weights = np.column_stack([1 - middle.sum(axis=1), middle])
            inside = np.einsum("qk,tka->tqa", weights, self.corners).reshape(-1, 2)
            table = lagrange_basis(inside).reshape(len(self.corners), len(middle), 10)
            some = parts.n == n
            basis[some] = table[kind[some], parts.number[some]]
        return basis, self.cells[cell]

    def _midpoints(self, parts: Parts, places: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Return where the midpoints of parts are.

        Returns:
            At the places, shape (n_places, k, 3), and in the reference position, shape (k, 3).
        """
        basis, sites = self.interpolation(parts)
        side = parts.patch[:, None] // self.patches.count
        x = [np.einsum("qj,qji->qi", basis, faces[side, sites]) for faces in places]
        return np.stack(x), np.einsum("qj,qji->qi", basis, self._reference[sites])


def _parents(n: int, parts: int) -> Integers:
    """Return for each of n^2 equal parts of a triangle in which of parts^2 its midpoint is."""
    _, nearest = cKDTree(midpoints(parts) @ SKEWED).query(midpoints(n) @ SKEWED)
    parents: Integers = nearest
    return parents


def cut_to(level: Integers, parts: Parts) -> Parts:
    """Return the parts of patches whose edges have ``level`` parts that lie in given ones."""
    found = [Parts(*np.empty((3, 0), dtype=np.int64))]
    for k, n in np.unique(np.column_stack([level, parts.n]), axis=0):
        some = np.flatnonzero((level == k) & (parts.n == n))
        inside = _parents(int(k), int(n)) == parts.number[some, None]
        place, number = np.nonzero(inside)
        found.append(Parts(parts.patch[some][place], np.full_like(number, k), number))
    return Parts(*(np.concatenate(values) for values in zip(*found, strict=True)))


def _quartered(parts: Parts, pairs: Integers, cut: NDArray[np.bool_]) -> tuple[Parts, Integers]:
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
    finer = Parts(parts.patch[whole], parts.n[whole] * (1 + cut[whole]), number)
    ways = count[pairs]
    pair = np.repeat(np.arange(len(pairs)), ways.prod(axis=1))
    start = np.cumsum(ways.prod(axis=1)) - ways.prod(axis=1)
    one, other = np.divmod(np.arange(len(pair)) - start[pair], ways[pair, 1])
    return finer, first[pairs[pair]] + np.column_stack([one, other])
