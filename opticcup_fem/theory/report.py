"""The prediction for a case as text, for `opticcup theory`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from opticcup_fem.stimulus import stimulus_of
from opticcup_fem.theory.natural import natural_stretch
from opticcup_fem.theory.prediction import (
    Prediction,
    cap_curvature_of_case,
    growth_factor,
    predict,
)
from opticcup_fem.theory.scaling import PAPER_COEFFICIENTS, ScalingCoefficients

if TYPE_CHECKING:
    from opticcup_fem.case import Case

_OUTCOMES = {
    "normal": "normal cup: secondary invagination comes before symmetry breaking",
    "abnormal": "abnormal cup: symmetry breaking comes before secondary invagination",
    "not reached": "undecided: neither secondary invagination nor symmetry breaking is reached",
}


def prediction_report(case: Case, coefficients: ScalingCoefficients = PAPER_COEFFICIENTS) -> str:
    """Return what the theory says about a case, as lines of text.

    Args:
        case: The case; its output times are tabulated.
        coefficients: Coefficients of (3)-(5).

    Returns:
        Geometry, natural curvature over time, critical values and times, and the outcome.
    """
    prediction = predict(case, coefficients)
    lines = [
        *_header(case, prediction),
        "",
        *_curvature_table(case),
        "",
        *_event_table(case, prediction),
        "",
        f"prediction: {_OUTCOMES[prediction.outcome]}",
        *(f"note: {note}" for note in _notes(case)),
    ]
    return "\n".join(lines)


def _header(case: Case, prediction: Prediction) -> list[str]:
    shape, material = case.shape, case.material
    transition = (
        "no transition to buckling (4)-(6)"
        if math.isnan(prediction.theta_b)
        else f"buckling beyond theta_b = {prediction.theta_b:.3f} (6)"
    )
    return [
        f"R/h = {shape.radius_over_thickness:g}, alpha = {shape.opening_angle_deg:g} deg, "
        f"theta_bar = {prediction.theta_bar:.3f}",
        f"m = {material.thickness_ratio:.4g}, n = {material.modulus_ratio:g}, "
        f"nu = {material.poisson_ratio:g}, Gamma = {prediction.gamma:.5f}, "
        f"a_b = {prediction.plate_factor:.3f}",
        f"snapping beyond theta_s = {prediction.theta_s:.3f} (S26), {transition}",
    ]


def _curvature_table(case: Case) -> list[str]:
    rows = [f"{'t_n':>6}  {'Lambda':>8}  {'kappa h':>8}  {'kappa_cap R':>11}"]
    ratio = case.shape.radius_over_thickness
    for t_n in case.output.times:
        e_1, e_2 = (growth_factor(case, layer, t_n) for layer in ("ecm", "iov"))
        rho_1, rho_2 = (
            stimulus_of(case, layer).density_ratio_of_factor(e)
            for layer, e in (("ecm", e_1), ("iov", e_2))
        )
        m, n = case.material.thickness_ratio, case.material.modulus_ratio
        stretch = float(natural_stretch(e_1, e_2, m, n, rho_1, rho_2))
        kappa = float(cap_curvature_of_case(case, t_n))
        rows.append(f"{t_n:6.4g}  {stretch:8.4f}  {kappa / ratio:8.4f}  {kappa:11.4f}")
    return rows


def _event_table(case: Case, prediction: Prediction) -> list[str]:
    rows = [f"{'event':<24}{'kappa_cap R':>11}  {'t_n':>11}"]
    for event in prediction.events:
        time = "not reached" if math.isnan(event.t_n) else f"{event.t_n:.4f}"
        what = prediction.primary_type if event.kind == "primary_invagination" else ""
        name = event.kind.replace("_", " ")
        rows.append(f"{name:<24}{event.kappa_cap_R:11.4f}  {time:>11}  {what}".rstrip())
    rows.append(
        f"{'largest up to t_n = ' + format(case.run.t_end, 'g'):<24}"
        f"{prediction.largest_kappa_cap_R:11.4f}"
    )
    return rows


def _notes(case: Case) -> list[str]:
    notes = []
    angle, ratio = case.shape.opening_angle_deg, case.shape.radius_over_thickness
    if not (30 <= angle <= 50 and 5 <= ratio <= 20):
        notes.append("the laws were fitted for alpha 30 to 50 deg and R/h 5 to 20; this is outside")
    if not case.growth.mass_change:
        notes.append("the laws were fitted with mass change on; without it every cup buckles")
    return notes
