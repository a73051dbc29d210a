r"""Mirror planes as walls: what keeps a part of a shell from its own mirror image.

Where the deformation keeps the plane x_i = 0 as a mirror, two images that come near are on either
side of it, d away each.  For one part of the shell, that in x_i >= 0, they are therefore a wall.
Its potential is an integral over the cubic faces, by the midpoint rule,

    E_w = sum_q w_q k/2 d_hat b(2 d_q/d_hat),      b of ``contact.law``,

half of the barrier between faces that are 2 d apart (``contact.barrier``), for the other half is
the image's.  w_q is the reference area at a point, less near the plane: what lies nearer to it
than half a thickness and d_hat in the reference position bends across it and never touches, and
from half a thickness farther on all of it does.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse

from opticcup_fem.contact.law import barrier, rise
from opticcup_fem.contact.surface import longest_edges
from opticcup_fem.snapshot import Floats, Integers, lagrange_basis, lagrange_gradient, midpoints

SPACING = 0.25
"""Largest distance of neighbouring points in the reference position, over the thickness."""

MARGIN = 0.5
"""Distance from a mirror in the reference position, over the thickness and beside d_hat, within
which nothing touches it, and over which the weight of what lies farther grows to all of it."""


class Walls:
    """Walls of one part of a shell; serial.

    Attributes:
        distance: d_hat, twice the distance from a plane at which it begins to push.
        stiffness: k [stress].
    """

    def __init__(
        self,
        reference: Floats,
        cells: Integers,
        planes: Sequence[int],
        thickness: float,
        distance: float,
        stiffness: float,
    ) -> None:
        """Spread the points.

        Args:
            reference: Reference positions of the sites, shape (n_sites, 3).
            cells: Sites of the cubic cells of the part, shape (m, 10).
            planes: Components i that are nought on a mirror; the part is where all are positive.
            thickness: Thickness of the shell.
            distance: d_hat.
            stiffness: k.
        """
        self.distance, self.stiffness = distance, stiffness
        self._planes, self._n_sites = list(planes), len(reference)
        maps, areas = zip(*_points(reference, cells, SPACING * thickness), strict=True)
        self._map = sparse.csr_array(sparse.vstack(maps, format="csr"))
        far = (self._map @ reference)[:, self._planes]
        share = rise((far - distance) / (MARGIN * thickness) - 1.0)
        self._weights: Floats = np.concatenate(areas)[:, None] * share

    def distances(self, faces: Floats) -> Floats:
        """Return the distances of the points from the planes, shape (2, n_points, n_planes).

        Args:
            faces: Both faces at the sites, shape (2, n_sites, 3).

        Returns:
            inf for points that do not touch a plane.
        """
        found = np.stack([self._map @ face[:, self._planes] for face in faces])
        return np.where(self._weights > 0, found, np.inf)

    def energy(self, distances: Floats) -> float:
        """Return E_w, inf where a plane is passed."""
        if np.any(distances <= 0):
            return np.inf
        _, x, weights = self._near(distances)
        return float(np.sum(weights * barrier(x)[0])) * self.stiffness / 2 * self.distance

    def gradient(self, distances: Floats) -> Floats | None:
        """Return dE_w/dx of the faces at the sites, shape (2, n_sites, 3), None without touch."""
        near, x, weights = self._near(distances)
        if len(x) == 0:
            return None
        slope = np.zeros(distances.shape)
        slope[near] = self.stiffness * weights * barrier(x)[1]
        value = np.zeros((2, self._n_sites, 3))
        for face in (0, 1):
            value[face][:, self._planes] = self._map.T @ slope[face]
        return value

    def hessian(self, distances: Floats) -> sparse.csr_array | None:
        """Return d2E_w/dx2, shape (6 n_sites, 6 n_sites), None without touch.

        b is convex, and distances are linear in the faces: no eigenvalue is negative.
        """
        near, x, weights = self._near(distances)
        if len(x) == 0:
            return None
        bend = np.zeros(distances.shape)
        bend[near] = 2 * self.stiffness / self.distance * weights * barrier(x)[2]
        n = self._n_sites
        value = sparse.csr_array((6 * n, 6 * n))
        for face in (0, 1):
            for k, i in enumerate(self._planes):
                touched = np.flatnonzero(bend[face, :, k])
                rows = self._map[touched]
                block = sparse.coo_array(rows.T @ sparse.diags_array(bend[face, touched, k]) @ rows)
                where = tuple(3 * (face * n + index) + i for index in (block.row, block.col))
                value = value + sparse.csr_array((block.data, where), shape=value.shape)
        return value

    def _near(self, distances: Floats) -> tuple[tuple[Integers, ...], Floats, Floats]:
        """Return which distances a wall reaches, these over its reach, and their weights."""
        near: tuple[Integers, ...] = np.nonzero(2 * distances < self.distance)
        x: Floats = np.asarray(2 * distances[near] / self.distance, dtype=np.float64)
        return near, x, self._weights[near[1:]]

    def gap(self, distances: Floats) -> float:
        """Return the least gap between images, inf where it exceeds d_hat."""
        least = 2 * float(distances.min(initial=np.inf))
        return least if least < self.distance else np.inf

    def free_fraction(self, start: Floats, end: Floats, apart: float = 0.0) -> float:
        """Return the share of the straight way on which images stay apart, 0 to 1.

        Args:
            start: Distances at its start.
            end: Distances at its end.
            apart: Gap to be kept, below that at the start.
        """
        too_near = 2 * end < apart if apart else end <= 0
        first, last = start[too_near], end[too_near]
        return float(np.min((first - apart / 2) / (first - last), initial=1.0))


def _points(
    reference: Floats, cells: Integers, spacing: float
) -> list[tuple[sparse.csr_array, Floats]]:
    """Return, for cells cut alike, the map from nodes to midpoints and the areas around these."""
    parts = np.ceil(longest_edges(reference[cells[:, :3]]) / spacing).astype(int)
    found = []
    for n in np.unique(parts):
        alike = cells[parts == n]
        middle = midpoints(int(n))
        basis, slopes = lagrange_basis(middle), lagrange_gradient(middle)
        base = np.einsum("qja,cji->cqai", slopes, reference[alike])
        area = np.linalg.norm(np.cross(base[:, :, 0], base[:, :, 1]), axis=2) / (2 * n * n)
        m, q = area.shape
        rows = np.repeat(np.arange(m * q), basis.shape[1])
        columns = np.repeat(alike[:, None], q, axis=1).ravel()
        where, shape = (rows, columns), (m * q, len(reference))
        found.append(
            (sparse.csr_array((np.tile(basis, (m, 1, 1)).ravel(), where), shape), area.ravel())
        )
    return found
