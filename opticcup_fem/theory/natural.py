"""Natural stretch and curvature of a growing bilayer, and the energy that they minimise.

Index 1 is the outer layer (xi > 0, ECM), index 2 the inner one (IOV); m = h_1/h_2, n = mu_1/mu_2.
A positive kappa makes b more positive, against b_ref = -a_ref/R of the sphere: it inverts the cap.
Theory: docs/theory.md, "Natural stretch and curvature".
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from opticcup_fem.theory.arrays import FloatArray, floats
from opticcup_fem.theory.rigidity import lame_moduli


def natural_stretch(
    e_1: npt.ArrayLike,
    e_2: npt.ArrayLike,
    m: npt.ArrayLike,
    n: npt.ArrayLike,
    rho_1: npt.ArrayLike | None = None,
    rho_2: npt.ArrayLike | None = None,
) -> FloatArray:
    r"""Return the natural stretch :math:`\Lambda` of a thin bilayer, (S17).

    Its stress-free metric would be :math:`\bar a = \Lambda^2 \mathring a`. All arguments broadcast.

    Args:
        e_1: In-plane growth factor of the outer layer.
        e_2: In-plane growth factor of the inner layer.
        m: Thickness ratio h_1/h_2; 0 is the monolayer of layer 2, with Lambda = e_2.
        n: Modulus ratio mu_1/mu_2.
        rho_1: Density ratio J rho/rho_0 of the outer layer; None is density-preserving growth,
            e_1^2. Give 1 to neglect the mass change.
        rho_2: The same of the inner layer.

    Returns:
        Lambda, dimensionless.

    >>> print(f"{natural_stretch(1.0, 1.5, 1 / 9, 50.0):.6f}")
    1.365652
    """
    m, e_1, e_2 = floats(m, e_1, e_2)
    w_1, w_2 = _layer_weights(e_1, e_2, n, rho_1, rho_2)
    coupling = e_1**2 * (3 * m * (m + 1) + 1) + e_2**2 * (m * (m + 3) + 3)
    numerator = m**4 * w_1**2 * e_1**2 + m * w_1 * w_2 * coupling + w_2**2 * e_2**2
    return np.sqrt(numerator / _bending_determinant(m, w_1, w_2))


def natural_curvature(
    e_1: npt.ArrayLike,
    e_2: npt.ArrayLike,
    m: npt.ArrayLike,
    n: npt.ArrayLike,
    rho_1: npt.ArrayLike | None = None,
    rho_2: npt.ArrayLike | None = None,
) -> FloatArray:
    r"""Return the natural curvature :math:`\kappa h` of a thin bilayer, (S18).

    Its stress-free curvature would be :math:`\bar b = \Lambda^2 (\mathring b + \kappa \mathring
    a)`. Positive where the inner layer grows more.

    Args:
        e_1: In-plane growth factor of the outer layer.
        e_2: In-plane growth factor of the inner layer.
        m: Thickness ratio h_1/h_2; 0 is the monolayer, with kappa = 0.
        n: Modulus ratio mu_1/mu_2.
        rho_1: Density ratio of the outer layer, as in `natural_stretch`.
        rho_2: The same of the inner layer.

    Returns:
        kappa times the total thickness h, dimensionless.

    >>> print(f"{natural_curvature(1.0, 1.5, 1 / 9, 50.0):.4f}")
    0.5015
    """
    stretch = natural_stretch(e_1, e_2, m, n, rho_1, rho_2)
    m, e_1, e_2 = floats(m, e_1, e_2)
    w_1, w_2 = _layer_weights(e_1, e_2, n, rho_1, rho_2)
    difference = 3 * (e_1**2 - e_2**2) * m * (m + 1) ** 2 * w_1 * w_2
    # Adding 0 turns the -0.0 of equal growth into 0.0.
    return -difference / (_bending_determinant(m, w_1, w_2) * stretch**2) + 0.0


def cap_curvature(
    t_n: npt.ArrayLike,
    m: float = 1 / 9,
    n: float = 50.0,
    rates: tuple[float, float] = (0.0, 5.0),
    mass_change: bool = True,
) -> FloatArray:
    """Return kappa h of a cap whose layers grow as e = 1 + rate t_n, (S18).

    Args:
        t_n: Normalised time, any shape.
        m: Thickness ratio h_ECM/h_IOV.
        n: Modulus ratio mu_ECM/mu_IOV.
        rates: Growth rates of ECM and IOV; the defaults are measured in the chick.
        mass_change: True for density-preserving growth, False for a density ratio of 1.

    Returns:
        kappa h, same shape as `t_n`.
    """
    (t_n,) = floats(t_n)
    rho = None if mass_change else 1.0
    return natural_curvature(1 + rates[0] * t_n, 1 + rates[1] * t_n, m, n, rho, rho)


def projected_energy(
    a: npt.ArrayLike,
    b: npt.ArrayLike,
    a_ref: npt.ArrayLike,
    b_ref: npt.ArrayLike,
    e: tuple[float, float],
    rho: tuple[float, float],
    m: float,
    n: float,
    poisson: float,
    thickness: float = 1.0,
) -> FloatArray:
    r"""Return the energy density of a bilayer per reference area, (S16).

    .. math:: \Psi_{proj} = \sum_l \int_{h_l} \tfrac12 \rho^r_l
        A_l^{\alpha\beta\gamma\delta} \epsilon_{\alpha\beta} \epsilon_{\gamma\delta}\,d\xi, \quad
        \epsilon = \tfrac12 (a - 2 \xi b - e_l^2 (\mathring a - 2 \xi \mathring b))

    with A_l of the layer's own grown metric and the plane-stress modulus 2 lambda mu/(lambda +
    2 mu) in the place of lambda. Its minimiser in (a, b) is Lambda and kappa for h/R -> 0,
    whatever the Poisson ratio.

    Args:
        a: Current metric, covariant, shape (..., 2, 2).
        b: Current curvature, covariant, shape (..., 2, 2), 1/length.
        a_ref: Reference metric, shape (2, 2), positive definite.
        b_ref: Reference curvature, shape (2, 2); -a_ref/R on the sphere.
        e: Growth factors of layers 1 (outer) and 2 (inner).
        rho: Density ratios of layers 1 and 2.
        m: Thickness ratio h_1/h_2.
        n: Modulus ratio mu_1/mu_2.
        poisson: Poisson ratio of both layers.
        thickness: Total thickness h.

    Returns:
        Energy per area in units of mu_2 times length, shape (...).
    """
    a, b, a_ref, b_ref = floats(a, b, a_ref, b_ref)
    split = thickness * (0.5 - m / (1 + m))
    layers = ((split, thickness / 2, e[0], n * rho[0]), (-thickness / 2, split, e[1], rho[1]))
    # The integrand is polynomial but for the inverse grown metric: 8 points leave rounding only.
    points, weights = np.polynomial.legendre.leggauss(8)
    lmbda, mu = lame_moduli(1.0, poisson)
    lmbda_ps = 2 * lmbda * mu / (lmbda + 2 * mu)
    total: FloatArray = np.zeros(np.broadcast_shapes(a.shape[:-2], b.shape[:-2]))
    for bottom, top, growth, stiffness in layers:
        for point, weight in zip(points, weights, strict=True):
            xi = (bottom + top) / 2 + point * (top - bottom) / 2
            g_nat = growth**2 * (a_ref - 2 * xi * b_ref)
            strain = np.linalg.inv(g_nat) @ (a - 2 * xi * b - g_nat) / 2
            trace = np.trace(strain, axis1=-2, axis2=-1)
            square = np.trace(strain @ strain, axis1=-2, axis2=-1)
            density = stiffness * (lmbda_ps / 2 * trace**2 + mu * square)
            total = total + weight * (top - bottom) / 2 * density
    return total


def _layer_weights(
    e_1: FloatArray,
    e_2: FloatArray,
    n: npt.ArrayLike,
    rho_1: npt.ArrayLike | None,
    rho_2: npt.ArrayLike | None,
) -> tuple[FloatArray, FloatArray]:
    """Return n rho_1/e_1^4 and rho_2/e_2^4, the layers' stiffness against a change of metric.

    (S17) and (S18) divided by e_1^8 e_2^8 hold nothing else than these weights.
    """
    (n,) = floats(n)
    (ratio_1,) = floats(e_1**2 if rho_1 is None else rho_1)
    (ratio_2,) = floats(e_2**2 if rho_2 is None else rho_2)
    return n * ratio_1 / e_1**4, ratio_2 / e_2**4


def _bending_determinant(m: FloatArray, w_1: FloatArray, w_2: FloatArray) -> FloatArray:
    return m**4 * w_1**2 + 2 * m * (m * (2 * m + 3) + 2) * w_1 * w_2 + w_2**2
