"""External work of the loads on a shell, in UFL, and its derivatives cell by cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import basix.ufl
import numpy as np
import ufl
from numpy.typing import NDArray

from opticcup_fem.shell.forms import Integral, ShellForms
from opticcup_fem.shell.kernels import Kernel, compile_kernels
from opticcup_fem.shell.loads import Load, LoadSites, LoadValues, quadrature_degree

Array = NDArray[np.float64]
CellData = Mapping[ufl.Coefficient, Array]


class WorkForms:
    """The forms of external work.

    Cells: ``Q`` (work), ``Qr`` (its first variation), ``Qrr``.  Edges: ``Q_edge, Qr_edge`` and
    ``Qa_edge`` (in alpha).

    Attributes:
        integrals: The forms by name.
        moment: Coefficient of ``LoadValues.edge_moment``.
        edge_force: That of ``edge_force``.
        force: That of ``surface_force``.
        pressure: That of ``pressure``.
    """

    def __init__(self, forms: ShellForms) -> None:
        """Write the forms in the position and the angles of ``forms``."""
        spaces, domain, frame = forms.spaces, forms.domain, forms.frame
        degree = quadrature_degree(spaces)
        dx = forms.dx(metadata={"quadrature_degree": degree, "quadrature_rule": "default"})

        def at_points(shape: tuple[int, ...]) -> ufl.Coefficient:
            element = basix.ufl.quadrature_element("triangle", value_shape=shape, degree=degree)
            return ufl.Coefficient(ufl.FunctionSpace(domain, element))

        def on_edges(shape: tuple[int, ...]) -> ufl.Coefficient:
            element = spaces.edge_element(shape)
            return ufl.Coefficient(ufl.FunctionSpace(spaces.edge_domain, element))

        self.moment, self.edge_force = on_edges(()), on_edges((3,))
        self.force, self.pressure = at_points((3,)), at_points(())
        gradient = ufl.grad(forms.r)
        area = ufl.cross(ufl.dot(gradient, frame.t_1), ufl.dot(gradient, frame.t_2))
        dead = ufl.dot(self.force, forms.r)
        in_cells = ufl.dot(self.force + self.pressure * area, forms.v) * dx
        on_edge = (
            ufl.dot(self.edge_force, forms.r) - self.moment * forms.sign * forms.alpha
        ) * forms.ds
        volume = self.pressure * ufl.dot(forms.r, area) / 3
        self.integrals = {
            "Q": Integral((dead + volume) * dx, False),
            "Qr": Integral(in_cells, False),
            "Qrr": Integral(ufl.derivative(in_cells, forms.r, forms.dr), False),
            "Q_edge": Integral(on_edge, True),
            "Qr_edge": Integral(ufl.derivative(on_edge, forms.r, forms.v), True),
            "Qa_edge": Integral(ufl.derivative(on_edge, forms.alpha, forms.beta), True),
        }


class ExternalWork:
    """External work of all loads on a shell and its derivatives, cell by cell.

    Attributes:
        has_potential: Whether every load has one.
    """

    def __init__(self, loads: Sequence[Load], forms: ShellForms, sites: LoadSites) -> None:
        """Compile the forms (collective).

        Args:
            loads: The loads.
            forms: Forms of the shell, whose coefficients position and angle the work shares.
            sites: Where loads act.
        """
        self._loads, self._sites = tuple(loads), sites
        self._forms = WorkForms(forms)
        spaces = sites.spaces
        self._kernels: dict[str, Kernel] = compile_kernels(
            spaces.mesh.comm, self._forms.integrals, spaces.coordinates
        )
        self.has_potential = all(load.has_potential(sites) for load in self._loads)

    def set_time(self, t_n: float) -> None:
        """Set the loads to normalised time ``t_n`` (collective)."""
        values = LoadValues.zero(self._sites)
        for load in self._loads:
            load.add(values, self._sites, t_n)
        forms = self._forms
        self._values: dict[ufl.Coefficient, Array] = {
            forms.moment: values.edge_moment,
            forms.edge_force: values.edge_force,
            forms.force: values.surface_force,
            forms.pressure: values.pressure,
        }

    def work(self, data: CellData) -> float:
        """Return the rank's share of the loads' work, minus their potential where they have one.

        Args:
            data: Position, angles and signs of ``ShellForms``.
        """
        data = {**data, **self._values}
        total = np.sum(self._kernels["Q"](data)) + np.sum(self._kernels["Q_edge"](data))
        return float(total)

    def gradient(self, data: CellData) -> Array:
        """Return the derivative of the work in the cells' (r, alpha), shape (n_cells, n_u)."""
        data = {**data, **self._values}
        in_r = self._kernels["Qr_edge"](data, into=self._kernels["Qr"](data))
        in_alpha = self._kernels["Qa_edge"](data)
        return np.concatenate([in_r, in_alpha.reshape(len(in_r), -1)], axis=1)

    def tangent(self, data: CellData) -> Array:
        """Return the second derivative of the work in r, shape (n_cells, n_r, n_r).

        Of a pressure with a potential only the sum over all cells is symmetric.
        """
        return self._kernels["Qrr"]({**data, **self._values})
