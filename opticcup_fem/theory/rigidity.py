"""Moduli and rigidities of the layers and of the cap as a whole.

Theory: docs/theory.md, "Rigidities and the OOV as a rotational spring".
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from opticcup_fem.theory.arrays import FloatArray, floats


def lame_moduli(mu: npt.ArrayLike, poisson: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return lambda = 2 mu nu/(1 - 2 nu) and mu, (S8).

    Args:
        mu: Shear modulus.
        poisson: Poisson ratio, below 0.5.

    Returns:
        lambda and mu, in the unit of `mu`.
    """
    mu, nu = floats(mu, poisson)
    return 2 * mu * nu / (1 - 2 * nu), mu


def effective_modulus_ratio(m: npt.ArrayLike, n: npt.ArrayLike) -> FloatArray:
    """Return E_eff/E_IOV = (1 + m n)/(1 + m) of the cap, (S20)-(S21).

    The modulus of the bilayer averaged through the thickness, as the paper takes it also for
    bending; it leaves out that the stiff layer lies at the surface.

    Args:
        m: Thickness ratio h_ECM/h_IOV.
        n: Modulus ratio mu_ECM/mu_IOV.

    Returns:
        The ratio, dimensionless.
    """
    m, n = floats(m, n)
    return (1 + m * n) / (1 + m)


def membrane_rigidity(
    young: npt.ArrayLike, poisson: npt.ArrayLike, thickness: npt.ArrayLike
) -> FloatArray:
    """Return Y = E h/(1 - nu^2), (S13).

    Args:
        young: Young's modulus E.
        poisson: Poisson ratio nu.
        thickness: Thickness h.

    Returns:
        Y, in stress times length.
    """
    young, nu, h = floats(young, poisson, thickness)
    rigidity: FloatArray = young * h / (1 - nu**2)
    return rigidity


def bending_rigidity(
    young: npt.ArrayLike, poisson: npt.ArrayLike, thickness: npt.ArrayLike
) -> FloatArray:
    """Return B = E h^3/(12 (1 - nu^2)), (S13).

    Args:
        young: Young's modulus E.
        poisson: Poisson ratio nu.
        thickness: Thickness h.

    Returns:
        B, in stress times length cubed.
    """
    (h,) = floats(thickness)
    rigidity: FloatArray = membrane_rigidity(young, poisson, h) * h**2 / 12
    return rigidity


def spring_ratio(m: npt.ArrayLike, n: npt.ArrayLike, poisson: npt.ArrayLike) -> FloatArray:
    """Return Gamma = B_OOV/(2 B_cap (1 + nu)), (2) and (S24).

    The OOV resists the rotation of the cap's edge as a spring of this relative stiffness. OOV and
    cap have the same thickness, the OOV the modulus of the IOV.

    Args:
        m: Thickness ratio h_ECM/h_IOV.
        n: Modulus ratio mu_ECM/mu_IOV.
        poisson: Poisson ratio of all layers.

    Returns:
        Gamma, dimensionless.

    >>> print(f"{spring_ratio(1 / 9, 50.0, 0.45):.5f}")
    0.05845
    """
    (nu,) = floats(poisson)
    return 1 / (2 * (1 + nu) * effective_modulus_ratio(m, n))


def equivalent_curvature(
    curvature: npt.ArrayLike,
    gamma: npt.ArrayLike,
    rotation: npt.ArrayLike,
    radius: npt.ArrayLike,
    thickness: npt.ArrayLike,
) -> FloatArray:
    """Return kappa_eq = kappa_cap - Gamma rotation/sqrt(R h), (2) and (S24).

    What is left of the cap's natural curvature once it has bent the OOV boundary layer.

    Args:
        curvature: Natural curvature of the cap, 1/length.
        gamma: Gamma, as `spring_ratio` gives it.
        rotation: Change Delta theta of the tangent angle along the OOV boundary layer, rad.
        radius: R.
        thickness: h, in the unit of `radius`.

    Returns:
        Natural curvature acting on a free-standing cap, 1/length.
    """
    kappa, gamma, rotation, length, h = floats(curvature, gamma, rotation, radius, thickness)
    equivalent: FloatArray = kappa - gamma * rotation / np.sqrt(length * h)
    return equivalent
