r"""Where the faces of a shell are, and how they follow its mid-surface.

At a node of a cell a face lies at

    x_k = r + z_k n,      n = N/|N|,      N = r_,1 x r_,2 in this cell,

z_k the height of the inner (k = 0) or outer (k = 1) face, h lambda_3 of the layers in between.
Every cell has faces of its own: where two of them meet at a kink, so do their faces.
Normals follow r exactly, so that forces on the faces and their stiffness have no lever left out;
heights are data, brought up to date between solves (``contact.model``).

Places at which the faces are given, each node once in each of its cells, are *sites*: number
10 c + j is node j of cell c.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from opticcup_fem.contact.blocks import Blocks
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.recovery import layer_heights
from opticcup_fem.snapshot import Floats, Integers


def face_heights(shell: Shell, state: ShellState) -> Floats:
    """Return the heights of the faces of a state's layers over the mid-surface.

    Returns:
        Inner and outer face at the nodes of the rank's cells, shape (n_cells, 10, 2).
    """
    heights = np.empty((*shell.spaces.nodes.shape, 2))
    for region, faces in layer_heights(shell, state).items():
        heights[shell.region_cells(region)] = faces[..., [0, -1]]
    return heights


class ShellFaces:
    """Places of both faces at all sites, and their first and second variation; serial.

    Faces are arrays of shape (2, n_sites, 3), the inner one first.

    Attributes:
        cells: Nodes of the cells, shape (m, 10).
        n_nodes: Number of nodes.
    """

    def __init__(self, cells: Integers, gradient: Floats, n_nodes: int) -> None:
        """Take the geometry of the cells.

        Args:
            cells: Nodes of the cells, shape (m, 10).
            gradient: Map from the nodes of a cell to r_,1 and r_,2 at its nodes, in coordinates
                in which r_,1 x r_,2 points outside, shape (m, 10, 10, 2).
            n_nodes: Number of nodes.
        """
        self.cells, self.n_nodes = cells, n_nodes
        self._gradient = gradient

    def places(self, r: Floats, heights: Floats) -> Floats:
        """Return the faces, shape (2, n_sites, 3).

        Args:
            r: Positions of the nodes, shape (n_nodes, 3).
            heights: Heights of inner and outer face, shape (m, 10, 2).
        """
        base = _base(self._gradient, r[self.cells])
        normal = np.cross(base[..., 0, :], base[..., 1, :])
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        faces = r[self.cells] + np.moveaxis(heights, -1, 0)[..., None] * normal
        return faces.reshape(2, -1, 3)

    def at(self, r: Floats, heights: Floats, some: Integers) -> FaceVariations:
        """Return the variations of the faces of some cells; the other faces count as held.

        Args:
            r: Positions of the nodes, shape (n_nodes, 3).
            heights: Heights of inner and outer face, shape (m, 10, 2).
            some: Cells whose faces matter, shape (k,).
        """
        gradient = self._gradient[some]
        base = _base(gradient, r[self.cells[some]])
        return FaceVariations(self, some, gradient, base, heights[some])

    def at_nodes(self, values: Floats) -> Floats:
        """Return sums of vectors at the sites (..., n_sites, 3) at the nodes (..., n_nodes, 3)."""
        by_site = np.moveaxis(values, -2, 0)
        sums = np.zeros((self.n_nodes, *by_site.shape[1:]))
        np.add.at(sums, self.cells.ravel(), by_site)
        return np.moveaxis(sums, 0, -2)


class FaceVariations:
    """First and second variation of the faces in the positions of the nodes, at one state."""

    def __init__(
        self, faces: ShellFaces, some: Integers, gradient: Floats, base: Floats, heights: Floats
    ) -> None:
        """See ``ShellFaces.at``.

        Args:
            faces: The faces.
            some: Cells whose faces matter, shape (k,).
            gradient: Map from their nodes to (r_,1, r_,2) there, shape (k, 10, 10, 2).
            base: (r_,1, r_,2) there, shape (k, 10, 2, 3).
            heights: Heights of both faces there, shape (k, 10, 2).
        """
        self._n_cells, self._n_nodes = len(faces.cells), faces.n_nodes
        self._some, self._nodes = some, faces.cells[some]
        self._gradient, self._heights = gradient, heights
        summed = np.cross(base[:, :, 0], base[:, :, 1])
        self._length = np.linalg.norm(summed, axis=-1)
        self._normal = summed / self._length[..., None]
        # d(r_,1 x r_,2) = -r_,2 x dr_,1 + r_,1 x dr_,2
        one, two = (_cross_matrix(base[:, :, a])[:, :, :, None, :] for a in (0, 1))
        first, second = (gradient[:, :, None, :, a, None] for a in (0, 1))
        turned = second * one - first * two
        self._summed_variation = turned.reshape(*turned.shape[:3], -1)  # dN/dr, (k, 10, 3, 30)

    @cached_property
    def _first(self) -> Floats:
        """d(inner, outer faces)/dr at the sites of each cell in its nodes, (2, k, 30, 30)."""
        n, length = self._normal, self._length[..., None, None]
        across = (np.eye(3) - n[..., :, None] * n[..., None, :]) / length
        turned = across @ self._summed_variation  # dn/dr = (1 - n n^T) dN/dr / |N|
        own = np.eye(30).reshape(10, 3, 30)
        rows = [own + self._heights[:, :, k, None, None] * turned for k in (0, 1)]
        return np.stack(rows).reshape(2, -1, 30, 30)

    def pulled_back_forces(self, forces: Floats) -> Floats:
        """Return forces on the faces at the sites (2, n_sites, 3) as ones at the nodes."""
        pushed = forces.reshape(2, -1, 30)[:, self._some]
        at_cells = np.einsum("kcsp,kcs->cp", self._first, pushed).reshape(-1, 3)
        nodes = self._nodes.ravel()
        sums = [np.bincount(nodes, component, self._n_nodes) for component in at_cells.T]
        return np.stack(sums, axis=1)

    def pulled_back(self, stiffness: Blocks) -> Blocks:
        """Return stiffness between the faces' cells as one between cells of the mid-surface.

        Args:
            stiffness: In the places of the faces at the cells' sites; cells are among those asked
                for, and counted over both faces.
        """
        place = np.zeros(self._n_cells, dtype=np.int64)
        place[self._some] = np.arange(len(self._some))
        sides, cells = zip(
            *(np.divmod(one, self._n_cells) for one in (stiffness.first, stiffness.second)),
            strict=True,
        )
        first, second = (self._first[side, place[c]] for side, c in zip(sides, cells, strict=True))
        values = np.swapaxes(first, 1, 2) @ stiffness.values @ second
        # a block that stands for its transposed as well, between faces of one cell, is that of
        # this cell with itself now
        both = (cells[0] == cells[1]) & (sides[0] != sides[1])
        values[both] += np.swapaxes(values[both], 1, 2)
        return Blocks(cells[0], cells[1], values)

    def second(self, forces: Floats) -> Blocks:
        """Return the second variation of forces . faces in r.

        Args:
            forces: Held forces on the faces, shape (2, n_sites, 3), nought but in the cells asked
                for.
        """
        pushed = forces.reshape(2, -1, 10, 3)[:, self._some]
        turning = np.einsum("csk,kcsi->csi", self._heights, pushed)
        n, length = self._normal, self._length[..., None]
        along = np.sum(turning * n, axis=-1, keepdims=True)
        aside = turning - along * n
        # of turning . N/|N| in N
        mixed = aside[..., :, None] * n[..., None, :]
        plane = along[..., None] * (np.eye(3) - n[..., :, None] * n[..., None, :])
        bend = -(mixed + np.swapaxes(mixed, -1, -2) + plane) / length[..., None] ** 2
        by_sum = self._summed_variation
        bent = (bend @ by_sum).reshape(-1, 30, 30)
        blocks = np.swapaxes(by_sum.reshape(-1, 30, 30), -1, -2) @ bent
        # N is bilinear in r
        slope = -_cross_matrix(aside / length)
        first, second = self._gradient[..., 0], self._gradient[..., 1]
        weights = first[..., :, None] * second[..., None, :]
        weights = weights - np.swapaxes(weights, -1, -2)
        blocks += np.einsum("cspq,csij->cpiqj", weights, slope, optimize=True).reshape(-1, 30, 30)
        return Blocks(self._some, self._some, blocks)


def _base(gradient: Floats, r: Floats) -> Floats:
    """Return (r_,1, r_,2) at the nodes of cells, shape (k, 10, 2, 3), r (k, 10, 3) there."""
    base: Floats = np.einsum("cspa,cpi->csai", gradient, r, optimize=True)
    return base


def _cross_matrix(vectors: Floats) -> Floats:
    """Return the matrices of v x, shape (..., 3, 3)."""
    matrix = np.zeros((*vectors.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[..., i, k] = vectors[..., j]
        matrix[..., k, i] = -vectors[..., j]
    return matrix
