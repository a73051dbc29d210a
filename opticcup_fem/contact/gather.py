"""Fields at the nodes of all ranks, together on rank 0 and back."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.shell.spaces import ShellSpaces

Array = NDArray[np.float64]


class NodeGather:
    """Numbers the nodes of all ranks as dolfinx does: rank by rank.

    Attributes:
        comm: Communicator.
        cells: On rank 0 the nodes of all cells, shape (n_cells of all ranks, n_cell_nodes).
    """

    def __init__(self, spaces: ShellSpaces) -> None:
        """Number the nodes (collective)."""
        index_map = spaces.position.dofmap.index_map
        self.comm: MPI.Intracomm = spaces.mesh.comm
        self._owned = index_map.size_local
        local = np.arange(spaces.n_nodes, dtype=np.int32)
        self._global: NDArray[np.int64] = index_map.local_to_global(local)
        self.cells = self.cell_values(self._global[spaces.nodes])

    def cell_values(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return on rank 0 the values of the cells of all ranks; elsewhere nothing (collective)."""
        return self._stacked(values)

    def to_root(self, values: Array) -> Array:
        """Return on rank 0 values (n_nodes, ...) of all nodes; elsewhere nothing (collective)."""
        return self._stacked(values[: self._owned])

    def _stacked(self, values: NDArray[Any]) -> NDArray[Any]:
        parts = self.comm.gather(values)
        return np.concatenate(parts) if parts is not None else values[:0]

    def from_root(self, values: Array | None) -> Array:
        """Return at a rank's nodes the values that rank 0 has at all (collective)."""
        everywhere: Array = self.comm.bcast(values)
        return everywhere[self._global]

    def everywhere(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values (n_nodes, ...) of all nodes, on every rank (collective)."""
        return np.concatenate(self.comm.allgather(values[: self._owned]))
