"""Blocks between cells as whole matrices."""

import numpy as np
from scipy import sparse

from opticcup_fem.contact.blocks import SIDE, Blocks
from opticcup_fem.snapshot import Integers


def matrix_of(blocks: Blocks, cells: Integers) -> sparse.csr_array:
    """The sum of blocks between cells with the given nodes, shape (3 n_nodes, 3 n_nodes)."""
    coordinates = (3 * cells[:, :, None] + np.arange(3)).reshape(-1, SIDE)
    size = 3 * (int(cells.max()) + 1)
    total = sparse.csr_array((size, size))
    for part in (blocks, blocks.mirrored()):
        rows = np.repeat(coordinates[part.first], SIDE, axis=1)
        columns = np.tile(coordinates[part.second], SIDE)
        where = (rows.ravel(), columns.ravel())
        total = total + sparse.csr_array((part.values.ravel(), where), shape=(size, size))
    return total
