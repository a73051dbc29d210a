"""The mass balance of layers of a surface: densities on the mesh's nodes, solved by MUMPS."""

from __future__ import annotations

from collections.abc import Mapping

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.shell.balance import (
    BalanceLaw,
    Geometry,
    LayerBalance,
    LayerSites,
    MassBalance,
)
from opticcup_fem.shell.fibres import LostFibre
from opticcup_fem.shell.layer_geometry import layer_geometry
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.transport import SurfaceTransport, surface_sites

Array = NDArray[np.float64]


class SurfaceFlux(SurfaceTransport):
    """Cell integrals of a layer's density and the solution of their sum."""

    def __init__(self, shell: Shell, layer: str, sites: LayerSites) -> None:
        """Number two fields on the position's nodes (collective)."""
        super().__init__(shell, layer, sites)
        index_map = shell.spaces.position.dofmap.index_map
        self._owned = 2 * index_map.size_local
        nodes = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
        numbers = index_map.local_to_global(nodes)
        pairs = (2 * numbers[:, None] + np.arange(2)).ravel().astype(np.int32)
        rows = 2 * shell.spaces.nodes[sites.cells]
        self._rows = np.concatenate([rows, rows + 1], axis=1).astype(np.int32)
        sizes = (self._owned, None)
        ghosts = pairs[self._owned :]
        self._vector = PETSc.Vec().createGhost(ghosts, sizes, comm=shell.comm)
        self._matrix = PETSc.Mat().createAIJ((sizes, sizes), comm=shell.comm)
        mapping = PETSc.LGMap().create(pairs, comm=shell.comm)
        self._matrix.setLGMap(mapping, mapping)
        self._matrix.setUp()
        self._matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        used = self._assembled(np.ones(self._rows.shape))
        self._unused = pairs[: self._owned][used == 0]
        self._ksp = PETSc.KSP().create(shell.comm)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        self._ksp.setOperators(self._matrix)
        pc = self._ksp.getPC()
        pc.setType(PETSc.PC.Type.LU)
        pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)

    def _assembled(self, cells: Array) -> Array:
        """Add up cell vectors; return the owned values (collective)."""
        with self._vector.localForm() as local:
            local.array[:] = np.bincount(
                self._rows.ravel(), weights=cells.ravel(), minlength=len(local.array)
            )
        self._vector.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        return self._vector.array_r.copy()

    def solve(self, matrices: Array | None, right: Array) -> Array:
        """See ``balance.FluxSystem``."""
        if matrices is not None:
            self._assemble(np.ascontiguousarray(matrices))
        solution = self._vector.duplicate()
        solution.array[:] = self._assembled(right)
        self._ksp.solve(solution, solution)
        self._vector.array[:] = solution.array_r
        self._vector.ghostUpdate(PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)
        with self._vector.localForm() as local:
            return np.asarray(local.array_r[self._rows])

    def _assemble(self, matrices: Array) -> None:
        """Assemble the system from those of the cells (collective)."""
        matrix, add = self._matrix, PETSc.InsertMode.ADD_VALUES
        matrix.zeroEntries()
        matrix.setValuesLocalRCV(self._rows, self._rows, matrices, addv=add)
        for row in self._unused:  # nodes without the layer
            matrix.setValue(row, row, 1.0, addv=add)
        matrix.assemble()


def surface_balance(
    shell: Shell, laws: Mapping[str, BalanceLaw], tolerance: float = 1e-5
) -> MassBalance:
    """Let layers of an ungrown shell grow by their mass balance from now on (collective).

    Args:
        shell: The shell, at t_n = 0.
        laws: What changes the mass of each layer that has a balance.
        tolerance: Change of e that ends the iteration with the deformation.

    Returns:
        The balance, which is the shell's own from now on.

    Raises:
        CaseError: The shell lacks one of the layers.
    """
    layers = {}
    for name, law in laws.items():
        sites = surface_sites(shell, name)
        flux = None if law.diffusivity is None else SurfaceFlux(shell, name, sites)
        layers[name] = LayerBalance(name, law, sites, flux)
    geometry = layer_geometry(shell, shell.reference_state(), list(laws))
    balance = MassBalance(layers, geometry, tolerance)
    shell.solve_balance(balance)
    return balance


def begin_step(shell: Shell, t_n: float, guess: ShellState) -> None:
    """Set the shell to a time that a step is tried to, with the growth of a guess (collective).

    Raises:
        UnbalancedLayer: A mass balance has no solution there.
    """
    balance = shell.balance
    if balance is not None:
        balance.forget()
    shell.set_time(t_n)
    settle(shell, guess)


def settle(shell: Shell, state: ShellState) -> bool:
    """Solve the shell's mass balance with the shell in a state, at its present time (collective).

    A state that some layer cannot be in changes nothing.

    Returns:
        Whether the growth has changed by more than the balance's tolerance.

    Raises:
        UnbalancedLayer: There is no solution.
    """
    balance = shell.balance
    if balance is None or shell.t_n <= balance.t_n:
        return False
    geometry = _geometry(shell, state)
    if geometry is None or not balance.settle(shell.t_n, geometry):
        return False
    shell.set_time(shell.t_n)
    return True


def commit(shell: Shell, state: ShellState) -> None:
    """Make the growth up to the shell's present time, in a state, its past (collective)."""
    balance = shell.balance
    if balance is not None:
        geometry = _geometry(shell, state)
        assert geometry is not None
        balance.commit(shell.t_n, geometry)
        shell.set_time(shell.t_n)


def balance_columns(shell: Shell, state: ShellState) -> dict[str, float]:
    """Return the numbers of the mass balance in a state, none where there is none (collective)."""
    if shell.balance is None:
        return {}
    geometry = _geometry(shell, state)
    assert geometry is not None
    return shell.balance.columns(shell.t_n, geometry)


def _geometry(shell: Shell, state: ShellState) -> dict[str, Geometry] | None:
    """Return where the balanced layers are, None if a layer cannot be there (collective)."""
    assert shell.balance is not None
    found = None
    try:
        found = layer_geometry(shell, state, list(shell.balance.layers))
    except LostFibre:
        pass
    return found if shell.comm.allreduce(found is not None, MPI.LAND) else None
