"""What the scaling laws predict for a case: critical curvatures, their times, and the outcome.

Theory: docs/theory.md, "Prediction for a case".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from opticcup_fem.scalar_fields import ScalarField
from opticcup_fem.stimulus import stimulus_of
from opticcup_fem.theory.arrays import FloatArray, floats
from opticcup_fem.theory.natural import natural_curvature
from opticcup_fem.theory.plate import chi, plate_buckling_factor, snapping_limit
from opticcup_fem.theory.rigidity import spring_ratio
from opticcup_fem.theory.scaling import (
    PAPER_COEFFICIENTS,
    ScalingCoefficients,
    buckling_curvature,
    buckling_transition,
    primary_curvature,
    secondary_curvature,
)

if TYPE_CHECKING:
    from opticcup_fem.case import Case

EventKind = Literal["primary_invagination", "secondary_invagination", "symmetry_breaking"]
Outcome = Literal["normal", "abnormal", "not reached"]


@dataclass(frozen=True)
class PredictedEvent:
    """One event of the path as the scaling laws have it.

    Attributes:
        kind: Name of the event, as in `events.json`.
        kappa_cap_R: Critical natural curvature of the cap, times R.
        t_n: First normalised time at which the cap has it; NaN if it never does up to t_end.
    """

    kind: EventKind
    kappa_cap_R: float
    t_n: float


@dataclass(frozen=True)
class Prediction:
    """What the scaling laws say about a case.

    Attributes:
        theta_bar: alpha sqrt(R/h).
        theta_s: Limit of snapping of open caps, (S26).
        theta_b: Transition from secondary invagination to buckling, (6); NaN if there is none.
        gamma: Relative stiffness of the OOV spring, (2).
        plate_factor: a_b of (5).
        primary_type: "snap-through" above theta_s, else "smooth".
        events: Primary and secondary invagination and symmetry breaking, in this order.
        outcome: "normal" if secondary invagination comes before symmetry breaking, "abnormal" if
            after, "not reached" if neither comes up to t_end.
        final_kappa_cap_R: kappa_cap R at t_end.
        largest_kappa_cap_R: Largest kappa_cap R up to t_end.
    """

    theta_bar: float
    theta_s: float
    theta_b: float
    gamma: float
    plate_factor: float
    primary_type: Literal["snap-through", "smooth"]
    events: tuple[PredictedEvent, PredictedEvent, PredictedEvent]
    outcome: Outcome
    final_kappa_cap_R: float
    largest_kappa_cap_R: float


def cap_curvature_of_case(case: Case, t_n: npt.ArrayLike) -> FloatArray:
    """Return kappa_cap R of a case, (S18) times R/h: the load axis of the phase diagram.

    Args:
        case: The case.
        t_n: Normalised time, any shape.

    Returns:
        kappa_cap R, same shape as `t_n`.
    """
    e_1, e_2 = (growth_factor(case, layer, t_n) for layer in ("ecm", "iov"))
    rho_1, rho_2 = (
        stimulus_of(case, layer).density_ratio_of_factor(e)
        for layer, e in (("ecm", e_1), ("iov", e_2))
    )
    return cap_curvature_of_growth(
        case,
        (e_1, e_2),
        (rho_1 * stiffness_factor(case, "ecm", t_n), rho_2 * stiffness_factor(case, "iov", t_n)),
    )


def cap_curvature_of_growth(
    case: Case,
    factors: tuple[npt.ArrayLike, npt.ArrayLike],
    density_ratios: tuple[npt.ArrayLike, npt.ArrayLike],
) -> FloatArray:
    """Return kappa_cap R of given growth of the layers, (S18) times R/h.

    Args:
        case: The case.
        factors: e of ECM and IOV, any shape.
        density_ratios: Their rho_r, times a factor on their modulus.

    Returns:
        kappa_cap R, same shape.
    """
    material = case.material
    ecm, iov = (thickness_factor(case, layer) for layer in ("ecm", "iov"))
    m = material.thickness_ratio
    thickness = (iov + m * ecm) / (1 + m)
    curvature = natural_curvature(*factors, m * ecm / iov, material.modulus_ratio, *density_ratios)
    return curvature / thickness * case.shape.radius_over_thickness


def growth_factor(case: Case, layer: str, t_n: npt.ArrayLike) -> FloatArray:
    """Return e of a layer at the apex.

    Args:
        case: The case.
        layer: "ecm", "iov" or "oov".
        t_n: Normalised time, any shape.

    Returns:
        Same shape as `t_n`; NaN where a mass balance decides on it.
    """
    (t_n,) = floats(t_n)
    if getattr(case.mass, layer).source != "":
        return np.full_like(t_n, np.nan)
    rate = ScalarField(getattr(case.growth, layer))
    return 1 + rate(t_n) * t_n


def stiffness_factor(case: Case, layer: str, t_n: npt.ArrayLike) -> FloatArray:
    """Return the factor on a layer's modulus at the apex."""
    return ScalarField(getattr(case.material, f"stiffness_{layer}"))(t_n)


def thickness_factor(case: Case, layer: str) -> float:
    """Return the factor on a layer's thickness at the apex."""
    return float(ScalarField(getattr(case.material, f"thickness_{layer}"))(0.0))


def time_of_curvature(case: Case, kappa_cap_R: float) -> float:
    """Return the first t_n at which the cap of a case reaches a natural curvature.

    kappa_cap R need not be monotone (without mass change it peaks), so the first crossing is
    bracketed on a fine grid, then bisected to rounding.

    Args:
        case: The case.
        kappa_cap_R: Natural curvature times R; not positive means outside the laws' range.

    Returns:
        t_n in (0, t_end], or NaN if it is not positive or never reached.
    """
    grid = np.linspace(0.0, case.run.t_end, 2001)
    above = cap_curvature_of_case(case, grid) >= kappa_cap_R
    if kappa_cap_R <= 0.0 or not above.any():
        return float("nan")
    first = int(np.argmax(above))
    low, high = float(grid[first - 1]), float(grid[first])
    while low < (middle := 0.5 * (low + high)) < high:
        if float(cap_curvature_of_case(case, middle)) >= kappa_cap_R:
            high = middle
        else:
            low = middle
    return high


def predict(case: Case, coefficients: ScalingCoefficients = PAPER_COEFFICIENTS) -> Prediction:
    """Return what the scaling laws predict for a case.

    The paper's coefficients were fitted for its baseline material with mass change on, alpha from
    30 to 50 degrees and R/h from 5 to 20; elsewhere they extrapolate.

    Args:
        case: The case.
        coefficients: Coefficients of (3)-(5).

    Returns:
        Critical curvatures, times, and whether the cup becomes normal.

    Raises:
        CaseError: Growth or material vary, or a mass balance is to be solved.
    """
    from opticcup_fem.case.checks import require_prescribed_numbers  # the theory needs NumPy only

    require_prescribed_numbers(case, "the scaling laws are")
    shape, material = case.shape, case.material
    m, n, nu = material.thickness_ratio, material.modulus_ratio, material.poisson_ratio
    alpha, theta = shape.opening_angle, shape.theta_bar
    gamma = float(spring_ratio(m, n, nu))
    plate_factor = float(plate_buckling_factor(chi(m, n), nu))
    theta_s = float(snapping_limit(nu))

    kappa_1 = primary_curvature(theta, gamma, coefficients)
    kappa_2 = secondary_curvature(shape.radius_over_thickness, coefficients)
    kappa_b = buckling_curvature(theta, alpha, gamma, plate_factor, coefficients)
    primary = _event(case, "primary_invagination", kappa_1)
    secondary = _event(case, "secondary_invagination", kappa_2)
    buckling = _event(case, "symmetry_breaking", kappa_b)
    times = np.linspace(0.0, case.run.t_end, 2001)
    curvatures = cap_curvature_of_case(case, times)
    return Prediction(
        theta_bar=theta,
        theta_s=theta_s,
        theta_b=float(buckling_transition(alpha, gamma, plate_factor, coefficients)),
        gamma=gamma,
        plate_factor=plate_factor,
        primary_type="snap-through" if theta > theta_s else "smooth",
        events=(primary, secondary, buckling),
        outcome=_outcome(secondary.t_n, buckling.t_n),
        final_kappa_cap_R=float(curvatures[-1]),
        largest_kappa_cap_R=float(curvatures.max()),
    )


def _event(case: Case, kind: EventKind, curvature: FloatArray) -> PredictedEvent:
    kappa_cap_R = float(curvature)
    return PredictedEvent(kind, kappa_cap_R, time_of_curvature(case, kappa_cap_R))


def _outcome(secondary_t_n: float, buckling_t_n: float) -> Outcome:
    if np.isnan(secondary_t_n) and np.isnan(buckling_t_n):
        return "not reached"
    # A time that is NaN counts as never; comparisons with NaN are false.
    return "abnormal" if buckling_t_n <= secondary_t_n or np.isnan(secondary_t_n) else "normal"
