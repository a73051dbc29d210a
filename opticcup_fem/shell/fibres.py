r"""A shell's fibres: invariants of the surface, Gauss points of the layers, sums over them.

All closures see the shell through five numbers at a point of the surface,

    A = det a / det a_ref,  B = cof a : b / det a_ref,  C = det b / det a_ref,
    P = tr(a_ref^-1 a),     Q = tr(a_ref^-1 b).

At height xi, with s = -2 xi lambda_3 and the grown metric g_nat = q a_ref,
q = e^2 (1 - 2 xi k) where b_ref = k a_ref (k = -1/R on the sphere, 0 on the plane),

    D = J_s^2 = (A + s B + s^2 C)/q^2,   T = g_nat^ab g_ab = (P + s Q)/q,
    Psi_0 = lambda/4 (D l^2 - 1 - ln(D l^2)) + mu/2 (T + l^2 - 3 - ln(D l^2))     (S8)

with the plane-stress stretch l^2 = (lambda + 2 mu)/(lambda D + 2 mu) = 1/(1 + k (D - 1)),
k = nu/(1 - nu).  At nu = 1/2 (k = 1) it is J = 1, and the first term of Psi_0 vanishes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.shell.section import Layer, Section

Array = NDArray[np.float64]


class GrowthState(NamedTuple):
    """Growth of one layer at a set of points, and what is uneven in the layer.

    Attributes:
        factor: In-plane growth factor e, broadcastable to shape (n,).
        density_ratio: Stress factor rho_r = J rho/rho_0 (S12), likewise.
        stiffness: Factor on both Lamé constants, likewise.
        thickness: Factor on the thickness at rest, likewise.
    """

    factor: Array | float
    density_ratio: Array | float
    stiffness: Array | float = 1.0
    thickness: Array | float = 1.0


class Resultants(NamedTuple):
    """Energy per reference area and its derivatives at n points.

    Attributes:
        energy: W, shape (n,).
        stress: First variation, shape (n, 6), conjugate to (a_11, a_22, a_12, b_11, b_22, b_12).
        tangent: Derivative of ``stress``, shape (n, 6, 6); None when it was not asked for.
    """

    energy: Array
    stress: Array
    tangent: Array | None


class LostFibre(FloatingPointError):
    """A layer has no admissible state at some point: its metric or its lambda_3 is lost.

    Attributes:
        index: Index of the worst point among those passed in.
        layer: Name of the layer.
        height: Height xi of the Gauss point.
        cause: "metric" (the fibre is turned inside out) or "root" (no lambda_3 exists).
    """

    def __init__(self, index: int, layer: str, height: float, cause: str) -> None:
        """Keep place and height for the report."""
        super().__init__(f"{cause} lost at point {index}, layer {layer}, height {height:.6g}")
        self.index, self.layer, self.height, self.cause = index, layer, height, cause

    def __reduce__(self) -> tuple[type[LostFibre], tuple[int, str, float, str]]:
        """Pickle by fields, so that ranks can exchange it."""
        return type(self), (self.index, self.layer, self.height, self.cause)


class Invariants(NamedTuple):
    """The five numbers (A, B, C, P, Q), each of shape (n,)."""

    A: Array
    B: Array
    C: Array
    P: Array
    Q: Array


def invariants(forms: Array, a_ref: Array) -> Invariants:
    """Return the five invariants of the fundamental forms.

    Args:
        forms: (a_11, a_22, a_12, b_11, b_22, b_12) at n points, shape (n, 6).
        a_ref: Reference metric (11, 22, 12) in the same frame, shape (n, 3).
    """
    a1, a2, a3, b1, b2, b3 = forms.T
    r1, r2, r3 = a_ref.T
    inverse = 1 / (r1 * r2 - r3 * r3)
    return Invariants(
        (a1 * a2 - a3 * a3) * inverse,
        (a1 * b2 + a2 * b1 - 2 * a3 * b3) * inverse,
        (b1 * b2 - b3 * b3) * inverse,
        (r2 * a1 + r1 * a2 - 2 * r3 * a3) * inverse,
        (r2 * b1 + r1 * b2 - 2 * r3 * b3) * inverse,
    )


@dataclass(frozen=True)
class Fibre:
    """A Gauss point of a layer, at n points of the surface.

    Attributes:
        layer: The layer.
        height: Height xi, broadcastable to (n,).
        gauss_weight: Quadrature weight, in units of length, broadcastable to (n,).
        share: Quadrature weight over the layer's thickness.
        stress_factor: rho_r times the factor on the Lamé constants, broadcastable to (n,).
        growth: Growth factor e, broadcastable to (n,).
        natural: q = e^2 (1 - 2 xi k), broadcastable to (n,).
    """

    layer: Layer
    height: Array | float
    gauss_weight: Array | float
    share: float
    stress_factor: Array | float
    growth: Array | float
    natural: Array | float

    @property
    def weight(self) -> Array | float:
        """Quadrature weight times stress factor."""
        return self.gauss_weight * self.stress_factor

    def lost(self, bad: Array, cause: str) -> LostFibre:
        """Return the exception that reports the worst of the points where ``bad`` is largest."""
        worst = int(np.argmax(bad))
        height = float(np.broadcast_to(self.height, np.shape(bad))[worst])
        return LostFibre(worst, self.layer.name, height, cause)


class Sums:
    """Accumulates energy, gradient (5) and Hessian (5, 5) in the invariants."""

    def __init__(self, n: int, tangent: bool) -> None:
        """Start at zero for n points, with a Hessian if ``tangent``."""
        self.energy = np.zeros(n)
        self.gradient = np.zeros((5, n))
        self.hessian = np.zeros((5, 5, n)) if tangent else None


def plane_stress_stretch(area_ratio: Array, layer: Layer) -> Array:
    """Return lambda_3^2 = 1/(1 + k (J_s^2 - 1)), k = nu/(1 - nu), the root of Sigma^33 = 0.

    Args:
        area_ratio: J_s^2, any shape, dimensionless.
        layer: Supplies nu; at one half lambda_3 is 1/J_s.
    """
    return np.asarray(1 / (1 + layer.contraction * (area_ratio - 1)), dtype=np.float64)


def area_slope(D: Array, m: Array, layer: Layer) -> Array:
    """Return dPsi_0/dD at fixed m = lambda_3^2; it is -mu m/(2 D) in plane stress.

    Args:
        D: J_s^2, shape (n,).
        m: lambda_3^2, same shape; that of plane stress where the layer is incompressible.
        layer: The layer.
    """
    mu = layer.shear_modulus
    if layer.is_incompressible:
        return np.asarray(-mu * m / (2 * D))
    return np.asarray(layer.lame / 4 * (m - 1 / D) - mu / (2 * D))


def area_ratio(inv: Invariants, s: Array | float, fibre: Fibre) -> Array:
    """Return D = J_s^2, refusing fibres whose metric g is not positive definite.

    Turned inside out once, g has a negative determinant; twice, a negative trace.
    """
    ratio: Array = (inv.A + s * inv.B + s * s * inv.C) / np.square(fibre.natural)
    smallest = np.minimum(ratio, (inv.P + s * inv.Q) / fibre.natural)
    if not np.all(smallest > 0):
        raise fibre.lost(np.where(np.isfinite(smallest), -smallest, np.inf), "metric")
    return ratio


def energy_density(inv: Invariants, s: Array | float, D: Array, m: Array, fibre: Fibre) -> Array:
    """Return Psi_0 (S8) for D = J_s^2 and m = lambda_3^2."""
    T = (inv.P + s * inv.Q) / fibre.natural
    log = np.log(D * m)
    density: Array = fibre.layer.shear_modulus / 2 * (T + m - 3 - log)
    if not fibre.layer.is_incompressible:
        density += fibre.layer.lame / 4 * (D * m - 1 - log)
    return density


def fibres(section: Section, growth: Sequence[GrowthState], k_ref: float) -> Iterator[Fibre]:
    """Yield the Gauss points of a section, innermost first."""
    rules = section.gauss_points_of([state.thickness for state in growth])
    for layer, (heights, weights), (_, even), state in zip(
        section.layers, rules, section.gauss_points, growth, strict=True
    ):
        shares = even / layer.thickness
        stress_factor = state.density_ratio * state.stiffness
        for xi, w, share in zip(heights, weights, shares, strict=True):
            natural = np.square(state.factor) * (1 - 2 * xi * k_ref)
            yield Fibre(layer, xi, w, float(share), stress_factor, state.factor, natural)


def to_components(sums: Sums, forms: Array, a_ref: Array) -> Resultants:
    """Change from the invariants to the components of a and b (chain rule)."""
    a1, a2, a3, b1, b2, b3 = forms.T
    r1, r2, r3 = a_ref.T
    o = np.zeros_like(a1)
    inverse = 1 / (r1 * r2 - r3 * r3)
    rows = [
        [a2, a1, -2 * a3, o, o, o],
        [b2, b1, -2 * b3, a2, a1, -2 * a3],
        [o, o, o, b2, b1, -2 * b3],
        [r2, r1, -2 * r3, o, o, o],
        [o, o, o, r2, r1, -2 * r3],
    ]
    jacobian = np.ascontiguousarray(np.array(rows).transpose(2, 0, 1)) * inverse[:, None, None]
    stress = np.einsum("in,nij->nj", sums.gradient, jacobian)
    if sums.hessian is None:
        return Resultants(sums.energy, stress, None)
    hessian = np.ascontiguousarray(sums.hessian.transpose(2, 0, 1))
    tangent = jacobian.transpose(0, 2, 1) @ (hessian @ jacobian)
    # second derivatives of A, B, C in the components
    for value, (i, j, ij) in (
        (sums.gradient[0], (0, 1, 2)),
        (sums.gradient[2], (3, 4, 5)),
    ):
        tangent[:, i, j] += value * inverse
        tangent[:, j, i] += value * inverse
        tangent[:, ij, ij] -= 2 * value * inverse
    mixed = sums.gradient[1] * inverse
    for i, j, factor in ((0, 4, 1.0), (1, 3, 1.0), (2, 5, -2.0)):
        tangent[:, i, j] += factor * mixed
        tangent[:, j, i] += factor * mixed
    return Resultants(sums.energy, stress, tangent)
