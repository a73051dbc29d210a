"""Free circular bilayer plates and shallow open caps: span, buckling, and the limit of snapping.

chi links stretch and curvature of a bilayer with a passive outer layer, Lambda^2 = 1 + 2 chi kappa
h, to first order in the growth. Theory: docs/theory.md, "Plates and open caps".
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from opticcup_fem.theory.arrays import FloatArray, floats


def chi(m: npt.ArrayLike, n: npt.ArrayLike) -> FloatArray:
    """Return chi = (1 + m (3 n - 2))/(6 m n), (S34), an expansion for small m.

    Args:
        m: Thickness ratio h_1/h_2, outer over inner, above 0.
        n: Modulus ratio mu_1/mu_2.

    Returns:
        chi, dimensionless; the scaling laws of the paper use this one.

    >>> print(f"{chi(1 / 9, 50.0):.4f}")
    0.5233
    """
    m, n = floats(m, n)
    return (1 + m * (3 * n - 2)) / (6 * m * n)


def chi_small_growth(m: npt.ArrayLike, n: npt.ArrayLike) -> FloatArray:
    """Return the exact limit of (Lambda^2 - 1)/(2 kappa h) for e_1 = 1, e_2 -> 1.

    (1 + m n (m^2 + 3 m + 3))/(6 m n (1 + m)^2), from (S17) and (S18) with no expansion in m.

    Args:
        m: Thickness ratio h_1/h_2, above 0.
        n: Modulus ratio mu_1/mu_2.

    Returns:
        chi, dimensionless.

    >>> print(f"{chi_small_growth(1 / 9, 50.0):.4f}")
    0.4760
    """
    m, n = floats(m, n)
    value: FloatArray = (1 + m * n * (m * (m + 3) + 3)) / (6 * m * n * (1 + m) ** 2)
    return value


def plate_buckling_factor(chi_value: npt.ArrayLike, poisson: npt.ArrayLike) -> FloatArray:
    """Return a_b = chi (5 + 3 nu)/(1 - nu^2), below (4).

    Args:
        chi_value: chi.
        poisson: Poisson ratio nu.

    Returns:
        a_b, dimensionless.

    >>> print(f"{plate_buckling_factor(chi(1 / 9, 50.0), 0.45):.3f}")
    4.167
    """
    value, nu = floats(chi_value, poisson)
    factor: FloatArray = value * (5 + 3 * nu) / (1 - nu**2)
    return factor


def plate_buckling_curvature(
    radius_over_thickness: npt.ArrayLike, chi_value: npt.ArrayLike, poisson: npt.ArrayLike
) -> FloatArray:
    """Return kappa h = a_b (h/Rp)^2 at which a free disc leaves axisymmetry, (S35).

    The negative value buckles likewise.

    Args:
        radius_over_thickness: Rp/h.
        chi_value: chi.
        poisson: Poisson ratio nu.

    Returns:
        Critical kappa h, positive.
    """
    (ratio,) = floats(radius_over_thickness)
    curvature: FloatArray = plate_buckling_factor(chi_value, poisson) / ratio**2
    return curvature


def plate_buckling_curvature_by_energy(radius_over_thickness: npt.ArrayLike) -> FloatArray:
    """Return kappa h = sqrt(10 + 7 sqrt 2) (h/Rp)^2, end of SI section VIII.

    From comparing the energies of a spherical and a cylindrical disc. The scanned text draws the
    square root over (h/Rp)^2 as well; the law it cites has it over the number alone.

    Args:
        radius_over_thickness: Rp/h.

    Returns:
        Critical kappa h, positive.
    """
    (ratio,) = floats(radius_over_thickness)
    curvature: FloatArray = np.sqrt(10 + 7 * np.sqrt(2)) / ratio**2
    return curvature


def plate_buckling_curvature_of_stretch(
    stretch: npt.ArrayLike,
    radius: npt.ArrayLike,
    poisson: npt.ArrayLike,
    n_1: int = 1,
    n_3: int = 2,
) -> FloatArray:
    """Return the positive root kappa of the linear stability analysis of a disc, (S33).

    Args:
        stretch: Natural stretch Lambda of the plate, at least 1.
        radius: Rp.
        poisson: Poisson ratio nu.
        n_1: Circumferential number of the in-plane mode; 1 gives the lowest curvature.
        n_3: The same of the deflection; 2 gives (S35).

    Returns:
        Critical kappa, 1/length.
    """
    stretch, radius, nu = floats(stretch, radius, poisson)
    area = stretch**2
    # For whole n_1 and n_3 the sines of (S33) vanish.
    shape = np.pi * n_1 * ((1 - nu) * n_1**2 + 4 * (1 + nu))
    numerator = 2 * (area - 1) * shape
    denominator = radius**2 * area**2 * (1 - nu**2) * n_1 * np.pi * n_3**2
    curvature: FloatArray = np.sqrt(numerator / denominator)
    return curvature


def span(
    radius: npt.ArrayLike,
    curvature_times_thickness: npt.ArrayLike,
    chi_value: npt.ArrayLike,
    poisson: npt.ArrayLike,
) -> FloatArray:
    """Return the characteristic span S = Rp (1 + chi (1 + nu) kappa h), (S36).

    For the cap put R alpha in the place of Rp.

    Args:
        radius: Rp.
        curvature_times_thickness: Natural curvature kappa h.
        chi_value: chi.
        poisson: Poisson ratio nu.

    Returns:
        Span, in the unit of `radius`.
    """
    radius, kappa_h, value, nu = floats(radius, curvature_times_thickness, chi_value, poisson)
    return radius * (1 + value * (1 + nu) * kappa_h)


def horizontal_curvature(
    angle: npt.ArrayLike,
    radius_over_thickness: npt.ArrayLike,
    poisson: npt.ArrayLike,
    stretch: npt.ArrayLike = 1.0,
) -> FloatArray:
    """Return kappa_h R that turns the edge tangent of an open cap horizontal, (S25).

    It grows without bound as theta_bar nears `snapping_limit` from below (for small angles), and
    is negative beyond: past the limit no smooth eversion passes through the horizontal tangent.

    Args:
        angle: Opening angle alpha, rad.
        radius_over_thickness: R/h.
        poisson: Poisson ratio nu.
        stretch: Natural stretch Lambda of the cap.

    Returns:
        kappa_h R, dimensionless.
    """
    alpha, ratio, nu, stretch = floats(angle, radius_over_thickness, poisson, stretch)
    eta, area = 1 / ratio, stretch**2
    squared = alpha**2 * (1 + nu)
    bending = area * (1 + nu) * (squared + 9) - squared * (1 + nu) - 9 * nu - 3
    membrane = alpha**2 * (1 - area) * (1 - nu**2) * (3 * squared + 20)
    denominator = 5 * eta**2 * (squared + 6) - 3 * alpha**4 * (1 - nu**2)
    numerator = 10 * eta**2 * bending + 3 * membrane
    curvature: FloatArray = numerator / (2 * area * (1 + nu) * denominator)
    return curvature


def snapping_limit(poisson: npt.ArrayLike) -> FloatArray:
    """Return theta_s = (10/(1 - nu^2))^(1/4), (S26): open caps snap above, evert smoothly below.

    Args:
        poisson: Poisson ratio nu.

    Returns:
        theta_bar at the limit.

    >>> print(f"{snapping_limit(0.45):.4f}")
    1.8818
    """
    (nu,) = floats(poisson)
    limit: FloatArray = (10 / (1 - nu**2)) ** 0.25
    return limit
