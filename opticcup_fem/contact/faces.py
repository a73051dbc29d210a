r"""Where the faces of a shell are, and how they follow its mid-surface.

At a node of the mid-surface a face lies at

    x_k = r + z_k n,      n = N/|N|,      N = sum over the cells at the node of r_,1 x r_,2,

z_k the height of the inner (k = 0) or outer (k = 1) face, h lambda_3 of the layers in between.
Normals follow r exactly, so that forces on the faces and their stiffness have no lever left out;
heights are data, brought up to date between solves (``contact.model``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from opticcup_fem.contact.gather import NodeGather
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.recovery import layer_heights
from opticcup_fem.snapshot import Floats, Integers

Mask = NDArray[np.bool_]


def nodal_means(values: Floats, cells: Integers, n_nodes: int) -> Floats:
    """Return means over the cells at each node.

    Args:
        values: At the nodes of the cells, shape (m, 10, ...).
        cells: Nodes of the cells, shape (m, 10).
        n_nodes: Number of nodes.
    """
    sums = np.zeros((n_nodes, *values.shape[2:]))
    np.add.at(sums, cells, values)
    count = np.bincount(cells.ravel(), minlength=n_nodes)
    means: Floats = sums / count.reshape(-1, *([1] * (sums.ndim - 1)))
    return means


def face_heights(shell: Shell, state: ShellState, gather: NodeGather) -> Floats:
    """Return the heights of the faces of a state's layers over the mid-surface (collective).

    At a node the mean over its cells, which may differ in section.

    Returns:
        Inner and outer face, at all nodes on rank 0, shape (n, 2); elsewhere no node.
    """
    heights = np.empty((shell.spaces.n_cells, shell.spaces.nodes.shape[1], 2))
    for region, faces in layer_heights(shell, state).items():
        heights[shell.region_cells(region)] = faces[..., [0, -1]]
    together = gather.cell_values(heights)
    n_nodes = int(gather.cells.max()) + 1 if len(gather.cells) else 0
    return nodal_means(together, gather.cells, n_nodes)


class ShellFaces:
    """Places of both faces at all nodes, and their first and second variation; serial.

    Faces are arrays of shape (2, n_nodes, 3), the inner one first.
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
        # every node once in each of its cells
        self._cell, self._corner = np.divmod(np.arange(cells.size), cells.shape[1])
        self._node = cells.ravel()

    def places(self, r: Floats, heights: Floats) -> Floats:
        """Return the faces, shape (2, n_nodes, 3).

        Args:
            r: Positions of the nodes, shape (n_nodes, 3).
            heights: Heights of inner and outer face, shape (n_nodes, 2).
        """
        base = self._base(r, np.arange(len(self._node)))
        normal = self._summed(base, self._node)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return r + heights.T[:, :, None] * normal

    def _base(self, r: Floats, sites: Integers) -> Floats:
        """Return (r_,1, r_,2) at some nodes of cells, shape (n, 2, 3)."""
        cell, corner = self._cell[sites], self._corner[sites]
        return np.einsum("spa,spi->sai", self._gradient[cell, corner], r[self.cells[cell]])

    def _summed(self, base: Floats, nodes: Integers) -> Floats:
        """Return N at all nodes, shape (n_nodes, 3), from (r_,1, r_,2) in their cells."""
        values = np.cross(base[:, 0], base[:, 1])
        columns = [np.bincount(nodes, values[:, i], self.n_nodes) for i in range(3)]
        return np.stack(columns, axis=1)

    def at(self, r: Floats, heights: Floats, moved: Integers) -> FaceVariations:
        """Return the variations of the faces at some nodes; the other faces count as held.

        Args:
            r: Positions of the nodes, shape (n_nodes, 3).
            heights: Heights of inner and outer face, shape (n_nodes, 2).
            moved: Nodes whose faces matter.
        """
        wanted = np.zeros(self.n_nodes, dtype=bool)
        wanted[moved] = True
        sites = np.flatnonzero(wanted[self._node])
        base = self._base(r, sites)
        node, cell = self._node[sites], self._cell[sites]
        summed = self._summed(base, node)
        return FaceVariations(
            self.n_nodes,
            node,
            self.cells[cell],
            self._gradient[cell, self._corner[sites]],
            base,
            summed,
            heights,
            wanted,
        )


class FaceVariations:
    """First and second variation of the faces in the positions of the nodes, at one state."""

    def __init__(
        self,
        n_nodes: int,
        node: Integers,
        around: Integers,
        gradient: Floats,
        base: Floats,
        summed: Floats,
        heights: Floats,
        wanted: Mask,
    ) -> None:
        """See ``ShellFaces.at``: one row for every cell at each node.

        Args:
            n_nodes: Number of nodes.
            node: The node of each row, shape (s,).
            around: Nodes of its cell, shape (s, 10).
            gradient: Map from these to (r_,1, r_,2) at the node, shape (s, 10, 2).
            base: (r_,1, r_,2) at the node, shape (s, 2, 3).
            summed: N, shape (n_nodes, 3).
            heights: Heights of both faces, shape (n_nodes, 2).
            wanted: Mask of the nodes that have rows.
        """
        self._n, self._node, self._around = n_nodes, node, around
        self._gradient, self._heights, self._wanted = gradient, heights, wanted
        self._length = np.linalg.norm(summed, axis=1)
        self._length[~wanted] = 1.0
        self._normal = summed / self._length[:, None]
        self._summed_variation = self._variation_of_sum(base)

    def _variation_of_sum(self, base: Floats) -> sparse.csr_array:
        """Return dN/dr, shape (3 n_nodes, 3 n_nodes)."""
        first, second = self._gradient[..., 0], self._gradient[..., 1]
        # d(r_,1 x r_,2) = -r_,2 x dr_,1 + r_,1 x dr_,2
        blocks = (
            second[:, :, None, None] * _cross_matrix(base[:, 0])[:, None]
            - first[:, :, None, None] * _cross_matrix(base[:, 1])[:, None]
        )
        rows = np.broadcast_to(self._node[:, None], self._around.shape)
        return _of_blocks(blocks, rows, self._around, self._n)

    @property
    def _normal_variation(self) -> sparse.csr_array:
        """dn/dr = (1 - n n^T) dN/dr / |N|."""
        across = np.eye(3) - self._normal[:, :, None] * self._normal[:, None, :]
        across /= self._length[:, None, None]
        across[~self._wanted] = 0.0
        nodes = np.arange(self._n)
        return _of_blocks(across, nodes, nodes, self._n) @ self._summed_variation

    def first(self) -> sparse.csr_array:
        """Return d(inner faces, outer faces)/dr, shape (6 n_nodes, 3 n_nodes)."""
        own = sparse.diags_array(np.repeat(self._wanted.astype(float), 3))
        turned = self._normal_variation
        parts = [
            own + sparse.diags_array(np.repeat(self._heights[:, k], 3)) @ turned for k in (0, 1)
        ]
        return sparse.csr_array(sparse.vstack(parts, format="csr"))

    def second(self, forces: Floats) -> sparse.csr_array:
        """Return the second variation of forces . faces in r, shape (3 n_nodes, 3 n_nodes).

        Args:
            forces: Held forces on the faces, shape (2, n_nodes, 3), nought but at the nodes asked
                for.
        """
        turning = np.einsum("nk,kni->ni", self._heights, forces)
        along = np.sum(turning * self._normal, axis=1)
        aside = turning - along[:, None] * self._normal
        n, length = self._normal, self._length
        # of turning . N/|N| in N
        mixed = aside[:, :, None] * n[:, None, :]
        plane = along[:, None, None] * (np.eye(3) - n[:, :, None] * n[:, None, :])
        bend = -(mixed + mixed.transpose(0, 2, 1) + plane) / (length**2)[:, None, None]
        nodes = np.arange(self._n)
        by_sum = self._summed_variation
        through_sum = by_sum.T @ _of_blocks(bend, nodes, nodes, self._n) @ by_sum
        # N is bilinear in r
        slope = -_cross_matrix(aside / length[:, None])[self._node]
        first, second = self._gradient[..., 0], self._gradient[..., 1]
        weights = first[:, :, None] * second[:, None, :]
        weights = weights - weights.transpose(0, 2, 1)
        shape = weights.shape
        rows = np.broadcast_to(self._around[:, :, None], shape)
        columns = np.broadcast_to(self._around[:, None, :], shape)
        blocks = weights[..., None, None] * slope[:, None, None]
        return sparse.csr_array(through_sum + _of_blocks(blocks, rows, columns, self._n))


def _cross_matrix(vectors: Floats) -> Floats:
    """Return the matrices of v x, shape (n, 3, 3)."""
    matrix = np.zeros((len(vectors), 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[:, i, k] = vectors[:, j]
        matrix[:, k, i] = -vectors[:, j]
    return matrix


def _of_blocks(blocks: Floats, rows: Integers, columns: Integers, n: int) -> sparse.csr_array:
    """Return the sum of 3 x 3 blocks (..., 3, 3) at rows and columns (...), shape (3 n, 3 n)."""
    row, column = np.broadcast_arrays(
        3 * rows[..., None, None] + np.arange(3)[:, None],
        3 * columns[..., None, None] + np.arange(3),
    )
    where = (row.ravel(), column.ravel())
    return sparse.csr_array(sparse.coo_array((blocks.ravel(), where), shape=(3 * n, 3 * n)))
