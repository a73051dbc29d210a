"""Cell integrals of a layer's density, in UFL, and where the balance of a layer is solved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import basix.ufl
import numpy as np
import ufl
from numpy.typing import NDArray

from opticcup_fem.errors import CaseError
from opticcup_fem.shell import kinematics
from opticcup_fem.shell.balance import LayerSites
from opticcup_fem.shell.curves import boundary_edges, curve_edges
from opticcup_fem.shell.forms import Integral
from opticcup_fem.shell.kernels import Kernel, compile_kernels
from opticcup_fem.shell.layer_geometry import names_of
from opticcup_fem.shell.loads import LoadSites
from opticcup_fem.shell.model import Shell

Array = NDArray[np.float64]
Expr = Any


class TransportForms:
    """The cell integrals of a scalar Lagrange field: ``C`` (capacity), ``K`` (conduction), ``F``.

    Attributes:
        integrals: The forms by name.
        value: Coefficient of ``C`` and ``F`` at the quadrature points.
        conductivity: That of ``K``, (11, 22, 12).
        v: Test function.
    """

    def __init__(
        self,
        domain: ufl.Mesh,
        element: basix.ufl._ElementBase,
        dx: ufl.Measure,
        gradient: Callable[[Expr], tuple[Expr, Expr]],
    ) -> None:
        """Write the forms.

        Args:
            domain: The cells.
            element: Scalar Lagrange element of the field.
            dx: Their measure, with the quadrature of the shell.
            gradient: Components of the gradient of a scalar in the cells' frames.
        """
        cell = element.cell_type.name
        degree = dx.metadata()["quadrature_degree"]

        def at_points(shape: tuple[int, ...]) -> ufl.Coefficient:
            quadrature = basix.ufl.quadrature_element(cell, value_shape=shape, degree=degree)
            return ufl.Coefficient(ufl.FunctionSpace(domain, quadrature))

        space = ufl.FunctionSpace(domain, element)
        u, self.v = ufl.TrialFunction(space), ufl.TestFunction(space)
        self.value, self.conductivity = at_points(()), at_points((3,))
        K = self.conductivity
        (u_1, u_2), (v_1, v_2) = gradient(u), gradient(self.v)
        flow = K[0] * u_1 * v_1 + K[1] * u_2 * v_2 + K[2] * (u_1 * v_2 + u_2 * v_1)
        self.integrals = {
            "C": Integral(self.value * u * self.v * dx, False),
            "K": Integral(flow * dx, False),
            "F": Integral(self.value * self.v * dx, False),
        }


@dataclass(frozen=True)
class CellIntegrals:
    """The compiled forms on the cells of a layer.

    Attributes:
        forms: The forms.
        kernels: Their kernels on these cells.
        basis: The field's basis at the points, see ``balance.FluxSystem``.
        fixed: Coefficients that do not change.
    """

    forms: TransportForms
    kernels: dict[str, Kernel]
    basis: Array
    fixed: dict[ufl.Coefficient, Array]

    def capacity(self, values: Array) -> Array:
        """See ``balance.FluxSystem``."""
        return self.kernels["C"]({**self.fixed, self.forms.value: values})

    def conduction(self, values: Array) -> Array:
        """See ``balance.FluxSystem``."""
        return self.kernels["K"]({**self.fixed, self.forms.conductivity: values})

    def load(self, values: Array) -> Array:
        """See ``balance.FluxSystem``."""
        return self.kernels["F"]({**self.fixed, self.forms.value: values})


class SurfaceTransport(CellIntegrals):
    """The same on a surface, with the layer's edge."""

    def __init__(self, shell: Shell, layer: str, sites: LayerSites) -> None:
        """Compile the forms on the cells of a layer (collective)."""
        spaces, cells = shell.spaces, sites.cells
        domain = shell.forms.domain
        element = basix.ufl.element(
            "Lagrange",
            "triangle",
            spaces.degree,
            lagrange_variant=basix.LagrangeVariant.equispaced,
        )
        orientation = shell.forms.orientation
        frame = kinematics.cell_frame(domain, orientation)

        def gradient(u: Expr) -> tuple[Expr, Expr]:
            return ufl.dot(ufl.grad(u), frame.t_1), ufl.dot(ufl.grad(u), frame.t_2)

        forms = TransportForms(domain, element, shell.forms.dx, gradient)
        self._flux = ufl.Coefficient(ufl.FunctionSpace(spaces.edge_domain, spaces.edge_element()))
        forms.integrals["E"] = Integral(self._flux * forms.v * shell.forms.ds, True)
        kernels = compile_kernels(shell.comm, forms.integrals, spaces.coordinates[cells])
        basis = spaces.position_table(shell.forms.quadrature_points)
        super().__init__(forms, kernels, basis, {orientation: spaces.orientation[cells]})
        self._place_edges(shell, layer, cells)

    def _place_edges(self, shell: Shell, layer: str, cells: NDArray[np.int64]) -> None:
        """Measure H dS_ref at the edges' Gauss points where the layer ends, nought elsewhere."""
        spaces, mesh = shell.spaces, shell.surface_mesh
        length = LoadSites.of(mesh, spaces, shell.rest).edge_length[cells]
        edges = boundary_edges(spaces)
        if not all(layer in names_of(section) for section in shell.sections.values()):
            curves = [curve_edges(mesh, curve) for curve in mesh.curves]
            edges = np.concatenate([edges, *curves])
        ends = np.isin(spaces.edges[cells], edges)
        points = spaces.edge_reference_points().reshape(-1, 2)
        table = spaces.position_table(points)
        places = np.einsum("qn,cni->cqi", table, shell.reference[spaces.nodes[cells]])
        self._places = places.reshape(-1, 3)
        thickness = self._thickness(shell, layer, cells, points).reshape(length.shape)
        self._edge = length * ends[:, :, None] * thickness

    @staticmethod
    def _thickness(shell: Shell, layer: str, cells: NDArray[np.int64], points: Array) -> Array:
        """Return the thickness at rest at reference points of cells."""
        found = np.zeros((len(cells), len(points)))
        for name, section in shell.sections.items():
            if layer not in names_of(section):
                continue
            rows = np.flatnonzero(np.isin(cells, shell.region_cells(name)))
            place = names_of(section).index(layer)
            factor = shell.growth_at(name, points)[place].thickness
            shape = (len(rows), len(points))
            values = np.broadcast_to(factor, shape[0] * shape[1]).reshape(shape)
            found[rows] = section.layers[place].thickness * values
        return found

    def edge(self, flux: Callable[[Array], Array]) -> Array:
        """See ``balance.FluxSystem``."""
        q = np.broadcast_to(flux(self._places), len(self._places)).reshape(self._edge.shape)
        into = np.zeros((len(self._edge), self.basis.shape[-1]))
        return self.kernels["E"]({**self.fixed, self._flux: q * self._edge}, into=into)


def surface_sites(shell: Shell, layer: str) -> LayerSites:
    """Return where the balance of a layer is solved on a surface, before any growth (collective).

    Raises:
        CaseError: The shell has no such layer.
    """
    regions = [name for name, one in shell.sections.items() if layer in names_of(one)]
    if not regions:
        raise CaseError(f"there is no layer {layer} whose mass balance could be solved")
    cells = np.sort(np.concatenate([shell.region_cells(name) for name in regions]))
    points = shell.points_of(cells)
    n_points = len(shell.forms.quadrature_points)
    H = np.zeros((shell.spaces.n_cells, n_points))
    for name in regions:
        place = names_of(shell.sections[name]).index(layer)
        rows = shell.region_cells(name)
        factor = np.broadcast_to(shell.growth[name][place].thickness, len(rows) * n_points)
        H[rows] = shell.sections[name].layers[place].thickness * factor.reshape(-1, n_points)
    area = shell.area_ref[cells]
    measure = shell.forms.quadrature_weights * shell.spaces.det_j[cells][:, None]
    return LayerSites(
        cells.astype(np.int64),
        points,
        n_points,
        (H[cells] * area).ravel(),
        np.broadcast_to(measure, area.shape).ravel(),
        area.ravel(),
        shell.comm,
    )
