r"""Constitutive resultants of a layered shell under the readings ("closures") of plane stress.

All closures see the shell through five numbers at a point of the surface,

    A = det a / det a_ref,  B = cof a : b / det a_ref,  C = det b / det a_ref,
    P = tr(a_ref^-1 a),     Q = tr(a_ref^-1 b).

At height xi, with s = -2 xi lambda_3 and the grown metric g_nat = q a_ref,
q = e^2 (1 - 2 xi k) where b_ref = k a_ref (k = -1/R on the sphere, 0 on the plane),

    D = J_s^2 = (A + s B + s^2 C)/q^2,   T = g_nat^ab g_ab = (P + s Q)/q,
    Psi_0 = lambda/4 (D l^2 - 1 - ln(D l^2)) + mu/2 (T + l^2 - 3 - ln(D l^2))     (S8)

with the plane-stress stretch l^2 = (lambda + 2 mu)/(lambda D + 2 mu).  The closures differ in
which lambda_3 enters s (docs/theory.md, "Closures").  Resultants are conjugate to the components
(a_11, a_22, a_12, b_11, b_22, b_12), per reference area; N = 2 dW/da, M = dW/db.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.shell.section import Layer, Section

Array = NDArray[np.float64]


class GrowthState(NamedTuple):
    """Growth of one layer at a set of points.

    Attributes:
        factor: In-plane growth factor e, broadcastable to shape (n,).
        density_ratio: Stress factor rho_r = J rho/rho_0 (S12), likewise.
    """

    factor: Array | float
    density_ratio: Array | float


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
        height: Height xi.
        gauss_weight: Quadrature weight, in units of length.
        density_ratio: Stress factor rho_r, broadcastable to (n,).
        growth: Growth factor e, broadcastable to (n,).
        natural: q = e^2 (1 - 2 xi k), broadcastable to (n,).
    """

    layer: Layer
    height: float
    gauss_weight: float
    density_ratio: Array | float
    growth: Array | float
    natural: Array | float

    @property
    def weight(self) -> Array | float:
        """Quadrature weight times density ratio."""
        return self.gauss_weight * self.density_ratio

    def lost(self, bad: Array, cause: str) -> LostFibre:
        """Return the exception that reports the worst of the points where ``bad`` is largest."""
        return LostFibre(int(np.argmax(bad)), self.layer.name, self.height, cause)


class _Sums:
    """Accumulates energy, gradient (5) and Hessian (5, 5) in the invariants."""

    def __init__(self, n: int, tangent: bool) -> None:
        self.energy = np.zeros(n)
        self.gradient = np.zeros((5, n))
        self.hessian = np.zeros((5, 5, n)) if tangent else None


def plane_stress_stretch(area_ratio: Array, layer: Layer) -> Array:
    """Return lambda_3^2 = (lambda + 2 mu)/(lambda J_s^2 + 2 mu), the root of Sigma^33 = 0.

    Args:
        area_ratio: J_s^2, any shape, dimensionless.
        layer: Supplies the Lamé constants.
    """
    lmbda, mu = layer.lame, layer.shear_modulus
    return (lmbda + 2 * mu) / (lmbda * area_ratio + 2 * mu)


def area_ratio(inv: Invariants, s: Array | float, fibre: Fibre) -> Array:
    """Return D = J_s^2, refusing fibres that are turned inside out."""
    ratio: Array = (inv.A + s * inv.B + s * s * inv.C) / np.square(fibre.natural)
    if not np.all(ratio > 0):
        raise fibre.lost(np.where(np.isfinite(ratio), -ratio, np.inf), "metric")
    return ratio


def _energy_density(inv: Invariants, s: Array | float, D: Array, m: Array, fibre: Fibre) -> Array:
    """Return Psi_0 (S8) for D = J_s^2 and m = lambda_3^2."""
    lmbda, mu = fibre.layer.lame, fibre.layer.shear_modulus
    T = (inv.P + s * inv.Q) / fibre.natural
    log = np.log(D * m)
    density: Array = lmbda / 4 * (D * m - 1 - log) + mu / 2 * (T + m - 3 - log)
    return density


def _add_energy_fibre(
    sums: _Sums, inv: Invariants, fibre: Fibre, s: Array, s_1: Array, s_2: Array
) -> None:
    """Add a fibre of a closure with an energy, whose s = -2 xi lambda_3 is a function of A.

    Psi_0 is stationary in its own lambda_3 (plane stress), which the first derivatives may
    therefore hold fixed; s_1 and s_2 are the first and second derivatives of s in A.
    """
    lmbda, mu = fibre.layer.lame, fibre.layer.shear_modulus
    w, q = fibre.weight, fibre.natural
    per_q2 = 1 / np.square(q)
    D = area_ratio(inv, s, fibre)
    m = plane_stress_stretch(D, fibre.layer)
    sums.energy += w * _energy_density(inv, s, D, m, fibre)
    psi_D = w * (lmbda / 4 * (m - 1 / D) - mu / (2 * D))
    psi_T = w * mu / 2
    D_s = inv.B + 2 * s * inv.C
    dD = ((1 + s_1 * D_s) * per_q2, s * per_q2, s * s * per_q2)
    g = sums.gradient
    g[0] += psi_D * dD[0] + psi_T * s_1 * inv.Q / q
    g[1] += psi_D * dD[1]
    g[2] += psi_D * dD[2]
    g[3] += psi_T / q
    g[4] += psi_T * s / q
    if sums.hessian is None:
        return
    H = sums.hessian
    m_D = -lmbda * m / (lmbda * D + 2 * mu)
    psi_DD = w * (lmbda / 4 * (m_D + 1 / D**2) + mu / (2 * D**2))
    for i in range(3):
        for j in range(3):
            H[i, j] += psi_DD * dD[i] * dD[j]
    H[0, 0] += psi_D * (s_2 * D_s + 2 * s_1 * s_1 * inv.C) * per_q2 + psi_T * s_2 * inv.Q / q
    for j, value in (
        (1, psi_D * s_1 * per_q2),
        (2, psi_D * 2 * s * s_1 * per_q2),
        (4, psi_T * s_1 / q),
    ):
        H[0, j] += value
        H[j, 0] += value


def _layer_stretch(sums: _Sums, inv: Invariants, fibre: Fibre) -> None:
    """Closure ``layer-stretch``: s from the layer's mid-surface stretch l(A)."""
    slope = fibre.layer.lame / np.power(fibre.growth, 4)
    denominator = slope * inv.A + 2 * fibre.layer.shear_modulus
    s = -2 * fibre.height * mid_surface_stretch(inv, fibre)
    s_1 = -s * slope / (2 * denominator)
    s_2 = 3 * s * slope * slope / (4 * denominator**2)
    _add_energy_fibre(sums, inv, fibre, s, s_1, s_2)


def _condensed(sums: _Sums, inv: Invariants, fibre: Fibre) -> None:
    """Closure ``condensed``: lambda_3 = 1 in the metric, Psi_0 condensed at each height."""
    s = -2 * fibre.height * unit_stretch(inv, fibre)
    zero = np.zeros_like(s)
    _add_energy_fibre(sums, inv, fibre, s, zero, zero)


def _add_held_fibre(
    sums: _Sums, inv: Invariants, fibre: Fibre, stretch: Array, stretch_D: Array, D_abc: Array
) -> None:
    """Add a fibre of a closure that holds lambda_3 fixed in both derivatives (S7).

    Args:
        sums: Receives the fibre.
        inv: Invariants.
        fibre: The Gauss point.
        stretch: lambda_3, shape (n,), in the metric and in the stress.
        stretch_D: Derivative of ``stretch`` in the area ratio that it is a function of.
        D_abc: Derivatives of that area ratio in (A, B, C), shape (3, n).
    """
    lmbda, mu = fibre.layer.lame, fibre.layer.shear_modulus
    w, q = fibre.weight, fibre.natural
    per_q2 = 1 / np.square(q)
    s = -2 * fibre.height * stretch
    D = area_ratio(inv, s, fibre)
    m = stretch**2
    sums.energy += w * _energy_density(inv, s, D, m, fibre)
    psi_D = w * (lmbda / 4 * (m - 1 / D) - mu / (2 * D))
    psi_T = w * mu / 2
    g = sums.gradient
    for i, power in enumerate((1.0, s, s * s)):
        g[i] += psi_D * power * per_q2
    g[3] += psi_T / q
    g[4] += psi_T * s / q
    if sums.hessian is None:
        return
    ds = -2 * fibre.height * stretch_D * D_abc
    explicit = np.stack([np.ones_like(s), s, s * s])
    dD = (explicit + (inv.B + 2 * s * inv.C) * ds) * per_q2
    dm = 2 * stretch * stretch_D * D_abc
    d_psi = w * (lmbda / 4 * (dm + dD / D**2) + mu / (2 * D**2) * dD)
    H = sums.hessian
    H[0, :3] += d_psi * per_q2
    H[1, :3] += (d_psi * s + psi_D * ds) * per_q2
    H[2, :3] += (d_psi * s * s + 2 * psi_D * s * ds) * per_q2
    H[4, :3] += psi_T * ds / q


def _stretch_and_slope(D: Array, layer: Layer) -> tuple[Array, Array]:
    """Return lambda_3 of plane stress at J_s^2 = D and its derivative in D."""
    stretch = np.sqrt(plane_stress_stretch(D, layer))
    slope = -layer.lame * stretch / (2 * (layer.lame * D + 2 * layer.shear_modulus))
    return stretch, slope


def _closed_form(sums: _Sums, inv: Invariants, fibre: Fibre) -> None:
    """Closure ``closed-form``: lambda_3 from J_s of the metric taken at lambda_3 = 1."""
    s = -2 * fibre.height
    D = area_ratio(inv, s, fibre)
    stretch, slope = _stretch_and_slope(D, fibre.layer)
    per_q2 = np.broadcast_to(1 / np.square(fibre.natural), D.shape)
    _add_held_fibre(sums, inv, fibre, stretch, slope, np.stack([per_q2, s * per_q2, s * s * per_q2]))


def _paper(sums: _Sums, inv: Invariants, fibre: Fibre) -> None:
    """Closure ``paper``: lambda_3 of the same height, from the implicit plane-stress equation."""
    D = _implicit_area_ratio(inv, fibre)
    stretch, slope = _stretch_and_slope(D, fibre.layer)
    s = -2 * fibre.height * stretch
    per_q2 = 1 / np.square(fibre.natural)
    regularity = 1 + 2 * fibre.height * slope * (inv.B + 2 * s * inv.C) * per_q2
    if not np.all(regularity > 0):
        raise fibre.lost(-regularity, "root")
    D_abc = np.stack([np.ones_like(s), s, s * s]) * per_q2 / regularity
    _add_held_fibre(sums, inv, fibre, stretch, slope, D_abc)


def mid_surface_stretch(inv: Invariants, fibre: Fibre) -> Array:
    """Return the plane-stress stretch of the fibre's layer at the mid-surface strain."""
    return np.sqrt(plane_stress_stretch(inv.A / np.power(fibre.growth, 4), fibre.layer))


def unit_stretch(inv: Invariants, fibre: Fibre) -> Array:
    """Return ones."""
    return np.ones_like(inv.A)


def closed_form_stretch(inv: Invariants, fibre: Fibre) -> Array:
    """Return the plane-stress stretch at J_s of the metric taken at lambda_3 = 1."""
    return np.sqrt(plane_stress_stretch(area_ratio(inv, -2 * fibre.height, fibre), fibre.layer))


def implicit_stretch(inv: Invariants, fibre: Fibre) -> Array:
    """Return the root of the implicit plane-stress equation at the fibre's height."""
    return np.sqrt(plane_stress_stretch(_implicit_area_ratio(inv, fibre), fibre.layer))


def _implicit_area_ratio(inv: Invariants, fibre: Fibre, tolerance: float = 1e-14) -> Array:
    """Solve D q^2 = A + s(D) B + s(D)^2 C for D, with s = -2 xi lambda_3(D), by Newton's method.

    Starts at the explicit value with lambda_3 = 1 (or the mid-surface's where that is negative);
    a step may take D down by at most nine tenths.

    Raises:
        LostFibre: There is no root: cause "root".
    """
    per_q2 = 1 / np.square(fibre.natural)
    s: Array | float = -2 * fibre.height
    D = (inv.A + s * inv.B + s * s * inv.C) * per_q2
    D = np.where(D > 1e-12, D, inv.A * per_q2)
    change = np.full_like(D, np.inf)
    for _ in range(60):
        stretch, slope = _stretch_and_slope(D, fibre.layer)
        s, s_D = -2 * fibre.height * stretch, -2 * fibre.height * slope
        residual = D - (inv.A + s * inv.B + s * s * inv.C) * per_q2
        derivative = 1 - (inv.B + 2 * s * inv.C) * per_q2 * s_D
        with np.errstate(divide="ignore", invalid="ignore"):
            change = -residual / derivative
        if not np.isfinite(change).all():
            break
        change = np.maximum(change, -0.9 * D)
        D = D + change
        if np.all(np.abs(change) <= tolerance * D):
            return D
    relative = np.abs(change) / D
    if np.nanmax(np.where(np.isfinite(relative), relative, np.inf)) <= 1e-12:
        return D
    raise fibre.lost(np.where(np.isfinite(relative), relative, np.inf), "root")


class Closure(NamedTuple):
    """A reading of the plane-stress condition.

    Attributes:
        add: Adds energy, stress and tangent of a fibre to the sums.
        metric_stretch: lambda_3 that enters the metric at the fibre's height.
        has_energy: Whether virtual work is the derivative of an energy (symmetric tangent).
    """

    add: Callable[[_Sums, Invariants, Fibre], None]
    metric_stretch: Callable[[Invariants, Fibre], Array]
    has_energy: bool


CLOSURES: dict[str, Closure] = {
    "layer-stretch": Closure(_layer_stretch, mid_surface_stretch, True),
    "paper": Closure(_paper, implicit_stretch, False),
    "closed-form": Closure(_closed_form, closed_form_stretch, False),
    "condensed": Closure(_condensed, unit_stretch, True),
}
"""Every closure by its name in case files (``material.closure``)."""


def fibres(
    section: Section, growth: Sequence[GrowthState], k_ref: float
) -> Iterator[Fibre]:
    """Yield the Gauss points of a section, innermost first."""
    for layer, (heights, weights), (factor, ratio) in zip(
        section.layers, section.gauss_points, growth, strict=True
    ):
        for xi, w in zip(heights, weights, strict=True):
            natural = np.square(factor) * (1 - 2 * xi * k_ref)
            yield Fibre(layer, float(xi), float(w), ratio, factor, natural)


def resultants(
    closure: str,
    section: Section,
    growth: Sequence[GrowthState],
    forms: Array,
    a_ref: Array,
    k_ref: float,
    tangent: bool = True,
) -> Resultants:
    """Integrate energy, resultants and their tangent through the thickness.

    Args:
        closure: A key of ``CLOSURES``.
        section: The layers.
        growth: Growth of each layer, innermost first.
        forms: (a_11, a_22, a_12, b_11, b_22, b_12), shape (n, 6).
        a_ref: Reference metric (11, 22, 12), shape (n, 3).
        k_ref: Reference curvature, b_ref = k_ref a_ref.
        tangent: Whether the (6, 6) tangent is wanted.

    Returns:
        Energy per reference area (no shifter in the volume measure), stress and tangent.

    Raises:
        LostFibre: A layer is turned inside out, or (``paper``) has lost its lambda_3.
    """
    add = CLOSURES[closure].add
    inv = invariants(forms, a_ref)
    sums = _Sums(len(forms), tangent)
    for fibre in fibres(section, growth, k_ref):
        add(sums, inv, fibre)
    return _to_components(sums, forms, a_ref)


def _to_components(sums: _Sums, forms: Array, a_ref: Array) -> Resultants:
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
