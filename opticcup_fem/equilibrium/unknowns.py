"""The unknowns u = (r, alpha) of a shell as a PETSc vector; mirror images count as one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.shell.mirrors import fold
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.spaces import number_unknowns

Array = NDArray[np.float64]


class Unknowns:
    """Numbers of the unknowns, and sums and values that go between ranks.

    Attributes:
        held: Mask of held unknowns over the rank's local unknowns (see ``shell.supports``).
        mirrors: Planes x_i = 0 that the deformation keeps as mirrors.
        idle: Mask of the unknowns that stay as they are: held ones, and those that would leave a
            mirror.
        in_cells: Local numbers of the unknowns of every cell, shape (n_cells, n_u).
        numbers: Global number of every local unknown.
        sign: Factor of every local unknown on the global one; None where all are 1.
        owned: Number of global unknowns of this rank.
        vector: A vector of all of them, to duplicate.
    """

    def __init__(self, shell: Shell, held: NDArray[np.bool_], mirrors: Sequence[int] = ()) -> None:
        """Number the unknowns (collective).

        Args:
            shell: The shell.
            held: Mask of held unknowns.
            mirrors: Planes x_i = 0 that the deformation keeps as mirrors, of 0, 1, 2; they map
                ``held`` onto itself.

        Raises:
            MeshError: A plane is no mirror of the mesh.
        """
        self.comm: MPI.Intracomm = shell.comm
        self.held, self.mirrors = held, tuple(mirrors)
        self.in_cells = _in_cells(shell)
        self._degree, self._split = shell.spaces.degree, 3 * shell.spaces.n_nodes
        every = number_unknowns(shell.spaces)
        numbering = fold(shell, every, self.mirrors) if self.mirrors else every
        self._own = every.owned_local  # whose values no other rank has
        self._originals = numbering.owned_local
        self.numbers, self.sign, self.owned = (
            numbering.local_to_global,
            numbering.sign,
            numbering.owned,
        )
        self.idle = held if self.sign is None else held | (self.sign == 0)
        self._make_vector()

    def _make_vector(self) -> None:
        before = self.comm.exscan(self.owned)  # None on rank 0
        start, n = int(before or 0), self.numbers
        is_ghost = (n < start) | (n >= start + self.owned)
        ghosts = np.unique(n[is_ghost])
        self.range = start, start + self.owned
        self.idle_owned = np.unique(n[self.idle & ~is_ghost])
        self.map = PETSc.LGMap().create(n, comm=self.comm)
        self.vector = PETSc.Vec().createGhost(ghosts, (self.owned, None), comm=self.comm)
        self._slot = n - start
        self._slot[is_ghost] = self.owned + np.searchsorted(ghosts, n[is_ghost])

    def split(self, local: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return local values as positions (n_nodes, 3) and angles (n_edges, k)."""
        return local[: self._split].reshape(-1, 3), local[self._split :].reshape(-1, self._degree)

    def joined(self, r: Array, alpha: Array) -> Array:
        """Return positions and angles as local values, the inverse of ``split``."""
        return np.concatenate([r.ravel(), alpha.ravel()])

    def owned_values(self, r: Array, alpha: Array) -> Array:
        """Return the rank's owned values, in global order, of what keeps the mirrors."""
        return self.joined(r, alpha)[self._originals]

    def symmetric_part(self, r: Array, alpha: Array) -> Array:
        """Return the owned values of the part of a motion that keeps the mirrors (collective)."""
        if self.sign is None:
            return self.owned_values(r, alpha)
        motion, images = self.vector.duplicate(), self.vector.duplicate()
        self.add_own(self.joined(r, alpha), motion)
        self.add_own(self.sign, images)
        part: Array = motion.array_r / np.maximum(images.array_r, 1.0)
        return part

    def to_local(self, owned: Array) -> Array:
        """Return all local values (owned and ghost) from the owned ones (collective)."""
        with self.vector.localForm() as local:
            local.array[: len(owned)] = owned
        self.vector.ghostUpdate(PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)
        with self.vector.localForm() as local:
            values: Array = local.array_r[self._slot]
        return values if self.sign is None else self.sign * values

    def add_cells(self, cells: Array, out: PETSc.Vec, power: int = 1) -> None:
        """Add up cell values (n_cells, n_u) into ``out``; held unknowns get zero (collective).

        Args:
            cells: Values that go with the sign of their unknown, as forces do.
            out: What is overwritten.
            power: 2 for diagonals of matrices, which go with the square of the sign.
        """
        n = len(self.numbers)
        summed = np.bincount(self.in_cells.ravel(), weights=cells.ravel(), minlength=n)
        self._add_up(summed.astype(np.float64), out, power)

    def add_own(self, values: Array, out: PETSc.Vec) -> None:
        """Add up values of all local unknowns, but not those of ghosts (collective)."""
        own = np.zeros_like(values)
        own[self._own] = values[self._own]
        self._add_up(own, out)

    def _add_up(self, values: Array, out: PETSc.Vec, power: int = 1) -> None:
        values[self.held] = 0.0
        if self.sign is not None:
            values = self.sign**power * values
        with self.vector.localForm() as local:
            local.array[:] = np.bincount(self._slot, values, len(local.array_r))
        self.vector.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        out.array[:] = self.vector.array_r


def _in_cells(shell: Shell) -> NDArray[np.int32]:
    """Return local numbers of the unknowns of every cell, shape (n_cells, n_u)."""
    spaces = shell.spaces
    n, positions = spaces.n_cells, 3 * spaces.nodes[:, :, None] + np.arange(3)
    slots: Array = np.arange(spaces.n_edges * spaces.degree, dtype=np.float64)
    angles = 3 * spaces.n_nodes + shell.directors.per_cell(slots.reshape(-1, spaces.degree))
    together = np.concatenate([positions.reshape(n, -1), angles.reshape(n, -1)], axis=1)
    return together.astype(np.int32)
