"""Material points of the sphere found in the cells of a snapshot's mesh.

A point is named by its direction in the reference state, colatitude theta from +z and azimuth phi;
the sampler finds the cell that holds it and the place in the cell, once for all states on a mesh.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from opticcup_fem.errors import MeshError
from opticcup_fem.snapshot import (
    EDGES,
    Floats,
    Integers,
    Snapshot,
    cell_tangents,
    cell_values,
    colatitudes,
    lagrange_basis,
)

_CHUNK = 256
"""Points located together; bounds the (points, cells) work array."""

_CANDIDATES = 4
"""Cells tried for each point: curved cells may hold points that their flat facet does not."""

_OUTSIDE = 0.02
"""How far outside a cell (barycentric) a point may be; an interface of cubic edges deviates from
the exact circle by far less."""


def directions(theta: ArrayLike, phi: ArrayLike) -> Floats:
    """Return unit vectors at colatitude theta and azimuth phi (rad), shape (..., 3)."""
    theta, phi = np.broadcast_arrays(np.asarray(theta, float), np.asarray(phi, float))
    ring = np.sin(theta)
    return np.stack([ring * np.cos(phi), ring * np.sin(phi), np.cos(theta)], axis=-1)


def azimuths(count: int) -> Floats:
    """Return equally spaced azimuths from 0 up to, not including, 2 pi; shape (count,)."""
    return np.linspace(0.0, 2 * np.pi, count, endpoint=False, dtype=np.float64)


def barycentric(points: Floats) -> Floats:
    """Return the three barycentric coordinates of reference points (..., 2), shape (..., 3)."""
    return np.concatenate([1 - points.sum(axis=-1, keepdims=True), points], axis=-1)


@dataclass(frozen=True)
class Located:
    """Material points: for each its cell, shape (k,), and its place in the cell, shape (k, 2)."""

    cell: Integers
    point: Floats


@dataclass(frozen=True)
class InterfaceEdges:
    """Edges where cells of two regions meet; arrays of shape (k,).

    Attributes:
        cell: The cells of the first and of the second region, shape (k, 2).
        edge: Their local edges (rows of `EDGES`), shape (k, 2).
    """

    cell: Integers
    edge: Integers


class SphereSampler:
    """Finds material points of a sphere's mesh by their reference direction."""

    def __init__(self, snapshot: Snapshot) -> None:
        """Prepare the search.

        Args:
            snapshot: Any state on the mesh; its reference, cells and regions are used.
        """
        self.reference, self.cells, self.region = (
            snapshot.reference,
            snapshot.cells,
            snapshot.region,
        )
        self.region_ids: Mapping[str, int] = snapshot.region_ids
        corners = self.reference[self.cells[:, :3]]
        # rows of the inverse: barycentric coordinates, up to a factor, of a ray through the facet
        self._rays = np.linalg.inv(corners.transpose(0, 2, 1))

    def locate(self, points: ArrayLike, region: str | None = None) -> Located:
        """Find material points.

        Args:
            points: Reference positions or directions, shape (k, 3); only directions matter.
            region: Search the cells of this region only, which decides on which side of the
                interface a point of the interface is taken.

        Returns:
            The cell and the place of each point.

        Raises:
            MeshError: A point lies outside all cells.
        """
        points = np.asarray(points, dtype=float).reshape(-1, 3)
        allowed: Integers = np.arange(len(self.cells))
        if region is not None:
            allowed = np.flatnonzero(self.region == self.region_ids[region])
        cell, place = np.empty(len(points), dtype=np.int64), np.empty((len(points), 2))
        for start in range(0, len(points), _CHUNK):
            part = slice(start, start + _CHUNK)
            cell[part], place[part] = self._locate(points[part], allowed)
        worst = barycentric(place).min(axis=1)
        if worst.min(initial=0.0) < -_OUTSIDE:
            lost = points[np.argmin(worst)]
            where = "the mesh" if region is None else f"region {region}"
            raise MeshError(f"no cell of {where} holds the direction {lost.round(4).tolist()}")
        return Located(cell, place)

    def locate_all(self, point: ArrayLike, region: str | None = None) -> Located:
        """Find one material point in every cell that touches it (several at a vertex)."""
        direction = np.asarray(point, dtype=float).reshape(1, 3)
        ray = self._barycentric_rays(direction, np.arange(len(self.cells)))[0]
        near = np.flatnonzero(ray.min(axis=1) > -0.2)
        if region is not None:
            near = near[self.region[near] == self.region_ids[region]]
        place = self._refine(np.repeat(direction, len(near), axis=0), near)
        inside = barycentric(place).min(axis=1) > -1e-6
        return Located(near[inside], place[inside])

    def matrix(self, located: Located) -> sparse.csr_array:
        """Return the linear map from nodes to located points, shape (k, n_nodes)."""
        k = len(located.cell)
        columns = self.cells[located.cell].ravel()
        values = lagrange_basis(located.point).ravel()
        rows = np.repeat(np.arange(k), 10)
        return sparse.csr_array((values, (rows, columns)), shape=(k, len(self.reference)))

    def _barycentric_rays(self, points: Floats, cells: Integers) -> Floats:
        """Return where rays pierce the cells' facets (barycentric), shape (k, n_cells, 3)."""
        ray = np.einsum("cij,kj->kci", self._rays[cells], points)
        total = ray.sum(axis=2, keepdims=True)
        # facets behind the centre are met by the opposite ray: never candidates
        pierced: Floats = np.where(total > 0, ray / np.where(total > 0, total, 1.0), -np.inf)
        return pierced

    def _locate(self, points: Floats, allowed: Integers) -> tuple[Integers, Floats]:
        inside = self._barycentric_rays(points, allowed).min(axis=2)
        tried = min(_CANDIDATES, len(allowed))
        best = allowed[np.argpartition(-inside, tried - 1, axis=1)[:, :tried]]
        place = self._refine(np.repeat(points, tried, axis=0), best.ravel())
        place = place.reshape(len(points), tried, 2)
        choice = np.argmax(barycentric(place).min(axis=2), axis=1)
        rows = np.arange(len(points))
        return best[rows, choice], place[rows, choice]

    def _refine(self, points: Floats, cells: Integers) -> Floats:
        """Return where the cubic reference surface meets the rays, shape (k, 2), by Newton."""
        ray = np.einsum("kij,kj->ki", self._rays[cells], points)
        flat = ray[:, 1:] / ray.sum(axis=1, keepdims=True)
        place: Floats = np.where(np.isfinite(flat), flat, 1 / 3).clip(-1.0, 2.0)
        across = _perpendicular(points)
        for _ in range(4):
            position = cell_values(self.reference, self.cells[cells], place)
            tangents = cell_tangents(self.reference, self.cells[cells], place)
            residual = np.einsum("kai,ki->ka", across, position)
            jacobian = np.einsum("kai,kdi->kad", across, tangents)
            step: Floats = np.linalg.solve(jacobian, residual[..., None])[..., 0]
            place = place - step.clip(-0.5, 0.5)
        return place


def _perpendicular(points: Floats) -> Floats:
    """Return two unit vectors perpendicular to each point's direction, shape (k, 2, 3)."""
    direction = points / np.linalg.norm(points, axis=1, keepdims=True)
    axis = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    first = np.cross(direction, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=1)


def interface_edges(snapshot: Snapshot, first: str = "cap", second: str = "oov") -> InterfaceEdges:
    """Return the edges on which two regions meet, in no particular order."""
    sides = []
    for region in (first, second):
        cells = snapshot.cells_of(region)
        ends = np.sort(snapshot.cells[cells][:, EDGES[:, :2]], axis=2)
        sides.append((np.repeat(cells, 3), np.tile(np.arange(3), len(cells)), ends.reshape(-1, 2)))
    keys = [ends[:, 0] * len(snapshot.reference) + ends[:, 1] for _, _, ends in sides]
    _, at_first, at_second = np.intersect1d(keys[0], keys[1], return_indices=True)
    cell = np.column_stack([sides[0][0][at_first], sides[1][0][at_second]])
    edge = np.column_stack([sides[0][1][at_first], sides[1][1][at_second]])
    return InterfaceEdges(cell, edge)


def interface_colatitude(snapshot: Snapshot) -> float:
    """Return the reference colatitude alpha of the cap's edge (rad), the mean over its nodes.

    Raises:
        MeshError: Cap and OOV share no edge.
    """
    edges = interface_edges(snapshot)
    if not len(edges.cell):
        raise MeshError("the regions cap and oov share no edge, so there is no interface circle")
    nodes = np.unique(snapshot.cells[edges.cell[:, [0]], EDGES[edges.edge[:, 0]]])
    return float(colatitudes(snapshot.reference[nodes]).mean())


def interface_circle(
    snapshot: Snapshot, count: int = 64, sampler: SphereSampler | None = None
) -> tuple[Floats, Floats]:
    """Return the interface circle's current positions, ordered by reference azimuth.

    Args:
        snapshot: The state.
        count: Number of points, equally spaced in azimuth from phi = 0.
        sampler: A sampler of the same mesh, to save the search's set-up.

    Returns:
        Azimuths phi (rad), shape (count,), and positions, shape (count, 3).
    """
    sampler = sampler or SphereSampler(snapshot)
    phi = azimuths(count)
    located = sampler.locate(directions(interface_colatitude(snapshot), phi), "cap")
    return phi, cell_values(snapshot.position, snapshot.cells[located.cell], located.point)
