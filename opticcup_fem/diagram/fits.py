"""The scaling laws (3)-(5) fitted to rows, with confidence intervals, and where they cross."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from opticcup_fem.diagram.regimes import regime
from opticcup_fem.theory import ScalingCoefficients, buckling_transition

Row = Mapping[str, Any]
FloatArray = npt.NDArray[np.float64]

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Line:
    """A straight line y = slope x + offset by least squares.

    Attributes:
        slope: Its slope.
        offset: Its offset.
        covariance: Covariance of (slope, offset) from the scatter of the points, shape (2, 2).
        count: Number of points.
        rms: Root mean square of the residuals.
    """

    slope: float
    offset: float
    covariance: FloatArray
    count: int
    rms: float

    @property
    def half_widths(self) -> tuple[float, float]:
        """Half widths of the 95 % confidence intervals of slope and offset (Student's t)."""
        factor = float(stats.t.ppf((1 + CONFIDENCE) / 2, self.count - 2))
        slope, offset = factor * np.sqrt(np.diag(self.covariance))
        return float(slope), float(offset)

    def __call__(self, x: npt.ArrayLike) -> FloatArray:
        """Return the line's values."""
        return np.asarray(self.slope * np.asarray(x, dtype=np.float64) + self.offset)


def fitted_line(x: npt.ArrayLike, y: npt.ArrayLike) -> Line | None:
    """Return the line through points by least squares, None for fewer than three points."""
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    if len(x) < 3:
        return None
    design = np.column_stack([x, np.ones_like(x)])
    solution = np.linalg.lstsq(design, y, rcond=None)[0]
    residual = y - design @ solution
    variance = float(residual @ residual) / (len(x) - 2)
    covariance = variance * np.linalg.inv(design.T @ design)
    rms = float(np.sqrt(np.mean(residual**2)))
    return Line(float(solution[0]), float(solution[1]), covariance, len(x), rms)


@dataclass(frozen=True)
class LawFits:
    """The laws fitted to a set of cups; None where too few cups have the event.

    Attributes:
        primary: (3), kappa_1 R over (1 + Gamma) theta_bar.
        snapping: The same, of those cups only whose primary invagination is a fold.
        secondary: (4), kappa_2 R over R/h, of normal cups.
        buckling: (5), kappa_b R over its bracket, of abnormal cups that invaginate first; slender
            ones, which the primary invagination itself throws out of symmetry, are left out.
    """

    primary: Line | None
    snapping: Line | None
    secondary: Line | None
    buckling: Line | None

    @property
    def coefficients(self) -> ScalingCoefficients | None:
        """All six coefficients, None if a law is missing."""
        if self.primary is None or self.secondary is None or self.buckling is None:
            return None
        lines = (self.primary, self.secondary, self.buckling)
        return ScalingCoefficients(*(v for line in lines for v in (line.slope, line.offset)))


def buckling_bracket(
    ratio: npt.ArrayLike, angle: npt.ArrayLike, gamma: float, plate_factor: float
) -> FloatArray:
    """Return a_b/theta_bar^2 + 1 + Gamma (pi - alpha) R/h, the bracket of (5).

    Args:
        ratio: R/h.
        angle: alpha, radians.
        gamma: Gamma.
        plate_factor: a_b.
    """
    ratio, angle = np.asarray(ratio, dtype=np.float64), np.asarray(angle, dtype=np.float64)
    return np.asarray(plate_factor / (angle**2 * ratio) + 1 + gamma * (np.pi - angle) * ratio)


def fit_laws(rows: Iterable[Row], gamma: float, plate_factor: float) -> LawFits:
    """Fit (3), (4) and (5).

    Args:
        rows: Rows with ``ratio`` R/h, ``angle`` alpha in radians, and their events.
        gamma: Gamma of the material.
        plate_factor: a_b of the material.
    """
    rows = list(rows)

    def line(chosen: Iterable[Row], suffix: str) -> Line | None:
        chosen = list(chosen)
        ratio, angle = (np.array([float(r[name]) for r in chosen]) for name in ("ratio", "angle"))
        x = {
            "1": (1 + gamma) * angle * np.sqrt(ratio),
            "2": ratio,
            "b": buckling_bracket(ratio, angle, gamma, plate_factor) if chosen else ratio,
        }[suffix]
        return fitted_line(x, [float(r[f"kappa_{suffix}"]) for r in chosen])

    primary = [r for r in rows if r["kappa_1"] is not None]
    return LawFits(
        line(primary, "1"),
        line((r for r in primary if r["type_1"] == "fold"), "1"),
        line((r for r in rows if regime(r) == "normal"), "2"),
        line((r for r in rows if regime(r) == "abnormal" and r["type_b"] == "bifurcation"), "b"),
    )


def transition(
    fits: LawFits, angle: float, gamma: float, plate_factor: float
) -> tuple[float, float] | None:
    """Return theta_b where the fitted (4) and (5) cross, (6), and the half width of its interval.

    The interval (95 %) carries the scatter of both fits through (6) to first order.

    Args:
        fits: Fitted laws.
        angle: alpha, radians.
        gamma: Gamma.
        plate_factor: a_b.

    Returns:
        None where a law is missing or they do not cross.
    """
    if fits.coefficients is None or fits.secondary is None or fits.buckling is None:
        return None
    c = fits.coefficients
    values = np.array([c.a_2, c.b_2, c.b_b, c.c_b])

    def theta(v: FloatArray) -> float:
        changed = ScalingCoefficients(c.a_1, c.b_1, *map(float, v))
        return float(buckling_transition(angle, gamma, plate_factor, changed))

    centre = theta(values)
    if np.isnan(centre):
        return None
    steps = 1e-6 * np.maximum(np.abs(values), 1.0)
    slopes = np.array(
        [
            (theta(values + step) - theta(values - step)) / (2 * size)
            for step, size in zip(np.diag(steps), steps, strict=True)
        ]
    )
    covariance = np.zeros((4, 4))
    covariance[:2, :2], covariance[2:, 2:] = fits.secondary.covariance, fits.buckling.covariance
    freedom = min(fits.secondary.count, fits.buckling.count) - 2
    factor = float(stats.t.ppf((1 + CONFIDENCE) / 2, freedom))
    return centre, factor * float(np.sqrt(slopes @ covariance @ slopes))
