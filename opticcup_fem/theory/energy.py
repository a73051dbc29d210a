"""Shell energies of the paper's theory, with growth as natural forms or as external loads.

Forms are covariant components in any one frame, shape (..., 2, 2); the outward normal makes
b_ref = -a_ref/R on the sphere. Theory: docs/theory.md, "Shell energy with growth as a load".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from opticcup_fem.theory.arrays import FloatArray, floats
from opticcup_fem.theory.rigidity import bending_rigidity, membrane_rigidity


def natural_forms(
    stretch: npt.ArrayLike,
    curvature: npt.ArrayLike,
    a_ref: npt.ArrayLike,
    b_ref: npt.ArrayLike,
) -> tuple[FloatArray, FloatArray]:
    r"""Return :math:`\bar a = \Lambda^2 \mathring a` and the matching natural curvature tensor.

    :math:`\bar b = \Lambda^2 (\mathring b + \kappa \mathring a)`, below (S13).

    Args:
        stretch: Natural stretch Lambda, shape (...).
        curvature: Natural curvature kappa, shape (...), 1/length.
        a_ref: Reference metric, shape (..., 2, 2).
        b_ref: Reference curvature, shape (..., 2, 2), 1/length.

    Returns:
        Natural metric and natural curvature tensor, shape (..., 2, 2).
    """
    stretch, kappa, a_ref, b_ref = floats(stretch, curvature, a_ref, b_ref)
    area = stretch[..., None, None] ** 2
    return area * a_ref, area * (b_ref + kappa[..., None, None] * a_ref)


def koiter_energy(
    a: npt.ArrayLike,
    b: npt.ArrayLike,
    a_nat: npt.ArrayLike,
    b_nat: npt.ArrayLike,
    young: npt.ArrayLike,
    poisson: npt.ArrayLike,
    thickness: npt.ArrayLike,
) -> FloatArray:
    r"""Return the non-Euclidean shell energy per natural area, (S13).

    .. math:: \tfrac{Y}{2} (\nu (\mathrm{tr} E)^2 + (1 - \nu) \mathrm{tr} E^2) +
        \tfrac{B}{2} (\nu (\mathrm{tr} K)^2 + (1 - \nu) \mathrm{tr} K^2), \quad
        E = \bar a^{-1} \tfrac12 (a - \bar a), \ K = \bar a^{-1} (b - \bar b)

    Args:
        a: Current metric.
        b: Current curvature.
        a_nat: Natural metric, positive definite.
        b_nat: Natural curvature.
        young: Young's modulus E, of the cap its effective one.
        poisson: Poisson ratio nu.
        thickness: Thickness h.

    Returns:
        Energy per area of the natural mid-surface, shape (...).
    """
    a, b, a_nat, b_nat = floats(a, b, a_nat, b_nat)
    inverse = np.linalg.inv(a_nat)
    membrane = inverse @ (a - a_nat) / 2
    bending = inverse @ (b - b_nat)
    psi_m = membrane_rigidity(young, poisson, thickness) / 2 * _isotropic(membrane, poisson)
    psi_b = bending_rigidity(young, poisson, thickness) / 2 * _isotropic(bending, poisson)
    return psi_m + psi_b


@dataclass(frozen=True)
class GrowthLoads:
    """Dead loads on a sphere that do the work of growth, (S14).

    The potential is Lambda^-2 W_K minus the work of these, w outward and m_0 the outward conormal.

    Attributes:
        membrane_pressure: Work per area and w, (S14b).
        edge_traction: Work per edge length and u . m_0, (S14c).
        bending_pressure: Work per area and w, (S14d).
        edge_moment: Work per edge length and (u/R - q) . m_0, (S14e), q the rotation of the
            tangent; its negative is the torque of (S15).
    """

    membrane_pressure: FloatArray
    edge_traction: FloatArray
    bending_pressure: FloatArray
    edge_moment: FloatArray


def growth_loads(
    stretch: npt.ArrayLike,
    curvature: npt.ArrayLike,
    radius: npt.ArrayLike,
    young: npt.ArrayLike,
    poisson: npt.ArrayLike,
    thickness: npt.ArrayLike,
) -> GrowthLoads:
    """Return the loads by which growth acts on a sphere, (S14b)-(S14e).

    Args:
        stretch: Natural stretch Lambda.
        curvature: Natural curvature kappa, 1/length.
        radius: R.
        young: Young's modulus E.
        poisson: Poisson ratio nu.
        thickness: Thickness h.

    Returns:
        The four loads.
    """
    stretch, kappa, radius, nu = floats(stretch, curvature, radius, poisson)
    expansion = 1 - stretch**-2
    bend = expansion - kappa * radius
    y = membrane_rigidity(young, nu, thickness) * (1 + nu)
    b = bending_rigidity(young, nu, thickness) * (1 + nu)
    return GrowthLoads(
        membrane_pressure=y * expansion / radius,
        edge_traction=y * expansion / 2,
        bending_pressure=2 * b * bend / radius**3,
        edge_moment=b * bend / radius,
    )


def edge_torque(
    stretch: npt.ArrayLike,
    curvature: npt.ArrayLike,
    radius: npt.ArrayLike,
    young: npt.ArrayLike,
    poisson: npt.ArrayLike,
    thickness: npt.ArrayLike,
) -> FloatArray:
    """Return the torque B (1 + nu) (kappa R - (1 - Lambda^-2))/R along the edge, (S15).

    The one load of (S14) that matters for h/R << 1; it works on the rotation q . m_0.

    Args:
        stretch: Natural stretch Lambda.
        curvature: Natural curvature kappa, 1/length.
        radius: R.
        young: Young's modulus E.
        poisson: Poisson ratio nu.
        thickness: Thickness h.

    Returns:
        Torque per edge length; positive torques open the cap.
    """
    return -growth_loads(stretch, curvature, radius, young, poisson, thickness).edge_moment


def boundary_layer_energy(
    rotation: npt.ArrayLike,
    edge_moment: npt.ArrayLike,
    angle: npt.ArrayLike,
    radius: npt.ArrayLike,
    rigidity: npt.ArrayLike,
    thickness: npt.ArrayLike,
) -> FloatArray:
    """Return pi alpha B rotation^2 sqrt(R/h) - 2 pi R alpha M rotation, (S37).

    The energy of a spherical shell that bends only in the boundary layer, of width sqrt(R h),
    along its edge; with no moment it is that of the OOV, (S22).

    Args:
        rotation: Change Delta theta of the tangent angle, rad.
        edge_moment: Moment M per edge length.
        angle: Colatitude alpha of the edge, rad.
        radius: R.
        rigidity: Bending rigidity B.
        thickness: h.

    Returns:
        Energy.
    """
    rotation, moment, alpha = floats(rotation, edge_moment, angle)
    radius, rigidity, h = floats(radius, rigidity, thickness)
    bending = np.pi * alpha * rigidity * rotation**2 * np.sqrt(radius / h)
    energy: FloatArray = bending - 2 * np.pi * radius * alpha * moment * rotation
    return energy


def boundary_layer_rotation(
    edge_moment: npt.ArrayLike,
    radius: npt.ArrayLike,
    rigidity: npt.ArrayLike,
    thickness: npt.ArrayLike,
) -> FloatArray:
    """Return the rotation M sqrt(R h)/B that minimises `boundary_layer_energy`.

    With M ~ B kappa and kappa ~ 1/h it grows as sqrt(R/h), the scaling behind (5).

    Args:
        edge_moment: Moment M per edge length.
        radius: R.
        rigidity: Bending rigidity B.
        thickness: h.

    Returns:
        Delta theta, rad.
    """
    moment, radius, rigidity, h = floats(edge_moment, radius, rigidity, thickness)
    rotation: FloatArray = moment * np.sqrt(radius * h) / rigidity
    return rotation


def _isotropic(strain: FloatArray, poisson: npt.ArrayLike) -> FloatArray:
    (nu,) = floats(poisson)
    trace = np.trace(strain, axis1=-2, axis2=-1)
    square = np.trace(strain @ strain, axis1=-2, axis2=-1)
    norm: FloatArray = nu * trace**2 + (1 - nu) * square
    return norm
