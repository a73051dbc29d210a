"""The mass balance of layers of a meridian."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import ufl
from numpy.typing import NDArray
from scipy import linalg

from opticcup_fem.errors import CaseError
from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.shell import closures
from opticcup_fem.shell.balance import (
    BalanceLaw,
    Geometry,
    LayerBalance,
    LayerSites,
    MassBalance,
    root_of_metric,
)
from opticcup_fem.shell.kernels import compile_kernels
from opticcup_fem.shell.layer_geometry import names_of
from opticcup_fem.shell.transport import CellIntegrals, TransportForms

Array = NDArray[np.float64]
Expr = Any


class MeridianFlux(CellIntegrals):
    """Cell integrals of a layer's density on a meridian, and the solution of their sum."""

    def __init__(self, shell: MeridianShell, layer: str, sites: LayerSites) -> None:
        """Compile the forms on the cells of a layer, a run of neighbours."""
        mesh, cells = shell.mesh, sites.cells
        element = basix.ufl.element(
            "Lagrange",
            "interval",
            mesh.degree,
            lagrange_variant=basix.LagrangeVariant.gll_warped,
        )

        def gradient(u: Expr) -> tuple[Expr, Expr]:
            return u.dx(0), ufl.as_ufl(0.0)

        forms = TransportForms(shell.forms.domain, element, shell.forms.dx, gradient)
        kernels = compile_kernels(MPI.COMM_SELF, forms.integrals, mesh.corners()[cells])
        super().__init__(forms, kernels, shell.basis[cells], {})
        nodes = mesh.cells[cells] - mesh.cells[cells].min()
        self._size = int(nodes.max()) + 1
        self._rows = np.concatenate([nodes, nodes + self._size], axis=1)
        self._place_ends(shell, layer, cells)

    def _place_ends(self, shell: MeridianShell, layer: str, cells: NDArray[np.int64]) -> None:
        """Measure 2 pi r_ref H at the ends of the layer that are not poles."""
        mesh = shell.mesh
        self._places, self._ends = [], []
        for cell, end in ((0, 0), (len(cells) - 1, 1)):
            vertex = int(cells[cell]) + end
            if mesh.is_pole[vertex]:
                continue
            s = mesh.vertices[[vertex]]
            r, z = mesh.profile.position(s)[0]
            region = next(name for name, of in mesh.region.items() if int(cells[cell]) in of)
            section = shell.sections[region]
            place = names_of(section).index(layer)
            factor = shell.growth_at(0.0, region, s)[place].thickness
            H = section.layers[place].thickness * float(np.reshape(factor, -1)[0])
            self._places.append([r, 0.0, z])
            self._ends.append((cell, end, 2 * np.pi * r * H))

    def edge(self, flux: Callable[[Array], Array]) -> Array:
        """See ``balance.FluxSystem``."""
        loads: Array = np.zeros((len(self._rows), self.basis.shape[-1]))
        if self._ends:
            q = np.broadcast_to(flux(np.array(self._places)), len(self._places))
            for (cell, end, length), one in zip(self._ends, q, strict=True):
                loads[cell, end] += length * one
        return loads

    def solve(self, matrices: Array | None, right: Array) -> Array:
        """See ``balance.FluxSystem``."""
        n = 2 * self._size
        if matrices is not None:
            whole = np.zeros((n, n))
            np.add.at(whole, (self._rows[:, :, None], self._rows[:, None, :]), matrices)
            self._factors = linalg.lu_factor(whole)
        vector = np.zeros(n)
        np.add.at(vector, self._rows, right)
        return np.asarray(linalg.lu_solve(self._factors, vector)[self._rows])


def meridian_sites(shell: MeridianShell, layer: str) -> LayerSites:
    """Return where the balance of a layer is solved on a meridian, before any growth.

    Raises:
        CaseError: The shell has no such layer.
    """
    regions = [name for name, one in shell.sections.items() if layer in names_of(one)]
    if not regions:
        raise CaseError(f"there is no layer {layer} whose mass balance could be solved")
    mesh = shell.mesh
    cells = np.concatenate([mesh.region[name] for name in regions])
    n_points = shell.points.shape[1]
    H = np.zeros((mesh.n_cells, n_points))
    for name in regions:
        place = names_of(shell.sections[name]).index(layer)
        factor = shell.growth_at(0.0, name)[place].thickness
        rows = mesh.region[name]
        values = np.broadcast_to(factor, len(rows) * n_points).reshape(-1, n_points)
        H[rows] = shell.sections[name].layers[place].thickness * values
    lengths = shell.forms.quadrature_weights * mesh.sizes[cells][:, None]
    return LayerSites(
        cells,
        shell.points_of(cells),
        n_points,
        (H * shell.circumference)[cells].ravel(),
        lengths.ravel(),
        np.ones(lengths.size),
        MPI.COMM_SELF,
    )


def meridian_geometry(
    shell: MeridianShell, state: MeridianState, t_n: float
) -> dict[str, Geometry]:
    """Return where the balanced layers are in a state.

    Raises:
        LostFibre: Some layer has no admissible state.
    """
    assert shell.balance is not None
    return layer_geometry(shell, state, t_n, list(shell.balance.layers))


def layer_geometry(
    shell: MeridianShell, state: MeridianState, t_n: float, layers: list[str]
) -> dict[str, Geometry]:
    """Return where layers are in a state; see ``meridian_geometry``."""
    forms = shell.forms_at_points(state)
    found = {}
    for layer in layers:
        stretch, thickness = [], []
        for name, section in shell.sections.items():
            if layer not in names_of(section):
                continue
            at = forms[shell.mesh.region[name]].reshape(-1, 6)
            means = closures.mean_stretches(
                shell.closure,
                section,
                shell.growth_at(t_n, name),
                at,
                np.broadcast_to([1.0, 1.0, 0.0], (len(at), 3)),
                shell.mesh.profile.curvature,
            )
            stretch.append(root_of_metric(at[:, :3]))
            thickness.append(means[layer])
        found[layer] = Geometry(np.concatenate(stretch), np.concatenate(thickness))
    return found


def meridian_balance(
    shell: MeridianShell, laws: Mapping[str, BalanceLaw], tolerance: float = 1e-5
) -> MassBalance:
    """Let layers of a meridian grow by their mass balance from now on.

    Args:
        shell: The shell.
        laws: What changes the mass of each layer that has a balance.
        tolerance: Change of e that ends the iteration with the deformation.

    Returns:
        The balance, which is the shell's own from now on.

    Raises:
        CaseError: The shell lacks one of the layers.
    """
    layers = {}
    for name, law in laws.items():
        sites = meridian_sites(shell, name)
        flux = None if law.diffusivity is None else MeridianFlux(shell, name, sites)
        layers[name] = LayerBalance(name, law, sites, flux)
    geometry = layer_geometry(shell, shell.reference_state(), 0.0, list(laws))
    # the whole past is needed: an unstable part of the path goes back in time
    balance = MassBalance(layers, geometry, tolerance, kept=10**6)
    shell.balance = balance
    balance.take_over(shell.laws)
    return balance


def settle(shell: MeridianShell, state: MeridianState, t_n: float) -> bool:
    """Solve the mass balance with the shell in a state; return whether that changed the growth.

    Raises:
        UnbalancedLayer: There is no solution.
    """
    balance = shell.balance
    if balance is None or t_n <= balance.t_n:
        return False
    return balance.settle(t_n, meridian_geometry(shell, state, t_n))


def commit(shell: MeridianShell, state: MeridianState, t_n: float) -> None:
    """Make the growth up to a state its past."""
    if shell.balance is not None:
        shell.balance.commit(t_n, meridian_geometry(shell, state, t_n))


def balance_columns(shell: MeridianShell, state: MeridianState, t_n: float) -> dict[str, float]:
    """Return the numbers of the mass balance in a state, none where there is none."""
    if shell.balance is None:
        return {}
    return shell.balance.columns(t_n, meridian_geometry(shell, state, t_n))
