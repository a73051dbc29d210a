"""The tables of a case: keys, units, and defaults.

Every key has its unit and meaning in its `Field` description; the same text appears in error
messages and as comments in the resolved case. Names, units and defaults are those of
docs/theory.md.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from opticcup_fem.case.checks import CROSS_CHECKS, why_not_resisted
from opticcup_fem.case.field_values import NonNegativeRate, Profile, Rate, Share, Source

Closure = Literal["layer-stretch", "paper", "closed-form", "condensed"]
Positive = Annotated[float, Field(gt=0)]
Ratio = Annotated[float, Field(ge=1e-6, le=1e6)]
CellSize = Annotated[float, Field(ge=1e-3)]
Seed = Annotated[int, Field(ge=0, le=2**31 - 1)]
PointCount = Annotated[int, Field(ge=1, le=64)]


class _Table(BaseModel):
    # Strict: TOML has types, so "5" or true for a number is a mistake and not a spelling of it.
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Shape(_Table):
    """The stress-free shell before growth: a sphere of radius R with a bilayer cap."""

    kind: Literal["cup", "cap", "disk"] = Field(
        default="cup",
        description="cup: closed sphere, cap and OOV; meridian also cap: cap alone, disk: flat cap",
    )
    radius_over_thickness: float = Field(
        default=5.0, ge=2, le=1000, description="R/h, radius of sphere or disk over thickness"
    )
    # From 5: a cap must hold a few cells. To 90: beyond it the "cap" is the larger part, has no
    # rim to invaginate through, and the depth D loses its meaning.
    opening_angle_deg: float = Field(
        default=40.0, ge=5, le=90, description="alpha in degrees, colatitude of the cap's edge"
    )
    radius_um: Positive = Field(default=50.0, description="R in micrometres, only scales pictures")

    @property
    def thickness(self) -> float:
        """Total thickness h in units of R."""
        return 1.0 / self.radius_over_thickness

    @property
    def opening_angle(self) -> float:
        """Opening angle alpha in radians."""
        return math.radians(self.opening_angle_deg)

    @property
    def theta_bar(self) -> float:
        """Depth and slenderness of the cap, theta_bar = alpha sqrt(R/h)."""
        return self.opening_angle * math.sqrt(self.radius_over_thickness)


def _default_thickness_points(data: dict[str, Any]) -> tuple[int, int, int]:
    # For `paper` the rule is part of the model: it loses its root earlier with points nearer to
    # the faces, and its reference numbers belong to (2, 3, 3).
    return (2, 3, 3) if data.get("closure") == "paper" else (2, 5, 5)


class Material(_Table):
    """Layers and their law; the stress unit is the shear modulus of the IOV."""

    thickness_ratio: Ratio = Field(default=1 / 9, description="m = h_ECM/h_IOV in the cap")
    modulus_ratio: Ratio = Field(default=50.0, description="n = mu_ECM/mu_IOV; mu_OOV = mu_IOV")
    poisson_ratio: float = Field(
        default=0.45, ge=0, le=0.5, description="nu of every layer; 0.5 is incompressible, J = 1"
    )
    closure: Closure = Field(
        default="layer-stretch", description="which lambda_3 feeds the kinematics"
    )
    thickness_points: tuple[PointCount, PointCount, PointCount] = Field(
        default_factory=_default_thickness_points,
        strict=False,  # a TOML array is a list
        description="Gauss points through ECM, IOV, OOV",
    )
    stiffness_ecm: Share = Field(
        default=1.0, description="factor on the modulus of the ECM: number, table, formula"
    )
    stiffness_iov: Share = Field(default=1.0, description="the same of the IOV")
    stiffness_oov: Share = Field(default=1.0, description="the same of the OOV")
    thickness_ecm: Profile = Field(
        default=1.0, description="factor on the thickness of the ECM at rest: number, formula"
    )
    thickness_iov: Profile = Field(default=1.0, description="the same of the IOV")
    thickness_oov: Profile = Field(default=1.0, description="the same of the OOV")


class Growth(_Table):
    """In-plane growth factors of the layers, e = 1 + rate t_n.

    A rate is a number, a table in t_n or a formula in theta, phi, t_n.
    """

    ecm: Rate = Field(default=0.0, description="rate of the ECM: number, table, formula")
    iov: Rate = Field(default=5.0, description="rate of the IOV")
    oov: Rate = Field(default=1.5, description="rate of the OOV")
    mass_change: bool = Field(
        default=True, description="true: density-preserving growth, stress factor e^2; false: 1"
    )


Kind = Literal["default", "growth", "other", "swelling", "heating"]


class LayerMass(_Table):
    """What makes a layer grow, and what that does to its stress.

    With a ``source`` its mass balance is solved, (S9), and its growth rate is not used.
    """

    kind: Kind = Field(
        default="default",
        description="growth: by the same material; other: by another; swelling; heating; default: "
        "growth, or swelling with growth.mass_change = false",
    )
    source: Source = Field(
        default="", description="S per volume in rho_0 per t_n: number, table, formula also in rho"
    )
    diffusivity: NonNegativeRate = Field(
        default=0.0, description="D in R^2 per t_n: number, table, formula"
    )
    edge_flux: Rate = Field(
        default=0.0, description="mass that leaves by the layer's edge, in rho_0 R per t_n"
    )
    specific_volume: float = Field(
        default=1.0, gt=0, description="v_m in 1/rho_0; 1 preserves the density"
    )
    stiffness: float = Field(
        default=0.0, ge=0, description="other: energy per mass of what is added, over the tissue's"
    )


class Mass(_Table):
    """Mass balance and kind of growth of every layer."""

    ecm: LayerMass = Field(default=LayerMass(), description="of the ECM")
    iov: LayerMass = Field(default=LayerMass(), description="of the IOV")
    oov: LayerMass = Field(default=LayerMass(), description="of the OOV")
    tolerance: float = Field(
        default=1e-5, gt=0, lt=1e-3, description="change of e that ends the iteration of a step"
    )


class Imperfection(_Table):
    """A deliberate imperfection of the mid-surface, on the surface model."""

    amplitude: float = Field(
        default=0.0, ge=0, le=2, description="of the radial wave sin^k theta cos(m phi), in h"
    )
    wavenumber: int = Field(
        default=2, ge=0, le=20, description="m, 2 or more; 0: a random mixture of m = 2 .. 8"
    )
    seed: Seed = Field(default=1, description="seed of phase and mixture")


class Run(_Table):
    """Which discretisation, and how far."""

    model: Literal["surface", "meridian"] = Field(
        default="surface",
        description="discretisation: whole surface, or axisymmetric",
    )
    follow: Literal["stable", "axisymmetric", "branch"] = Field(
        default="stable",
        description="surface: what a tissue would do; the axisymmetric states, stable or not; "
        "these up to the first loss of symmetry and then the branch that leaves them",
    )
    switch_wavenumber: int = Field(
        default=0,
        ge=0,
        le=16,
        description="surface: m of the mode along which a lost symmetry is left; 0, the critical",
    )
    keep_mirrors: bool = Field(
        default=False,
        description="surface: keep x = 0 and y = 0 mirror planes of the deformation, and count "
        "stability for motions that do",
    )
    max_wavenumber: int = Field(
        default=8, ge=2, le=40, description="meridian: stability is counted for m = 0 .. this"
    )
    t_end: float = Field(
        default=1.0, gt=0, le=100, description="last normalised time t_n; 1 is 20 h in the chick"
    )


class RefinementTable(_Table):
    """A disc on the sphere with smaller cells, which grow around it; lengths in units of R."""

    colatitude_deg: float = Field(ge=0, le=180, description="colatitude of its centre in degrees")
    azimuth_deg: float = Field(default=0.0, description="azimuth of its centre in degrees")
    extent: float = Field(
        default=0.2, ge=0, le=1, description="from its centre to its edge, along the sphere"
    )
    cell_size: CellSize = Field(description="cell size in it")


class Mesh(_Table):
    """Surface mesh, sizes in units of R; the meridian's follows from R/h.

    The default of ``cell_size_oov`` follows the width sqrt(R h) of the boundary layers in which
    the OOV bends, 0.3 sqrt(5 h/R), never above 0.3 (docs/decisions/0009-mesh-sizes.md).  That of
    ``symmetry`` follows ``run.follow`` (docs/decisions/0039-symmetric-meshes.md).
    """

    cell_size_cap: CellSize = Field(default=0.33, description="cell size at the apex, in R")
    cell_size_oov: CellSize = Field(
        default=0.30, description="cell size away from the cap, in R; default 0.3 sqrt(5 h/R)"
    )
    cell_size_interface: CellSize = Field(
        default=0.09, description="cell size at theta = alpha, in R"
    )
    seed: Seed = Field(default=1, description="seed of the mesh generator")
    symmetry: int = Field(
        default=4,
        ge=0,
        le=8,
        description="mirror planes through the axis: with 2 m of them a loss of symmetry in m is "
        'sharp; default 4, with run.follow = "stable" none, unless mirrors are kept',
    )
    refinements: tuple[RefinementTable, ...] = Field(
        default=(),
        strict=False,  # a TOML array is a list
        description="discs of smaller cells, and their mirror images: colatitude_deg, cell_size, "
        "azimuth_deg, extent",
    )


class Solver(_Table):
    """Load stepping in t_n and Newton's method; the meridian's arc length has steps of its own."""

    initial_step: Positive = Field(default=0.01, description="first step in t_n")
    max_step: Positive = Field(default=0.1, description="largest step in t_n")
    min_step: float = Field(
        default=1e-4,
        ge=1e-9,
        description="smallest step in t_n: limit points are located this closely",
    )
    growth_factor: float = Field(
        default=1.5, gt=1, le=10, description="growth of the step on success"
    )
    max_iterations: int = Field(
        default=15, ge=1, le=1000, description="most Newton iterations a step"
    )
    tolerance: float = Field(
        default=1e-8, gt=0, lt=1, description="Newton tolerance, residual in mu_IOV R^2"
    )
    max_move: Positive = Field(default=0.4, description="largest move of a node a step, in R")


Point = Annotated[tuple[float, float, float], Field(strict=False)]


class ObstacleTable(_Table):
    """A rigid body; lengths in units of R, the cup's centre at the origin, its apex along z."""

    kind: Literal["plate", "box", "sphere"] = Field(description="what it is")
    centre: Point = Field(description="its centre at t_n = 0")
    normal: Point = Field(default=(0.0, 0.0, 1.0), description="plate: normal to it")
    width: Positive = Field(default=8.0, description="plate: length of its sides")
    sides: Point = Field(default=(1.0, 1.0, 1.0), description="box: lengths along x, y, z")
    radius: Positive = Field(default=0.5, description="sphere: its radius")
    velocity: Point = Field(default=(0.0, 0.0, 0.0), description="velocity per unit of t_n")


class ContactTable(_Table):
    """Contact of the shell with itself and with rigid obstacles.

    Contact is resisted where it can be (docs/decisions/0045-contact-is-resisted.md): on the
    surface, with ``run.follow = "stable"`` and a closure that has an energy; elsewhere it ends the
    run.  The default of ``stiffness`` is 50 (h/R)^2 (docs/decisions/0018-contact-barrier.md), that
    of ``subdivision`` follows the cells (docs/decisions/0047-points-for-closed-shells.md).
    """

    mode: Literal["off", "stop", "resist"] = Field(
        default="resist",
        description="look away, end the run, or push back; default resist, stop where it cannot",
    )
    stop_at: Literal["mid-surface", "thickness"] = Field(
        default="mid-surface", description="stop: what must meet, mid-surfaces or layers' faces"
    )
    distance: float = Field(
        default=0.2,
        gt=0,
        le=1,
        description="resist: gap at which the barrier begins, in h; less on small cells",
    )
    stiffness: Positive = Field(
        default=2.0, description="resist: stress scale of the barrier; default 50 (h/R)^2"
    )
    subdivision: int = Field(
        default=3,
        ge=1,
        le=12,
        description="resist: triangles along each cell's edge by which collisions are found; by "
        "default so many that they are .8 h long in the OOV, 3 to 6, and 3 beside obstacles",
    )
    obstacles: tuple[ObstacleTable, ...] = Field(
        default=(),
        strict=False,  # a TOML array is a list
        description="rigid bodies: kind (plate, box or sphere), centre, and what a kind needs",
    )


class Output(_Table):
    """What is written."""

    times: tuple[Annotated[float, Field(ge=0)], ...] = Field(
        default=(),
        strict=False,  # a TOML array is a list
        description="t_n landed on exactly, with fields; default every 0.1 to t_end",
    )
    fields: bool = Field(default=True, description="fields for ParaView at output.times")
    states: bool = Field(default=True, description="keep every state, for movies and pages")
    picture: bool = Field(default=True, description="write the pictures")


class Case(_Table):
    """One run, complete and checked; immutable.

    Build it with `load_case` or `parse_case`, which turn every mistake into a `CaseError`;
    the constructor itself raises pydantic's `ValidationError`.
    """

    shape: Shape = Field(default=Shape(), description="geometry")
    material: Material = Field(default=Material(), description="layers and closure")
    growth: Growth = Field(default=Growth(), description="growth factors e = 1 + rate t_n")
    mass: Mass = Field(default=Mass(), description="mass balance, kinds of growth")
    imperfection: Imperfection = Field(
        default=Imperfection(), description="surface model only: of the mid-surface"
    )
    run: Run = Field(default=Run(), description="discretisation and last time")
    mesh: Mesh = Field(
        default=Mesh(), validate_default=True, description="surface model only: mesh"
    )
    solver: Solver = Field(default=Solver(), description="surface model only: steps, Newton")
    contact: ContactTable = Field(
        default=ContactTable(), validate_default=True, description="surface: contact"
    )
    output: Output = Field(default=Output(), validate_default=True, description="what is written")

    @field_validator("contact", mode="after")
    @classmethod
    def _resolve_contact(cls, contact: ContactTable, info: ValidationInfo) -> ContactTable:
        # The defaults follow the thickness, the cells, the model and the closure.
        if not {"shape", "material", "run", "mesh"} <= info.data.keys():
            return contact
        given, defaults = contact.model_fields_set, dict[str, Any]()
        h, closure = info.data["shape"].thickness, info.data["material"].closure
        if "mode" not in given and why_not_resisted(info.data["run"], closure):
            defaults["mode"] = "stop"
        if "distance" not in given:
            largest = info.data["mesh"].cell_size_interface / h
            defaults["distance"] = min(contact.distance, math.floor(1000 * largest) / 1000)
        if "stiffness" not in given:
            defaults["stiffness"] = float(f"{50 * h * h:.4g}")
        if "subdivision" not in given and not contact.obstacles:
            # flat triangles cut the corners of folds that are a thickness wide
            wanted = math.ceil(info.data["mesh"].cell_size_oov / (0.8 * h))
            defaults["subdivision"] = min(max(contact.subdivision, wanted), 6)
        return contact.model_copy(update=defaults)

    @field_validator("output", mode="after")
    @classmethod
    def _resolve_times(cls, output: Output, info: ValidationInfo) -> Output:
        # The default follows run.t_end, which another table holds.
        if "times" in output.model_fields_set or "run" not in info.data:
            return output
        t_end = info.data["run"].t_end
        count = math.floor(10 * t_end + 1e-9)
        times = [k / 10 for k in range(count + 1)]
        if t_end - times[-1] > 1e-9:
            times.append(t_end)
        return output.model_copy(update={"times": tuple(times)})

    @field_validator("mesh", mode="after")
    @classmethod
    def _resolve_sizes(cls, mesh: Mesh, info: ValidationInfo) -> Mesh:
        # The defaults follow the thickness, which another table holds.
        if "shape" not in info.data:
            return mesh
        given = mesh.model_fields_set
        sizes: dict[str, float] = {}
        if "cell_size_oov" not in given:
            sizes["cell_size_oov"] = round(
                min(0.3, 0.3 * (5 * info.data["shape"].thickness) ** 0.5), 4
            )
        oov = sizes.get("cell_size_oov", mesh.cell_size_oov)
        if "cell_size_cap" not in given:
            sizes["cell_size_cap"] = min(mesh.cell_size_cap, info.data["shape"].opening_angle / 2)
        if "cell_size_interface" not in given:
            sizes["cell_size_interface"] = min(mesh.cell_size_interface, round(0.4 * oov, 4))
        return mesh.model_copy(update=sizes)

    @field_validator("mesh", mode="after")
    @classmethod
    def _resolve_symmetry(cls, mesh: Mesh, info: ValidationInfo) -> Mesh:
        # What a tissue would do starts from a mesh that is no more symmetric than a tissue.
        if "symmetry" in mesh.model_fields_set or "run" not in info.data:
            return mesh
        run = info.data["run"]
        return mesh.model_copy(
            update={"symmetry": 4 * (run.follow != "stable" or run.keep_mirrors)}
        )

    @model_validator(mode="after")
    def _cross_checks(self) -> Self:
        for check in CROSS_CHECKS:
            check(self)
        return self
