"""The shell: geometry, layers, growth and closure, and what a state of it amounts to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np
import ufl
from numpy.typing import NDArray

from opticcup_fem.mesh import SurfaceMesh
from opticcup_fem.shell import closures, condensation
from opticcup_fem.shell.balance import MassBalance
from opticcup_fem.shell.condensation import CondensedCells
from opticcup_fem.shell.directors import EdgeDirectors
from opticcup_fem.shell.external_work import ExternalWork
from opticcup_fem.shell.fibres import GrowthState, LostFibre, Resultants
from opticcup_fem.shell.forms import ShellForms
from opticcup_fem.shell.growth import GrowthLaw, SurfacePoints
from opticcup_fem.shell.kernels import compile_kernels
from opticcup_fem.shell.loads import Load, LoadSites
from opticcup_fem.shell.section import Section
from opticcup_fem.shell.spaces import ShellSpaces

Array = NDArray[np.float64]


LostPlace = tuple[LostFibre, Array]
"""A lost fibre and the place of its point on the current mid-surface, shape (3,)."""


@dataclass(frozen=True)
class ContactData:
    """What contact keeps fixed while a state is solved for (see ``contact.model``).

    Attributes:
        heights: Heights of the inner and the outer face over the nodes of the cells, shape
            (n_cells, n_cell_nodes, 2).
        time: Normalised time at which moving obstacles stand.
        touches: Whether anything is within the barrier's reach.
    """

    heights: Array
    time: float
    touches: bool


@dataclass(frozen=True)
class ShellState:
    """Unknowns of the mixed shell on one rank (owned and ghost), with the lagged directors.

    Attributes:
        r: Positions of the nodes, shape (n_nodes, 3).
        alpha: Director angles at the edges' Gauss points, shape (n_edges, k), radians.
        director: Lagged directors d_0 there, shape (n_edges, k, 3).
        kappa: Coefficients of the curvature, shape (n_cells, n_k).
        sigma: Coefficients of its multiplier (the moments), shape (n_cells, n_k).
        contact: Lagged data of contact, where it is resisted.
    """

    r: Array
    alpha: Array
    director: Array
    kappa: Array
    sigma: Array
    contact: ContactData | None = None

    def plus(self, step: ShellState, factor: float = 1.0) -> ShellState:
        """Return this state moved by ``factor`` times ``step``; the directors stay."""
        return replace(
            self,
            r=self.r + factor * step.r,
            alpha=self.alpha + factor * step.alpha,
            kappa=self.kappa + factor * step.kappa,
            sigma=self.sigma + factor * step.sigma,
        )

    def minus(self, other: ShellState) -> ShellState:
        """Return the difference to ``other``; angles are relative to each one's directors."""
        return self.plus(other, -1.0)


@dataclass(frozen=True)
class _Region:
    """Cells that share a section."""

    name: str
    section: Section
    cells: NDArray[np.int32]
    points: SurfacePoints


class Shell:
    """A layered, growing Kirchhoff-Love shell on a surface mesh.

    Attributes:
        surface_mesh: The mesh and its smooth surface.
        sections: Section of every region.
        closure: Name of the closure.
        spaces: Finite-element spaces.
        reference: Positions of the nodes on the smooth surface, which name the shell's points,
            shape (n_nodes, 3).
        rest: Positions without membrane stress before growth, (n_nodes, 3); those on the smooth
            surface unless the shell has an imperfection.
        growth: Growth of each layer of each region at the present t_n.
        balance: The mass balance of layers whose growth it decides on, None where all growth is
            prescribed.
        external: The loads, None where there are none.
    """

    def __init__(
        self,
        surface_mesh: SurfaceMesh,
        sections: Mapping[str, Section],
        laws: Mapping[str, GrowthLaw],
        closure: str = "layer-stretch",
        degree: int = 3,
        loads: Sequence[Load] = (),
        imperfection: Callable[[Array], Array] | None = None,
    ) -> None:
        """Set the shell up in its reference position and compile its kernels (collective).

        Args:
            surface_mesh: Mesh whose regions are the keys of ``sections``.
            sections: Section of every region.
            laws: Growth law of every layer, by layer name.
            closure: A key of ``closures.CLOSURES``.
            degree: Polynomial degree of the position.
            loads: Loads on the shell, see ``loads``.
            imperfection: Displacement (n, 3) of points (n, 3) of the smooth surface to where the
                shell has no membrane stress; its stress-free curvature stays the surface's.

        Raises:
            CaseError: A load has no usable value.
            MeshError: A load names a curve or region that the mesh lacks.
        """
        self.surface_mesh, self.sections, self.closure = surface_mesh, dict(sections), closure
        self.laws = dict(laws)
        self.comm: MPI.Intracomm = surface_mesh.mesh.comm
        self.spaces = ShellSpaces(surface_mesh.mesh, surface_mesh.orientation(), degree)
        self.reference: Array = (
            surface_mesh.reference_position(self.spaces.position).x.array.reshape(-1, 3).copy()
        )
        self.rest: Array = self.reference
        if imperfection is not None:
            self.rest = self.reference + imperfection(self.reference)
        self.directors = EdgeDirectors(self.spaces)
        self.forms = ShellForms(self.spaces)
        self.kernels = compile_kernels(self.comm, self.forms.integrals, self.spaces.coordinates)
        self._tabulate()
        self._regions = self._find_regions()
        self.growth: dict[str, list[GrowthState]] = {}
        self.balance: MassBalance | None = None
        self.external: ExternalWork | None = None
        if loads:
            sites = LoadSites.of(surface_mesh, self.spaces, self.rest)
            self.external = ExternalWork(loads, self.forms, sites)
        self.set_time(0.0)

    def _tabulate(self) -> None:
        """Tables at the cell quadrature points."""
        points = self.forms.quadrature_points
        self._gradient = self.spaces.gradient_operator(points)
        self.a_ref = self.spaces.metric(self.rest[self.spaces.nodes], self._gradient)
        a_11, a_22, a_12 = np.moveaxis(self.a_ref, -1, 0)
        self.area_ref = np.sqrt(a_11 * a_22 - a_12**2)
        self.weights = self.forms.quadrature_weights * self.spaces.det_j[:, None] * self.area_ref
        self.curvature_basis = self.spaces.curvature_table(points)

    def nodal_areas(self) -> Array:
        """Return the integral of each node's basis function over its cell, (n_cells, n_nodes)."""
        points = self.forms.quadrature_points
        return np.einsum("cq,qn->cn", self.weights, self.spaces.position_table(points))

    def _find_regions(self) -> list[_Region]:
        mesh = self.surface_mesh
        regions = []
        for name, section in self.sections.items():
            cells = np.sort(mesh.cell_tags.find(mesh.regions[name]))
            cells = cells[cells < self.spaces.n_cells].astype(np.int32)
            regions.append(_Region(name, section, cells, self.points_of(cells)))
        return regions

    def _surface_points(self, cells: NDArray[np.int32], points: Array) -> SurfacePoints:
        basis = self.spaces.position_table(points)
        x = np.einsum("qn,cni->cqi", basis, self.reference[self.spaces.nodes[cells]])
        return SurfacePoints(x.reshape(-1, 3), self.surface_mesh.mesh, cells, points)

    def points_of(self, cells: NDArray[np.int32]) -> SurfacePoints:
        """Return the quadrature points of some cells."""
        return self._surface_points(cells, self.forms.quadrature_points)

    def solve_balance(self, balance: MassBalance) -> None:
        """Let some layers grow by their mass balance from now on."""
        self.balance = balance
        balance.take_over(self.laws)
        self.set_time(self.t_n)

    def growth_at(self, region: str, points: Array) -> list[GrowthState]:
        """Return the present growth of a region's layers at reference points of its cells."""
        places = self._surface_points(self.region_cells(region), points)
        layers = self.sections[region].layers
        return [self.laws[layer.name](self.t_n, places) for layer in layers]

    def region_cells(self, name: str) -> NDArray[np.int32]:
        """Return the owned cells of a region."""
        return next(region.cells for region in self._regions if region.name == name)

    @property
    def thickness(self) -> float:
        """Largest total thickness of the sections."""
        return max(section.thickness for section in self.sections.values())

    @property
    def has_energy(self) -> bool:
        """Whether virtual work is the derivative of an energy (symmetric tangent)."""
        loads_have = self.external is None or self.external.has_potential
        return closures.CLOSURES[self.closure].has_energy and loads_have

    def set_time(self, t_n: float) -> None:
        """Set the growth of every layer, and the loads, to normalised time ``t_n``."""
        self.t_n = t_n
        if self.external is not None:
            self.external.set_time(t_n)
        self.growth = {
            region.name: [
                self.laws[layer.name](t_n, region.points) for layer in region.section.layers
            ]
            for region in self._regions
        }

    def reference_state(self) -> ShellState:
        """Return the ungrown shell at rest; its curvature is that of its place.

        It is free of stress, if it has no imperfection.
        """
        spaces = self.spaces
        state = ShellState(
            self.rest.copy(),
            np.zeros((spaces.n_edges, spaces.degree)),
            self.directors.mean_normals(self.rest),
            np.zeros((spaces.n_cells, spaces.n_curvature)),
            np.zeros((spaces.n_cells, spaces.n_curvature)),
        )
        return replace(state, kappa=self.curvature_of(state))

    # --- states -------------------------------------------------------------------------------

    def curvature_of(self, state: ShellState) -> Array:
        """Return kappa = L/d, the curvature of position and directors."""
        functional = condensation.curvature_functional(self.kernels, self._kinematic_data(state))
        return functional / self.spaces.det_j[:, None]

    def with_local_equilibrium(self, state: ShellState) -> ShellState:
        """Return the state whose kappa and sigma solve the local equations for its (r, alpha)."""
        state = replace(state, kappa=self.curvature_of(state))
        data = self._kinematic_data(state) | self._material_data(
            self.resultants(state, tangent=False)
        )
        sigma = self.kernels["Fk"](data) / self.spaces.det_j[:, None]
        return replace(state, sigma=sigma)

    def with_updated_directors(self, state: ShellState) -> ShellState:
        """Return the same state with d_0 set to the present mean normals, alpha re-expressed."""
        director = self.directors.mean_normals(state.r)
        alpha = self.directors.re_expressed(state.r, state.alpha, state.director, director)
        return replace(state, alpha=alpha, director=director)

    def with_mean_directors(self, state: ShellState) -> ShellState:
        """Return ``state`` with d_0 set to the mean normals and alpha kept as it is.

        For predictors: angles are extrapolated relative to the rotating mean normals.
        """
        return replace(state, director=self.directors.mean_normals(state.r))

    # --- evaluation ---------------------------------------------------------------------------

    def forms_at_points(self, state: ShellState) -> Array:
        """Return (a, kappa) at the cell quadrature points, shape (n_cells, n_points, 6)."""
        a = self.spaces.metric(state.r[self.spaces.nodes], self._gradient)
        kappa = state.kappa.reshape(self.spaces.n_cells, -1, 3)
        return np.concatenate([a, np.einsum("qb,cbi->cqi", self.curvature_basis, kappa)], axis=-1)

    def resultants(self, state: ShellState, tangent: bool = True) -> Resultants:
        """Return energy, stress and tangent at all cell quadrature points.

        Returns:
            Arrays of leading shape (n_cells, n_points).

        Raises:
            LostFibre: Some layer has no admissible state; ``index`` counts points of all cells.
        """
        forms = self.forms_at_points(state)
        lead = forms.shape[:2]
        energy, stress = np.zeros(lead), np.zeros((*lead, 6))
        stiffness = np.zeros((*lead, 6, 6)) if tangent else None
        for region in self._regions:
            cells = region.cells
            if len(cells) == 0:
                continue
            try:
                part = closures.resultants(
                    self.closure,
                    region.section,
                    self.growth[region.name],
                    forms[cells].reshape(-1, 6),
                    self.a_ref[cells].reshape(-1, 3),
                    self.surface_mesh.surface.curvature,
                    tangent,
                )
            except LostFibre as lost:
                cell, point = divmod(lost.index, lead[1])
                lost.index = int(cells[cell]) * lead[1] + point
                raise
            energy[cells] = part.energy.reshape(-1, lead[1])
            stress[cells] = part.stress.reshape(-1, lead[1], 6)
            if stiffness is not None and part.tangent is not None:
                stiffness[cells] = part.tangent.reshape(-1, lead[1], 6, 6)
        return Resultants(energy, stress, stiffness)

    def evaluate(
        self, state: ShellState, tangent: bool = True
    ) -> tuple[Resultants | None, LostPlace | None]:
        """Return the resultants, or a lost fibre of some rank (collective).

        Returns:
            (resultants, None) on every rank, or (None, the fibre and its place) on every rank.
        """
        result: Resultants | None = None
        found: LostPlace | None = None
        try:
            result = self.resultants(state, tangent)
        except LostFibre as lost:
            cell, point = divmod(lost.index, len(self.forms.quadrature_points))
            basis = self.spaces.position_table(self.forms.quadrature_points)[point]
            found = (lost, basis @ state.r[self.spaces.nodes[cell]])
        everywhere = [item for item in self.comm.allgather(found) if item is not None]
        return (None, everywhere[0]) if everywhere else (result, None)

    def energy(self, state: ShellState) -> float:
        """Return the energy of ``state`` (with its own kappa), collective.

        Strain energy plus the potential of the loads; strain energy alone where they have none.
        """
        energy = float(np.sum(self.resultants(state, tangent=False).energy * self.weights))
        if self.external is not None and self.external.has_potential:
            energy -= self.external.work(self._kinematic_data(state))
        return float(self.comm.allreduce(energy))

    def gradient(self, state: ShellState) -> Array:
        """Return the cell gradients in (r, alpha) of a state in local equilibrium."""
        data = self._kinematic_data(state) | self._material_data(
            self.resultants(state, tangent=False)
        )
        return condensation.condensed_gradient(self.kernels, data, self.spaces.det_j, self.external)

    def condensed(self, state: ShellState, resultants: Resultants | None = None) -> CondensedCells:
        """Return the condensed cell systems at ``state``.

        Args:
            state: The state.
            resultants: Its resultants with tangent, where they are known already.

        Raises:
            LostFibre: On the rank that has the lost fibre.
        """
        resultants = resultants or self.resultants(state)
        data = self._kinematic_data(state) | self._material_data(resultants)
        symmetric = closures.CLOSURES[self.closure].has_energy
        return condensation.condense(
            self.kernels, data, self.spaces.det_j, state.kappa, symmetric, self.external
        )

    def _kinematic_data(self, state: ShellState) -> dict[ufl.Coefficient, Array]:
        forms, spaces = self.forms, self.spaces
        return {
            forms.orientation: spaces.orientation,
            forms.sign: spaces.edge_sign,
            forms.r: state.r[spaces.nodes],
            forms.alpha: self.directors.per_cell(state.alpha),
            forms.director: self.directors.per_cell(state.director),
            forms.sigma: state.sigma,
        }

    def _material_data(self, result: Resultants) -> dict[ufl.Coefficient, Array]:
        data = {self.forms.stress: result.stress * self.area_ref[..., None]}
        if result.tangent is not None:
            data[self.forms.tangent] = result.tangent * self.area_ref[..., None, None]
        return data
