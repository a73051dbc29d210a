"""States as arrays cell by cell in the order of the mesh's input: the same on any number of ranks.

How dolfinx numbers nodes and edges depends on the ranks, and with the numbers the direction of the
edges.  The input's cells and their first, second and third vertex do not: what a cell knows of the
unknowns, in its own order and seen from its own outside, is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.shell.balance import Geometry, LayerSites, LayerStep
from opticcup_fem.shell.model import ContactData, Shell, ShellState

Array = NDArray[np.float64]
CellArrays = dict[str, Array]

SAME_PLACE = 1e-9
"""Vertices nearer than this, unit R, are the same."""


class Cellwise:
    """Turns a shell's states into arrays over the cells of the input, and back.

    Attributes:
        order: Where the input's cells stand among those of all ranks, rank by rank; on rank 0.
    """

    def __init__(self, shell: Shell) -> None:
        """Take the order of the input's cells (collective)."""
        self.shell = shell
        spaces = shell.spaces
        mine = np.asarray(spaces.mesh.topology.original_cell_index)[: spaces.n_cells]
        self._input = mine.astype(np.int64)
        gathered = shell.comm.gather(self._input)
        self.order = None if gathered is None else np.argsort(np.concatenate(gathered))
        self._corners = shell.comm.bcast(self.gather({"corners": spaces.coordinates}))["corners"]

    def gather(self, mine: CellArrays) -> CellArrays:
        """Return arrays over this rank's cells as arrays over all, {} off rank 0 (collective)."""
        parts = self.shell.comm.gather(mine)
        if parts is None or self.order is None:
            return {}
        return {name: np.concatenate([part[name] for part in parts])[self.order] for name in mine}

    @property
    def corners(self) -> Array:
        """Vertices of all cells, shape (n, 3, 3): which mesh, in which order."""
        return self._corners

    def fits(self, corners: Array) -> bool:
        """Return whether arrays over the cells with these vertices belong to this mesh."""
        same = corners.shape == self._corners.shape
        return same and bool(np.abs(corners - self._corners).max() < SAME_PLACE)

    def pack(self, state: ShellState) -> CellArrays:
        """Return a state as arrays over all cells on rank 0, {} elsewhere (collective).

        Angles count about the edge run counter-clockwise round the cell.  Of contact data the
        faces' heights are packed, not the two numbers.
        """
        spaces, directors = self.shell.spaces, self.shell.directors
        arrays = {
            "r": state.r[spaces.nodes],
            "alpha": directors.per_cell(state.alpha) * spaces.edge_sign[:, :, None],
            "director": directors.per_cell(state.director),
            "kappa": state.kappa,
            "sigma": state.sigma,
        }
        if state.contact is not None:
            arrays["heights"] = state.contact.heights
        return self.gather(arrays)

    def unpack(self, arrays: CellArrays, time: float = 0.0, touches: bool = False) -> ShellState:
        """Return the state of arrays over all cells, which every rank has (collective).

        Args:
            arrays: What ``pack`` gave.
            time: Normalised time of the obstacles, where there are ``heights``.
            touches: Whether anything touches, where there are ``heights``.
        """
        spaces = self.shell.spaces
        mine = {name: values[self._input] for name, values in arrays.items()}

        def at_nodes(values: Array) -> Array:
            nodal = np.zeros((spaces.n_nodes, *values.shape[2:]))
            nodal[spaces.nodes] = values
            return nodal

        contact = None
        if "heights" in mine:
            contact = ContactData(mine["heights"], time, touches)
        directors = self.shell.directors
        return ShellState(
            r=at_nodes(mine["r"]),
            contact=contact,
            alpha=directors.from_cells(mine["alpha"] * spaces.edge_sign[:, :, None]),
            director=directors.from_cells(mine["director"]),
            kappa=mine["kappa"],
            sigma=mine["sigma"],
        )

    def pack_balance(self) -> CellArrays:
        """Return what is known of the mass balance as arrays over all cells on rank 0 (collective).

        Cells without a layer hold ones.
        """
        balance = self.shell.balance
        if balance is None:
            return {}
        n, arrays = self.shell.spaces.n_cells, {}
        for name, layer in balance.layers.items():
            sites = layer.sites

            def spread(values: Array, sites: LayerSites = sites) -> Array:
                whole: Array = np.ones((n, sites.n_points, *values.shape[1:]))
                whole[sites.cells] = values.reshape(-1, sites.n_points, *values.shape[1:])
                return whole

            arrays[f"{name}.mass"] = spread(balance.mass[name])
            arrays[f"{name}.stretch"] = spread(balance.geometry[name].stretch)
            arrays[f"{name}.thickness"] = spread(balance.geometry[name].thickness)
            for k, steps in enumerate(balance.past):
                arrays[f"{name}.past{k}"] = spread(np.moveaxis(steps[name].mass, 0, -1))
        return self.gather(arrays)

    def unpack_balance(
        self, arrays: CellArrays, t_n: float, steps: Sequence[Mapping[str, Any]]
    ) -> None:
        """Restore the mass balance from arrays that every rank has.

        Args:
            arrays: As ``pack_balance`` returned them.
            t_n: Time up to which growth is known.
            steps: Start and end of the last steps, and by layer their total and error.
        """
        balance = self.shell.balance
        if balance is None:
            return
        balance.past = [{} for _ in steps]
        geometry = {}
        for name, layer in balance.layers.items():

            def mine(what: str, name: str = name, cells: Any = layer.sites.cells) -> Array:
                values: Array = arrays[f"{name}.{what}"][self._input][cells]
                return values.reshape(-1, *values.shape[2:])

            balance.mass[name] = mine("mass")
            geometry[name] = Geometry(mine("stretch"), mine("thickness"))
            for k, step in enumerate(steps):
                mass = np.moveaxis(mine(f"past{k}"), -1, 0)
                total, error = step["layers"][name]
                balance.past[k][name] = LayerStep(
                    step["start"], step["end"], mass, None, total, error
                )
        balance.geometry, balance.t_n = geometry, t_n
        balance.forget()
