"""Scaling laws for the critical natural curvature of the optic cup, (3)-(6).

theta_bar = alpha sqrt(R/h) measures depth and slenderness of the cap. Theory: docs/theory.md,
"Scaling laws".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from opticcup_fem.theory.arrays import FloatArray, floats


@dataclass(frozen=True)
class ScalingCoefficients:
    """Fitted coefficients of (3)-(5); the defaults are the paper's, for its baseline material.

    Attributes:
        a_1: Slope of (3), primary invagination.
        b_1: Offset of (3).
        a_2: Slope of (4), secondary invagination.
        b_2: Offset of (4).
        b_b: Slope of (5), symmetry breaking.
        c_b: Offset of (5).
    """

    a_1: float = 1.55
    b_1: float = -0.95
    a_2: float = 0.86
    b_2: float = 0.22
    b_b: float = 4.72
    c_b: float = -5.50


PAPER_COEFFICIENTS = ScalingCoefficients()


def theta_bar(angle: npt.ArrayLike, radius_over_thickness: npt.ArrayLike) -> FloatArray:
    """Return theta_bar = alpha sqrt(R/h).

    Args:
        angle: Opening angle alpha, rad.
        radius_over_thickness: R/h.

    Returns:
        theta_bar, dimensionless.
    """
    alpha, ratio = floats(angle, radius_over_thickness)
    theta: FloatArray = alpha * np.sqrt(ratio)
    return theta


def primary_curvature(
    theta: npt.ArrayLike,
    gamma: npt.ArrayLike,
    coefficients: ScalingCoefficients = PAPER_COEFFICIENTS,
) -> FloatArray:
    """Return kappa_1 R = a_1 (1 + Gamma) theta_bar + b_1 at the primary invagination, (3).

    Args:
        theta: theta_bar.
        gamma: Gamma, as `rigidity.spring_ratio` gives it.
        coefficients: Fitted coefficients.

    Returns:
        Critical kappa_cap R, dimensionless.
    """
    theta, gamma = floats(theta, gamma)
    return coefficients.a_1 * (1 + gamma) * theta + coefficients.b_1


def secondary_curvature(
    radius_over_thickness: npt.ArrayLike,
    coefficients: ScalingCoefficients = PAPER_COEFFICIENTS,
) -> FloatArray:
    """Return kappa_2 R = a_2 R/h + b_2 at the secondary invagination, (4).

    Args:
        radius_over_thickness: R/h, which is theta_bar^2/alpha^2.
        coefficients: Fitted coefficients.

    Returns:
        Critical kappa_cap R, dimensionless.
    """
    (ratio,) = floats(radius_over_thickness)
    return coefficients.a_2 * ratio + coefficients.b_2


def buckling_curvature(
    theta: npt.ArrayLike,
    angle: npt.ArrayLike,
    gamma: npt.ArrayLike,
    plate_factor: npt.ArrayLike,
    coefficients: ScalingCoefficients = PAPER_COEFFICIENTS,
) -> FloatArray:
    """Return kappa_b R at which the cup leaves axisymmetry, (5).

    kappa_b R = b_b (a_b/theta_bar^2 + 1 + Gamma (pi - alpha) theta_bar^2/alpha^2) + c_b.

    Args:
        theta: theta_bar, above 0.
        angle: Opening angle alpha, rad.
        gamma: Gamma.
        plate_factor: a_b, as `plate.plate_buckling_factor` gives it.
        coefficients: Fitted coefficients.

    Returns:
        Critical kappa_cap R, dimensionless.
    """
    theta, alpha, gamma, a_b = floats(theta, angle, gamma, plate_factor)
    bracket: FloatArray = a_b / theta**2 + 1 + gamma * (np.pi - alpha) * theta**2 / alpha**2
    return coefficients.b_b * bracket + coefficients.c_b


def buckling_transition(
    angle: npt.ArrayLike,
    gamma: npt.ArrayLike,
    plate_factor: npt.ArrayLike,
    coefficients: ScalingCoefficients = PAPER_COEFFICIENTS,
) -> FloatArray:
    """Return theta_b, where (4) meets (5): buckling comes first beyond it, (6).

    With X = theta_bar^2 the two laws meet where A X^2 - B alpha^2 X - C alpha^2 = 0, A = a_2 - b_b
    Gamma (pi - alpha), B = b_b + c_b - b_2, C = b_b a_b. Written as 2 C alpha^2/(root - B alpha^2)
    the first root stays exact where A vanishes. The square root of (6) covers the whole fraction.

    Args:
        angle: Opening angle alpha, rad.
        gamma: Gamma; the result is sensitive to it.
        plate_factor: a_b.
        coefficients: Fitted coefficients.

    Returns:
        theta_bar at the transition; NaN where the laws do not meet.

    >>> print(f"{buckling_transition(np.radians(40), 0.05845, 4.167):.3f}")
    2.447
    """
    alpha, gamma, a_b = floats(angle, gamma, plate_factor)
    c = coefficients
    quadratic = c.a_2 - c.b_b * gamma * (np.pi - alpha)
    linear = alpha**2 * (c.b_b + c.c_b - c.b_2)
    constant = alpha**2 * c.b_b * a_b
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(linear**2 + 4 * quadratic * constant)
        squared = 2 * constant / (root - linear)
        theta: FloatArray = np.sqrt(np.where(np.isfinite(squared) & (squared > 0), squared, np.nan))
    return theta
