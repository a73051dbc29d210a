"""Symmetric stiffness as blocks between cells: (30, 30) each, over the coordinates of ten nodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import sparse

from opticcup_fem.snapshot import Floats, Integers

SIDE = 30
"""Rows of a block: three coordinates of each of a cubic cell's ten nodes."""


class Blocks(NamedTuple):
    """Sum of blocks; those of two cells are given once, and stand for their transposed as well.

    Attributes:
        first: Cell of the rows, shape (n,).
        second: Cell of the columns, shape (n,).
        values: Shape (n, 30, 30).
    """

    first: Integers
    second: Integers
    values: Floats

    @classmethod
    def none(cls) -> Blocks:
        """Return no blocks."""
        nowhere = np.empty(0, dtype=np.int64)
        return cls(nowhere, nowhere, np.empty((0, SIDE, SIDE)))

    @classmethod
    def of(cls, matrix: sparse.csr_array) -> Blocks:
        """Return the blocks of a symmetric matrix."""
        blocks = sparse.bsr_array(matrix, blocksize=(SIDE, SIDE))
        first = np.repeat(np.arange(len(blocks.indptr) - 1), np.diff(blocks.indptr))
        second = blocks.indices.astype(np.int64)
        once = first <= second
        return cls(first[once], second[once], blocks.data[once])

    @classmethod
    def sum(cls, several: Sequence[Blocks]) -> Blocks:
        """Return the sum of several."""
        return cls(*(np.concatenate(parts) for parts in zip(*several, strict=True)))

    def mirrored(self) -> Blocks:
        """Return the transposed blocks of those that stand for them as well."""
        other = self.first != self.second
        turned = np.swapaxes(self.values[other], 1, 2)
        return Blocks(self.second[other], self.first[other], turned)
