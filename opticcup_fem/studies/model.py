"""From a case to the parts of a computation on the surface model."""

from __future__ import annotations

import math
from functools import partial

from mpi4py import MPI

from opticcup_fem.case import Case, parse_case
from opticcup_fem.case.checks import LAYERS, fields_of
from opticcup_fem.equilibrium.axisymmetric import AxisymmetricStepping
from opticcup_fem.equilibrium.branch import BranchPath, BranchStepping
from opticcup_fem.equilibrium.jumps import make_relaxation
from opticcup_fem.equilibrium.newton import WANDERING, MixedNewton
from opticcup_fem.equilibrium.path import LoadStepping
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.steps import StepControl
from opticcup_fem.equilibrium.transport import surface_balance
from opticcup_fem.mesh import Refinement, SurfaceMesh, cup_mesh, disk_mesh, open_cap_mesh
from opticcup_fem.scalar_fields import ScalarField, require_growth, require_values
from opticcup_fem.shell.balance import BalanceLaw
from opticcup_fem.shell.growth import (
    Array,
    GrowthLaw,
    LinearGrowth,
    PrescribedGrowth,
    SurfacePoints,
    UnevenLayer,
)
from opticcup_fem.shell.imperfection import Imperfection, draw_imperfection
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.section import Layer, Section
from opticcup_fem.shell.supports import free, rigid_modes_of_cup
from opticcup_fem.shell.tissue import Tissue
from opticcup_fem.stimulus import GROWTH, NO_MASS, stimulus_of
from opticcup_fem.studies.contact import contact_of, mirrors_of
from opticcup_fem.studies.stability import critical_points_of

PATIENCE = 25
"""Newton iterations that an axisymmetric state beside a bifurcation may take."""


def sections_of(case: Case) -> dict[str, Section]:
    """Return the sections of cap (IOV inside, ECM outside) and OOV, lengths in R, mu_IOV = 1."""
    material, h = case.material, case.shape.thickness
    m, nu = material.thickness_ratio, material.poisson_ratio
    ecm_points, iov_points, oov_points = material.thickness_points
    iov = Layer("iov", h / (1 + m), 1.0, nu, iov_points)
    ecm = Layer("ecm", h * m / (1 + m), material.modulus_ratio, nu, ecm_points)
    oov = Layer("oov", h, 1.0, nu, oov_points)
    return {"cap": Section([iov, ecm]), "oov": Section([oov])}


def growth_of(case: Case) -> dict[str, GrowthLaw]:
    """Return the growth law of every layer.

    Raises:
        CaseError: A field has values without a meaning somewhere.
    """
    t_end = case.run.t_end
    for key, value in fields_of(case).items():
        field, span = ScalarField(value), _span(case, key[-3:])
        if key.startswith("growth"):
            require_growth(field, key, t_end, span)
        elif key.startswith("material"):
            require_values(field, key, t_end, span, above=0.0)
    return {layer: _law_of(case, layer) for layer in LAYERS}


def _span(case: Case, layer: str) -> tuple[float, float]:
    """Return the first and the last colatitude of a layer; on a disk its radii."""
    alpha = 1.0 if case.shape.kind == "disk" else case.shape.opening_angle
    return (alpha, math.pi) if layer == "oov" else (0.0, alpha)


def _law_of(case: Case, layer: str) -> GrowthLaw:
    rate, stimulus = getattr(case.growth, layer), stimulus_of(case, layer)
    properties = [getattr(case.material, f"{name}_{layer}") for name in ("stiffness", "thickness")]
    law: GrowthLaw
    if isinstance(rate, float) and stimulus in (GROWTH, NO_MASS):
        law = LinearGrowth(rate, stimulus == GROWTH)
    else:
        law = PrescribedGrowth(ScalarField(rate), stimulus)
    if properties == [1.0, 1.0]:
        return law
    return UnevenLayer(law, *map(ScalarField, properties))


def _source(field: ScalarField, t_n: float, points: SurfacePoints, rho: Array) -> Array:
    return field.at(t_n, points.x, rho)


def _diffusivity(field: ScalarField, t_n: float, points: SurfacePoints) -> Array:
    return field.at(t_n, points.x)


def balance_laws_of(case: Case) -> dict[str, BalanceLaw]:
    """Return what changes the mass of every layer whose mass balance is to be solved.

    Raises:
        CaseError: A diffusivity is not a number of 0 or more somewhere.
    """
    laws = {}
    for layer in LAYERS:
        keys = getattr(case.mass, layer)
        if keys.source == "":
            continue
        source, diffusivity, edge_flux = map(
            ScalarField, (keys.source, keys.diffusivity, keys.edge_flux)
        )
        key = f"mass.{layer}.diffusivity"
        require_values(diffusivity, key, case.run.t_end, _span(case, layer), above=-1e-300)
        laws[layer] = BalanceLaw(
            stimulus_of(case, layer),
            partial(_source, source),
            None if diffusivity.is_zero else partial(_diffusivity, diffusivity),
            None if edge_flux.is_zero else edge_flux.at,
        )
    return laws


def with_slenderness(case: Case, ratio: float) -> Case:
    """Return a case with another R/h; the stiffness of contact, of order (h/R)^2, goes with it."""
    tables = case.model_dump(mode="json")
    tables["contact"]["stiffness"] *= (case.shape.radius_over_thickness / ratio) ** 2
    tables["shape"]["radius_over_thickness"] = ratio
    return parse_case(tables)


def tissue_of(case: Case) -> Tissue:
    """Return layers and growth of a case, to run it with others in their place."""
    return Tissue(sections_of(case), growth_of(case))


def remarks_on(tissue: Tissue | None) -> dict[str, str]:
    """Return what the record of a case must say of a tissue that is not the case's."""
    return {} if tissue is None else {"layers and growth:": "given from Python, not those below"}


def imperfection_of(case: Case) -> Imperfection | None:
    """Return the imperfection of a case, lengths in R; None for a perfect shell."""
    keys = case.imperfection
    if keys.amplitude == 0:
        return None
    return draw_imperfection(keys.wavenumber, keys.amplitude * case.shape.thickness, keys.seed)


def mesh_of(case: Case, comm: MPI.Comm) -> SurfaceMesh:
    """Mesh the shape of a case (collective)."""
    mesh, kind = case.mesh, case.shape.kind
    if kind != "cup":
        sizes = (mesh.cell_size_cap, mesh.cell_size_interface, mesh.seed, comm)
        return (
            disk_mesh(1.0, *sizes)
            if kind == "disk"
            else open_cap_mesh(case.shape.opening_angle, *sizes)
        )
    return cup_mesh(
        case.shape.opening_angle,
        mesh.cell_size_cap,
        mesh.cell_size_interface,
        mesh.cell_size_oov,
        seed=mesh.seed,
        comm=comm,
        symmetry=mesh.symmetry,
        refinements=[
            Refinement(
                math.radians(spot.colatitude_deg),
                math.radians(spot.azimuth_deg),
                spot.extent,
                spot.cell_size,
            )
            for spot in mesh.refinements
        ],
    )


def shell_of(case: Case, comm: MPI.Comm, tissue: Tissue | None = None) -> Shell:
    """Return the shell of a case, of another tissue if one is given (collective)."""
    own = tissue or tissue_of(case)
    shell = Shell(
        mesh_of(case, comm),
        own.sections,
        own.laws,
        case.material.closure,
        imperfection=imperfection_of(case),
    )
    laws = balance_laws_of(case) if tissue is None else {}
    if laws:
        surface_balance(shell, laws, case.mass.tolerance)
    return shell


Stepping = LoadStepping | BranchStepping


def stepping_of(case: Case, shell: Shell) -> Stepping:
    """Return what follows the path that a case asks for (collective)."""
    solver = case.solver
    contact = contact_of(case, shell)
    beside_obstacles = contact is not None and contact.has_obstacles
    held = free(shell) if beside_obstacles else rigid_modes_of_cup(shell)
    problem = Problem(shell, held, contact, mirrors_of(case))
    iterations, wandering = solver.max_iterations, WANDERING
    if case.run.follow != "stable":  # beside a bifurcation a good iteration is long, and wanders
        iterations, wandering = max(PATIENCE, iterations), math.inf
    newton = MixedNewton(problem, solver.tolerance, iterations, wandering)
    control = StepControl(
        initial=solver.initial_step,
        largest=solver.max_step,
        smallest=solver.min_step,
        growth=solver.growth_factor,
        max_move=solver.max_move,
    )
    relaxation, critical = make_relaxation(problem, newton), critical_points_of(shell, newton)
    if case.run.follow == "stable":
        wavenumber = case.run.switch_wavenumber
        return LoadStepping(problem, newton, relaxation, control, critical, wavenumber)
    stem = AxisymmetricStepping(problem, newton, relaxation, control, critical)
    if case.run.follow == "axisymmetric":
        return stem
    return BranchStepping(stem, BranchPath(problem, critical))
