"""The axisymmetric shell: a meridian, its layers, growth and closure, and a state's numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import ufl
from numpy.typing import NDArray

from opticcup_fem.meridian.forms import AxisymmetricForms
from opticcup_fem.meridian.mesh import Indices, MeridianMesh
from opticcup_fem.shell import closures
from opticcup_fem.shell.balance import MassBalance
from opticcup_fem.shell.fibres import GrowthState, LostFibre, Resultants
from opticcup_fem.shell.growth import GrowthLaw, SurfacePoints
from opticcup_fem.shell.kernels import Kernel, compile_kernels
from opticcup_fem.shell.section import Section

Array = NDArray[np.float64]
Pressure = Callable[[float], float]
"""Pressure along the outward normal as a function of t_n: positive inflates."""


@dataclass(frozen=True)
class MeridianState:
    """Unknowns of the mixed meridian.

    Attributes:
        r: Positions (r, z) of the nodes, shape (n_nodes, 2).
        angle: Angles of the tangent at the vertices, shape (n_cells + 1,), radians.
        kappa: Coefficients of the curvature b_11, shape (n_cells, degree + 1).
        sigma: Coefficients of its multiplier, 2 pi r_ref M_11, same shape.
    """

    r: Array
    angle: Array
    kappa: Array
    sigma: Array


class MeridianShell:
    """A layered, growing, axisymmetric Kirchhoff-Love shell.

    Attributes:
        mesh: The meridian's mesh.
        sections: Section of every region.
        laws: Growth law of every layer.
        closure: Name of the closure.
        forms: The weak form.
        kernels: Its compiled blocks.
        radius_ref: Reference radius at the quadrature points, shape (n_cells, n_points).
        weights: Reference area of the quadrature points, same shape; they add up to the area.
        balance: The mass balance of layers whose growth it decides on, None where all growth is
            prescribed.
    """

    def __init__(
        self,
        mesh: MeridianMesh,
        sections: Mapping[str, Section],
        laws: Mapping[str, GrowthLaw],
        closure: str = "layer-stretch",
        pressure: Pressure | None = None,
    ) -> None:
        """Set the shell up and compile its kernels.

        Args:
            mesh: Mesh whose regions are the keys of ``sections``.
            sections: Section of every region.
            laws: Growth law of every layer, by layer name, uniform or a function of the reference
                position; it is evaluated at the azimuth 0.
            closure: A key of ``closures.CLOSURES``.
            pressure: Follower pressure as a function of t_n, per current area.
        """
        self.mesh, self.sections, self.laws = mesh, dict(sections), dict(laws)
        self.closure, self.pressure = closure, pressure
        self.forms = AxisymmetricForms(mesh)
        self.kernels: dict[str, Kernel] = compile_kernels(
            MPI.COMM_SELF, self.forms.integrals, mesh.corners()
        )
        points = self.forms.quadrature_points
        self.points: Array = mesh.points(points)
        self.radius_ref: Array = mesh.profile.position(self.points)[..., 0]
        self.circumference: Array = 2 * np.pi * self.radius_ref
        self.weights: Array = (
            self.circumference * self.forms.quadrature_weights * mesh.sizes[:, None]
        )
        self.basis, self.gradient = mesh.tabulate(points, 1)
        self.balance: MassBalance | None = None
        self._law_points = {name: self.points_of(cells) for name, cells in mesh.region.items()}
        element = self.forms.eta.ufl_element().basix_element
        self.curvature_basis: Array = element.tabulate(0, points[:, None])[0, :, :, 0]

    def _points_at(self, s: Array, cells: Indices) -> SurfacePoints:
        """Return points at azimuth 0, for laws that are functions of the position."""
        r, z = np.moveaxis(self.mesh.profile.position(s), -1, 0)
        x = np.stack([r, np.zeros_like(r), z], axis=-1)
        return SurfacePoints(x, None, cells.astype(np.int32), np.zeros((0, 2)))

    def points_of(self, cells: Indices) -> SurfacePoints:
        """Return the quadrature points of some cells, at azimuth 0."""
        return self._points_at(self.points[cells].ravel(), cells)

    @property
    def has_energy(self) -> bool:
        """Whether virtual work is the derivative of an energy (symmetric tangent)."""
        return closures.CLOSURES[self.closure].has_energy

    @property
    def pole(self) -> Array:
        """Pole flags at the ends of the cells, shape (n_cells, 2)."""
        return self.of_ends(self.mesh.is_pole.astype(float))

    def of_ends(self, values: Array) -> Array:
        """Return values at the vertices as values at the cells' ends, shape (n_cells, 2)."""
        return np.stack([values[:-1], values[1:]], axis=1)

    def reference_state(self) -> MeridianState:
        """Return the reference placement with its curvature, without stress.

        It is a state of equilibrium up to the interpolation of the profile on the mesh.
        """
        profile, mesh = self.mesh.profile, self.mesh
        shape = (mesh.n_cells, mesh.degree + 1)
        kappa = np.zeros(shape)
        kappa[:, 0] = profile.curvature / self.curvature_basis[0, 0]
        return MeridianState(
            profile.position(mesh.s), profile.angle(mesh.vertices), kappa, np.zeros(shape)
        )

    def curvature_at(self, state: MeridianState, cell: int, point: float) -> float:
        """Return b_11 at a reference point of a cell."""
        element = self.forms.eta.ufl_element().basix_element
        table = element.tabulate(0, np.array([[point]]))[0, 0, :, 0]
        return float(table @ state.kappa[cell])

    # --- evaluation ---------------------------------------------------------------------------

    def forms_at_points(self, state: MeridianState) -> Array:
        """Return (a_11, a_22, a_12, b_11, b_22, b_12) at the points, (n_cells, n_points, 6)."""
        nodes = state.r[self.mesh.cells]
        x = np.einsum("cqn,cni->cqi", self.basis, nodes)
        d = np.einsum("cqn,cni->cqi", self.gradient, nodes)
        forms = np.zeros((*x.shape[:2], 6))
        forms[..., 0] = np.sum(d * d, axis=-1)
        forms[..., 1] = (x[..., 0] / self.radius_ref) ** 2
        forms[..., 3] = state.kappa @ self.curvature_basis.T
        forms[..., 4] = x[..., 0] * d[..., 1] / (np.sqrt(forms[..., 0]) * self.radius_ref**2)
        return forms

    def growth_at(self, t_n: float, region: str, s: Array | None = None) -> list[GrowthState]:
        """Return the growth of a region's layers, innermost first.

        Args:
            t_n: Normalised time.
            region: Name of the region.
            s: Arc lengths, shape (n,); the quadrature points of the region by default.
        """
        layers = self.sections[region].layers
        states = [self.laws[layer.name](t_n, self._law_points[region]) for layer in layers]
        if s is None:
            return states
        places = self._points_at(s, np.zeros(0, np.int64))
        known = set() if self.balance is None else set(self.balance.layers)
        return [
            GrowthState(*(self.carried(region, value, s) for value in state))
            if layer.name in known
            else self.laws[layer.name](t_n, places)
            for layer, state in zip(layers, states, strict=True)
        ]

    def carried(self, region: str, values: Array | float, s: Array) -> Array:
        """Return values at a region's quadrature points carried on to arc lengths.

        Args:
            region: Name of the region.
            values: Shape (n, ...), the points of a cell one after the other, or one for all.
            s: Arc lengths within the region, its ends included, shape (k,).

        Returns:
            Shape (k, ...), by a quadratic fit on each cell.
        """
        mesh, cells = self.mesh, self.mesh.region[region]
        n = len(cells) * self.points.shape[1]
        values = np.asarray(values, dtype=float)
        if values.ndim == 0 or len(values) != n:
            values = np.broadcast_to(values, (n, *values.shape[1:]))
        inside = np.searchsorted(mesh.vertices[cells[1:]], s, side="right")
        cell = cells[inside]
        x = (s - mesh.vertices[cell]) / mesh.sizes[cell]
        powers = np.arange(3)
        to_powers = np.linalg.pinv(self.forms.quadrature_points[:, None] ** powers)
        fit = x[:, None] ** powers @ to_powers
        per_cell = values.reshape(len(cells), -1, *values.shape[1:])
        return np.asarray(np.einsum("kq,kq...->k...", fit, per_cell[inside]))

    def resultants_of(self, forms: Array, t_n: float, tangent: bool = True) -> Resultants:
        """Return energy, stress and tangent at the quadrature points.

        Args:
            forms: Fundamental forms, shape (n_cells, n_points, 6).
            t_n: Normalised time.
            tangent: Whether the tangent is wanted.

        Raises:
            LostFibre: Some layer has no admissible state; ``index`` counts points of all cells.
        """
        lead = forms.shape[:2]
        energy, stress = np.zeros(lead), np.zeros((*lead, 6))
        stiffness = np.zeros((*lead, 6, 6)) if tangent else None
        a_ref = np.array([1.0, 1.0, 0.0])
        for name, section in self.sections.items():
            cells: Indices = self.mesh.region[name]
            part_forms = forms[cells].reshape(-1, 6)
            try:
                part = closures.resultants(
                    self.closure,
                    section,
                    self.growth_at(t_n, name),
                    part_forms,
                    np.broadcast_to(a_ref, (len(part_forms), 3)),
                    self.mesh.profile.curvature,
                    tangent,
                )
            except LostFibre as lost:
                lost.index += int(cells[0]) * lead[1]
                raise
            energy[cells] = part.energy.reshape(-1, lead[1])
            stress[cells] = part.stress.reshape(-1, lead[1], 6)
            if stiffness is not None and part.tangent is not None:
                stiffness[cells] = part.tangent.reshape(-1, lead[1], 6, 6)
        return Resultants(energy, stress, stiffness)

    def energy(self, state: MeridianState, t_n: float) -> float:
        """Return the energy of a state: strain energy less pressure times volume."""
        forms = self.forms_at_points(state)
        energy = np.sum(self.resultants_of(forms, t_n, tangent=False).energy * self.weights)
        if self.pressure is not None:
            energy -= self.pressure(t_n) * self.volume(state)
        return float(energy)

    def volume(self, state: MeridianState) -> float:
        """Return the volume between the shell and the cone to the origin."""
        nodes = state.r[self.mesh.cells]
        x = np.einsum("cqn,cni->cqi", self.basis, nodes)
        d = np.einsum("cqn,cni->cqi", self.gradient, nodes)
        density = x[..., 0] * (x[..., 1] * d[..., 0] - x[..., 0] * d[..., 1]) / 3
        lengths = self.forms.quadrature_weights * self.mesh.sizes[:, None]
        return float(2 * np.pi * np.sum(density * lengths))

    def kinematic_data(self, state: MeridianState) -> dict[ufl.Coefficient, Array]:
        """Return the coefficients of the kinematic blocks."""
        forms = self.forms
        angle = self.of_ends(state.angle)
        return {
            forms.r: state.r[self.mesh.cells],
            # rotations are measured from the present angles
            forms.alpha: np.zeros_like(angle),
            forms.angle: angle,
            forms.pole: self.pole,
            forms.sigma: state.sigma,
            forms.radius: self.radius_ref,
        }

    def material_data(self, result: Resultants) -> dict[ufl.Coefficient, Array]:
        """Return the coefficients of the material blocks."""
        data = {self.forms.stress: result.stress * self.circumference[..., None]}
        if result.tangent is not None:
            data[self.forms.tangent] = result.tangent * self.circumference[..., None, None]
        return data
