"""Snapshots in an order that does not depend on the number of ranks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from opticcup_fem.snapshot import Floats, Integers, Snapshot


class Reordering:
    """Puts the cells of snapshots of one mesh into an order, and the nodes as the cells need them.

    Attributes:
        nodes: The old numbers of the nodes in their new order, shape (n,).
    """

    def __init__(self, snapshot: Snapshot, order: Integers) -> None:
        """Number the nodes.

        Args:
            snapshot: Any state on the mesh.
            order: The old numbers of the cells in their new order, shape (m,).
        """
        self._order = order
        cells = snapshot.cells[order]
        _, first = np.unique(cells, return_index=True)
        self.nodes: Integers = cells.ravel()[np.sort(first)]
        number = np.empty(len(self.nodes), dtype=np.int64)
        number[self.nodes] = np.arange(len(self.nodes))
        self._cells: Integers = number[cells]

    def __call__(self, snapshot: Snapshot) -> Snapshot:
        """Return a snapshot in the new order."""
        order, traction = self._order, snapshot.contact_traction

        def region_rows(region: str) -> Integers:
            """Return the rows of a region's faces in their new order."""
            old = snapshot.cells_of(region)
            return np.searchsorted(old, order[np.isin(order, old)])

        return replace(
            snapshot,
            reference=snapshot.reference[self.nodes],
            position=snapshot.position[self.nodes],
            cells=self._cells,
            region=snapshot.region[order],
            orientation=snapshot.orientation[order],
            thickness_stretch={k: v[order] for k, v in snapshot.thickness_stretch.items()},
            stress={k: v[order] for k, v in snapshot.stress.items()},
            growth={k: v[order] for k, v in snapshot.growth.items()},
            faces={name: v[region_rows(name)] for name, v in snapshot.faces.items()},
            contact_traction=None if traction is None else traction[self.nodes],
        )

    def at_nodes(self, values: Floats) -> Floats:
        """Return a nodal field, shape (n, ...), in the new order."""
        return values[self.nodes]
