"""Tasks on the meridian model: a cup's row and path, its layers at some times, a free plate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from opticcup_fem.case import Case, parse_case
from opticcup_fem.equilibrium.continuation import ArcControl
from opticcup_fem.errors import ClosureBreakdown
from opticcup_fem.events import Event, event
from opticcup_fem.meridian.contact import self_crossing
from opticcup_fem.meridian.crossings import crossings
from opticcup_fem.meridian.ellipticity import ellipticity
from opticcup_fem.meridian.events import path_events
from opticcup_fem.meridian.layers import evaluate
from opticcup_fem.meridian.mesh import Grading, MeridianMesh
from opticcup_fem.meridian.observables import CupObserver
from opticcup_fem.meridian.path import MeridianPath, MeridianPoint
from opticcup_fem.meridian.profile import Disc
from opticcup_fem.meridian.shell import MeridianShell
from opticcup_fem.meridian.transport import balance_columns
from opticcup_fem.meridian.waves import Waves
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.section import Layer, Section
from opticcup_fem.studies.curvature import cap_curvature_of_run
from opticcup_fem.studies.meridian import shell_of
from opticcup_fem.studies.sweep.losses import Loss, first_loss
from opticcup_fem.studies.sweep.rows import COLUMNS, summary_row
from opticcup_fem.theory import natural_curvature

Record = dict[str, Any]


def cup(parameters: Mapping[str, Any]) -> Record:
    """Follow one cup's axisymmetric path and find where it loses its symmetry.

    Args:
        parameters: A case, as nested tables.

    Returns:
        ``row`` (``rows.summary_row``), ``path`` (columns of all states up to a contact of the shell
        with itself), ``reason`` (why the path ended early, None if it did not).
    """
    case = parse_case(parameters)
    shell = shell_of(case)
    path = MeridianPath(shell, Waves(shell, (0,)))
    observe = CupObserver(shell)
    points: list[MeridianPoint] = []
    rows: list[dict[str, Any]] = []
    events: list[Event] = []
    elliptic = True

    def kappa(t_n: float) -> float:
        return cap_curvature_of_run(case, rows, t_n)

    for point in path.follow(case.run.t_end, case.output.times):
        here = {"t_n": point.t_n} | balance_columns(shell, point.state, point.t_n)
        here["kappa_cap_R"] = cap_curvature_of_run(case, [*rows, here], point.t_n)
        if point.followed and self_crossing(shell, point.state) is not None:
            events.append(event("self_contact", "mid-surface", point.t_n, here["kappa_cap_R"]))
            break
        points.append(point)
        rows.append(
            here
            | observe(point.state, point.t_n)
            | {"jump": point.jump, "followed": point.followed}
        )
        if elliptic and point.followed and ellipticity(shell, point.state, point.t_n).value <= 0:
            elliptic = False
            kind = ("closure_breakdown", "loss of ellipticity")
            events.append(event(*kind, point.t_n, kappa(point.t_n)))
    failure = None if events and events[-1]["kind"] == "self_contact" else path.failure()
    if isinstance(failure, ClosureBreakdown) and failure.t_n is not None:
        kind = ("closure_breakdown", failure.closure)
        events.append(event(*kind, failure.t_n, kappa(failure.t_n)))
    invaginations = [
        one for one in path_events(path, points, rows, [], kappa) if one.get("followed", True)
    ]
    events += invaginations + _losses(case, path, points, invaginations, kappa)
    columns = (*COLUMNS, "followed", "jump")
    table = {name: [row[name] for row in rows] for name in columns}
    table["limit_point"] = [point.path.is_fold for point in points]
    return {
        "row": summary_row(case, table, events),
        "path": table,
        "reason": None if failure is None else str(failure),
    }


def layers(parameters: Mapping[str, Any]) -> Record:
    """Follow one cup's path and describe its layers at the output times.

    Args:
        parameters: A case, as nested tables.

    Returns:
        ``states``, one for each of ``output.times`` that the followed part reaches before
        the shell touches itself: ``t_n`` and
        ``regions``, each with the colatitude ``theta``, the faces (r, z) of the layers, inside
        first, and for each layer the mean ``stretch`` lambda_3 and the meridional Cauchy
        ``stress``; ``reason`` as ``cup`` has it.
    """
    case = parse_case(parameters)
    shell = shell_of(case)
    path = MeridianPath(shell, Waves(shell, (0,)))
    states = []
    for point in path.follow(case.run.t_end, case.output.times):
        if point.followed and self_crossing(shell, point.state) is not None:
            break
        if point.followed and any(abs(point.t_n - t) < 1e-12 for t in case.output.times):
            regions = {name: _region(shell, point, name) for name in shell.sections}
            states.append({"t_n": point.t_n, "regions": regions})
    failure = path.failure()
    return {"states": states, "reason": None if failure is None else str(failure)}


def _region(shell: MeridianShell, point: MeridianPoint, name: str) -> Record:
    mesh = shell.mesh
    theta = np.unique(mesh.s[mesh.cells[mesh.region[name]]])
    on = evaluate(shell, point.state, point.t_n, name, theta)
    return {
        "theta": theta.tolist(),
        "faces": on.faces.tolist(),
        "stretch": {layer: one.thickness_stretch.tolist() for layer, one in on.fields.items()},
        "stress": {layer: one.stress[:, 0].tolist() for layer, one in on.fields.items()},
    }


def plate(parameters: Mapping[str, Any]) -> Record:
    """Grow a free bilayer disc until it leaves axisymmetry.

    Args:
        parameters: ``radius_over_thickness`` Rp/h, ``thickness_ratio`` m, ``modulus_ratio`` n,
            ``poisson_ratio`` nu; the inner layer grows, the outer one does not, mass changes.

    Returns:
        ``row``: ``kappa_h`` natural curvature kappa h at the first bifurcation, its ``wavenumber``.
    """
    ratio, m, n = (
        float(parameters[name])
        for name in ("radius_over_thickness", "thickness_ratio", "modulus_ratio")
    )
    h, nu = 1 / ratio, float(parameters["poisson_ratio"])
    section = Section(
        [Layer("iov", h / (1 + m), 1.0, nu, 8), Layer("ecm", h * m / (1 + m), n, nu, 4)]
    )
    rates = {"iov": 5.0, "ecm": 0.0}
    laws = {name: LinearGrowth(rate) for name, rate in rates.items()}
    mesh = MeridianMesh(Disc(1.0), Grading(0.1, 0.01, 0.01))
    shell = MeridianShell(mesh, {"cap": section}, laws)
    # a disc buckles at kappa h of about 4 (h/Rp)^2, which takes t_n of about 0.5 (h/Rp)^2
    control = ArcControl(initial=1e-4, largest=0.01, smallest=1e-7)
    path = MeridianPath(shell, Waves(shell, (0, 1, 2, 3)), control)
    found = crossings(path, list(path.follow(0.7 * h * h)), 1e-9)
    row: Record = {"kappa_h": None, "wavenumber": None}
    if found:
        e = 1 + rates["iov"] * found[0].t_n
        kappa_h = float(natural_curvature(1.0, e, m, n, 1.0, e * e))
        row = {"kappa_h": kappa_h, "wavenumber": found[0].wavenumber}
    failure = path.failure()
    return {"row": row, "reason": None if failure is None else str(failure)}


def _losses(
    case: Case,
    path: MeridianPath,
    points: list[MeridianPoint],
    invaginations: list[Event],
    kappa: Callable[[float], float],
) -> list[Event]:
    """Return the first loss of symmetry before the primary invagination and that after it."""
    waves = Waves(path.problem.shell, tuple(range(1, case.run.max_wavenumber + 1)))
    primary = [one["t_n"] for one in invaginations if one["kind"] == "primary_invagination"]
    first = first_loss(path, points, waves)
    found: list[Event] = []
    if first is not None and primary and first.t_n <= primary[0]:
        found.append(_loss_event(first, kappa(first.t_n)) | {"early": True})
        first = first_loss(path, points, waves, after=primary[0])
    if first is not None:
        found.append(_loss_event(first, kappa(first.t_n)))
    return found


def _loss_event(loss: Loss, kappa: float) -> Event:
    kind_type = "jump" if loss.by_jump else "bifurcation"
    return event("symmetry_breaking", kind_type, loss.t_n, kappa, wavenumber=loss.wavenumber)
