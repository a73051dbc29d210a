"""Checks of a case across its keys, each one sentence: the key, its value, what is allowed."""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING

from opticcup_fem.errors import CaseError
from opticcup_fem.expressions import variables_of

if TYPE_CHECKING:
    from opticcup_fem.case.field_values import FieldValue
    from opticcup_fem.case.tables import Case, Run

# About a thousand times the baseline's mesh: beyond it, a size is taken for a slip of the pen.
MOST_CELLS = 500_000


def show(value: object) -> str:
    """Return a value as a user writes it in TOML.

    >>> show([True, "a", 0.5])
    '[true, "a", 0.5]'
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list | tuple):
        return f"[{', '.join(show(entry) for entry in value)}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key} = {show(entry)}' for key, entry in value.items())}}}"
    return str(value)


def require_cup(case: Case, what: str) -> None:
    """Refuse a case without an OOV.

    Args:
        case: The case.
        what: What is for closed cups only, as the subject of a sentence.

    Raises:
        CaseError: The shape is not a cup.
    """
    kind = case.shape.kind
    if kind != "cup":
        raise CaseError(
            f'shape.kind = "{kind}" is not possible: {what} for the closed cup only; take "cup", '
            'or run.model = "meridian" in a run'
        )


def require_perfect(case: Case, what: str) -> None:
    """Refuse a case with an imperfection.

    Args:
        case: The case.
        what: What is for perfect shells only, as the subject of a sentence.

    Raises:
        CaseError: The shell has an imperfection.
    """
    amplitude = case.imperfection.amplitude
    if amplitude:
        raise CaseError(
            f"imperfection.amplitude = {amplitude:g} is not possible: {what} for the perfect shell "
            'only; take 0, or run.model = "surface" in a run'
        )


LAYERS = ("ecm", "iov", "oov")


def fields_of(case: Case) -> dict[str, FieldValue]:
    """Return the values of a case that may vary over the shell, by key."""
    fields: dict[str, FieldValue] = {}
    for layer in LAYERS:
        mass = getattr(case.mass, layer)
        for name in ("stiffness", "thickness"):
            fields[f"material.{name}_{layer}"] = getattr(case.material, f"{name}_{layer}")
        if mass.source == "":
            fields[f"growth.{layer}"] = getattr(case.growth, layer)
        else:
            for name in ("source", "diffusivity", "edge_flux"):
                fields[f"mass.{layer}.{name}"] = getattr(mass, name)
    return fields


def require_axisymmetric(case: Case, what: str) -> None:
    """Refuse a case with values that vary in phi.

    Args:
        case: The case.
        what: What is for axisymmetric shells only, as the subject of a sentence.

    Raises:
        CaseError: One of its formulas has phi.
    """
    for key, value in fields_of(case).items():
        if isinstance(value, str) and "phi" in variables_of(value, ("theta", "phi", "t_n", "rho")):
            raise CaseError(
                f'{key} = "{value}" is not possible: {what} for axisymmetric shells only; leave '
                'phi out, or take run.model = "surface" in a run'
            )


def require_prescribed_numbers(case: Case, what: str) -> None:
    """Refuse a case whose growth or material is not the same everywhere, or is solved for.

    Args:
        case: The case.
        what: What is for uniform, prescribed growth only, as the subject of a sentence.

    Raises:
        CaseError: A layer has a mass balance, a table or a formula, or is uneven.
    """
    for key, value in fields_of(case).items():
        uniform = isinstance(value, float) and (key.startswith("growth") or value == 1)
        if not uniform or key.startswith("mass"):
            raise CaseError(
                f"{key} = {show(value)} is not possible: {what} for prescribed growth at one rate "
                "in uniform layers only"
            )


def _reject(key: str, value: object, allowed: str) -> None:
    raise ValueError(f"{key} = {show(value)} is not possible: {allowed}")


def _check_cap_is_a_shell(case: Case) -> None:
    shape = case.shape
    if shape.kind == "disk":
        return
    smallest = math.degrees(1.0 / shape.radius_over_thickness)
    if shape.opening_angle_deg < smallest:
        _reject(
            "shape.opening_angle_deg",
            shape.opening_angle_deg,
            f"with R/h = {shape.radius_over_thickness:g} the cap would be narrower than the shell "
            f"is thick; take at least {smallest:.3g} degrees",
        )


def _check_closure_takes_poisson(case: Case) -> None:
    material = case.material
    if material.closure == "closed-form" and material.poisson_ratio >= 0.48:
        _reject(
            "material.poisson_ratio",
            material.poisson_ratio,
            "the closed-form closure is ill-posed from 0.48 on; take a smaller value or another "
            "material.closure",
        )
    if material.closure == "paper" and material.poisson_ratio == 0.5:
        _reject(
            "material.poisson_ratio",
            material.poisson_ratio,
            "the incompressible limit is that of the closures layer-stretch and condensed; take a "
            "smaller value or one of these",
        )


def _check_growth_stays_positive(case: Case) -> None:
    for layer in LAYERS:
        rate = getattr(case.growth, layer)
        if not isinstance(rate, float) or getattr(case.mass, layer).source != "":
            continue  # what varies is looked at where it is evaluated
        if 1.0 + rate * case.run.t_end <= 0.0:
            _reject(
                f"growth.{layer}",
                rate,
                f"the growth factor 1 + rate t_n must stay positive up to run.t_end = "
                f"{case.run.t_end:g}; take a rate above {-1 / case.run.t_end:g}",
            )


def _check_mass(case: Case) -> None:
    for layer in LAYERS:
        mass = getattr(case.mass, layer)
        for name in ("diffusivity", "edge_flux"):
            if mass.source == "" and getattr(mass, name) != 0:
                _reject(
                    f"mass.{layer}.{name}",
                    getattr(mass, name),
                    f'without a balance it means nothing; set mass.{layer}.source, "0" for none',
                )
        if mass.edge_flux != 0 and mass.diffusivity == 0:
            _reject(
                f"mass.{layer}.edge_flux",
                mass.edge_flux,
                f"nothing flows in the layer; set mass.{layer}.diffusivity",
            )
        if mass.stiffness and mass.kind != "other":
            _reject(
                f"mass.{layer}.stiffness",
                mass.stiffness,
                f'it is that of another material; set mass.{layer}.kind = "other" as well',
            )
        if mass.source != "" and case.run.follow == "branch":
            _reject(
                f"mass.{layer}.source",
                mass.source,
                'a branch goes back in time, which a balance cannot; take run.follow = "stable"',
            )


def _check_imperfection(case: Case) -> None:
    imperfection = case.imperfection
    if imperfection.wavenumber == 1:
        _reject(
            "imperfection.wavenumber",
            1,
            "a wave of m = 1 is hardly more than a shift of the shell; take 2 or more, or 0 for a "
            "random mixture",
        )
    if imperfection.amplitude and case.run.follow != "stable":
        _reject(
            "imperfection.amplitude",
            imperfection.amplitude,
            'an imperfect shell has no axisymmetric states; take 0, or run.follow = "stable"',
        )


def _check_mirrors(case: Case) -> None:
    run, symmetry = case.run, case.mesh.symmetry
    if not run.keep_mirrors:
        return
    if run.model == "meridian" or run.follow != "stable":
        _reject(
            "run.keep_mirrors",
            True,
            'mirror planes are kept with run.model = "surface" and run.follow = "stable" only',
        )
    if case.contact.obstacles:
        _reject("run.keep_mirrors", True, "obstacles have no mirrors; take false, or no obstacles")
    if symmetry == 0 or symmetry % 2:
        _reject(
            "mesh.symmetry",
            symmetry,
            "run.keep_mirrors needs a mesh that x = 0 and y = 0 are mirrors of; take 4",
        )


def _check_mesh_resolves_the_shape(case: Case) -> None:
    if case.shape.kind != "cup":
        return
    mesh, alpha = case.mesh, case.shape.opening_angle
    arcs = {"cap": (2 * alpha, "the cap"), "oov": (math.pi - alpha, "interface to bottom pole")}
    for region, (arc, place) in arcs.items():
        size = getattr(mesh, f"cell_size_{region}")
        if size > arc / 4:
            _reject(
                f"mesh.cell_size_{region}",
                size,
                f"the mesh is too coarse, with fewer than 4 cells across {place}; take at most "
                f"{arc / 4:.3g} (units of R)",
            )
    largest = min(mesh.cell_size_cap, mesh.cell_size_oov)
    if mesh.cell_size_interface > largest:
        _reject(
            "mesh.cell_size_interface",
            mesh.cell_size_interface,
            f"the mesh is finest at the interface; take at most {largest:g} (units of R), the "
            "smaller of the other two sizes",
        )


def _check_mesh_is_not_endless(case: Case) -> None:
    mesh, alpha = case.mesh, case.shape.opening_angle
    cap, oov = 2 * math.pi * (1 - math.cos(alpha)), 2 * math.pi * (1 + math.cos(alpha))
    # Equilateral triangles, with the finest size over a band about one cell wide at the circle.
    band = 2 * math.pi * math.sin(alpha) * mesh.cell_size_interface
    parts = [
        (cap, mesh.cell_size_cap, "cell_size_cap"),
        (oov, mesh.cell_size_oov, "cell_size_oov"),
        (band, mesh.cell_size_interface, "cell_size_interface"),
    ]
    for spot in mesh.refinements:
        disc = math.pi * (spot.extent + 2 * spot.cell_size) ** 2
        parts.append((max(1, 2 * mesh.symmetry) * disc, spot.cell_size, "refinements.cell_size"))
    cells = sum(area / (math.sqrt(3) / 4 * size**2) for area, size, _ in parts)
    if cells > MOST_CELLS:
        _, size, key = min(parts, key=lambda part: part[1])
        _reject(
            f"mesh.{key}",
            size,
            f"the mesh would have about {cells:.1g} cells, more than {MOST_CELLS:g}; take larger "
            "cells (units of R)",
        )


def _check_steps_are_ordered(case: Case) -> None:
    solver = case.solver
    if solver.min_step > solver.initial_step:
        _reject(
            "solver.min_step",
            solver.min_step,
            f"it must not exceed solver.initial_step = {solver.initial_step:g}",
        )
    if solver.initial_step > solver.max_step:
        _reject(
            "solver.initial_step",
            solver.initial_step,
            f"it must not exceed solver.max_step = {solver.max_step:g}",
        )


def _check_output_times(case: Case) -> None:
    times, t_end = case.output.times, case.run.t_end
    if any(later <= earlier for earlier, later in itertools.pairwise(times)):
        _reject("output.times", list(times), "the times must increase, each one given once")
    if times and times[-1] > t_end:
        _reject("output.times", list(times), f"every time lies between 0 and run.t_end = {t_end:g}")


def why_not_resisted(run: Run, closure: str) -> str:
    """Return why a run cannot resist contact, as the end of a sentence; "" if it can.

    Args:
        run: What runs.
        closure: Closure of the layers.
    """
    if run.model == "meridian":
        return 'only run.model = "surface" resists contact'
    if run.follow != "stable":
        return 'resisting contact needs run.follow = "stable"'
    if closure in ("paper", "closed-form"):
        return (
            f"the closure {closure} has no energy to which that of contact could be "
            'added; take material.closure = "layer-stretch"'
        )
    return ""


def _check_contact(case: Case) -> None:
    contact = case.contact
    if contact.mode == "resist" and (why := why_not_resisted(case.run, case.material.closure)):
        _reject("contact.mode", contact.mode, why)
    if contact.mode != "resist" and contact.obstacles:
        _reject(
            "contact.mode", contact.mode, 'obstacles push only with contact.mode = "resist"; set it'
        )
    reach, size = contact.distance * case.shape.thickness, case.mesh.cell_size_interface
    if contact.mode == "resist" and reach > size:
        _reject(
            "contact.distance",
            contact.distance,
            f"the barrier would reach {reach:.3g} R, farther than the cells at the interface are "
            f"large; take at most {size / case.shape.thickness:.3g}",
        )


CROSS_CHECKS = (
    _check_cap_is_a_shell,
    _check_closure_takes_poisson,
    _check_growth_stays_positive,
    _check_mass,
    _check_imperfection,
    _check_mirrors,
    _check_mesh_resolves_the_shape,
    _check_mesh_is_not_endless,
    _check_steps_are_ordered,
    _check_output_times,
    _check_contact,
)
