r"""The readings ("closures") of plane stress that decide how a layered shell resists.

They differ in which lambda_3 enters the metric at height xi (docs/theory.md, "Closures"); their
notation is that of ``fibres``.  Resultants are conjugate to the components
(a_11, a_22, a_12, b_11, b_22, b_12), per reference area; N = 2 dW/da, M = dW/db.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.shell.fibres import (
    Fibre,
    GrowthState,
    Invariants,
    Resultants,
    Sums,
    area_ratio,
    area_slope,
    energy_density,
    fibres,
    invariants,
    plane_stress_stretch,
    to_components,
)
from opticcup_fem.shell.section import Layer, Section

Array = NDArray[np.float64]


def _add_energy_fibre(
    sums: Sums, inv: Invariants, fibre: Fibre, s: Array, s_1: Array, s_2: Array
) -> None:
    """Add a fibre of a closure with an energy, whose s = -2 xi lambda_3 is a function of A.

    Psi_0 is stationary in its own lambda_3 (plane stress), which the first derivatives may
    therefore hold fixed; s_1 and s_2 are the first and second derivatives of s in A.
    """
    mu, w, q = fibre.layer.shear_modulus, fibre.weight, fibre.natural
    per_q2 = 1 / np.square(q)
    D = area_ratio(inv, s, fibre)
    m = plane_stress_stretch(D, fibre.layer)
    sums.energy += w * energy_density(inv, s, D, m, fibre)
    # area_slope in plane stress, without the large lambda of nearly incompressible layers
    psi_D = -w * mu * m / (2 * D)
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
    psi_DD = -psi_D * (1 / D + fibre.layer.contraction * m)
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


def _layer_stretch(sums: Sums, inv: Invariants, fibre: Fibre) -> None:
    """Closure ``layer-stretch``: s from the layer's mid-surface stretch l(A)."""
    stretch = mid_surface_stretch(inv, fibre)
    s = -2 * fibre.height * stretch
    slope = fibre.layer.contraction / np.power(fibre.growth, 4) * stretch**2
    s_1 = -s * slope / 2
    s_2 = 3 * s * slope**2 / 4
    _add_energy_fibre(sums, inv, fibre, s, s_1, s_2)


def _condensed(sums: Sums, inv: Invariants, fibre: Fibre) -> None:
    """Closure ``condensed``: lambda_3 = 1 in the metric, Psi_0 condensed at each height."""
    s = -2 * fibre.height * unit_stretch(inv, fibre)
    zero = np.zeros_like(s)
    _add_energy_fibre(sums, inv, fibre, s, zero, zero)


def _add_held_fibre(
    sums: Sums, inv: Invariants, fibre: Fibre, stretch: Array, stretch_D: Array, D_abc: Array
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
    sums.energy += w * energy_density(inv, s, D, m, fibre)
    psi_D = w * area_slope(D, m, fibre.layer)
    psi_T = w * mu / 2
    g = sums.gradient
    g[0] += psi_D * per_q2
    g[1] += psi_D * s * per_q2
    g[2] += psi_D * s * s * per_q2
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
    return stretch, -layer.contraction * stretch**3 / 2


def _closed_form(sums: Sums, inv: Invariants, fibre: Fibre) -> None:
    """Closure ``closed-form``: lambda_3 from J_s of the metric taken at lambda_3 = 1."""
    s = -2 * fibre.height
    D = area_ratio(inv, s, fibre)
    stretch, slope = _stretch_and_slope(D, fibre.layer)
    per_q2 = np.broadcast_to(1 / np.square(fibre.natural), D.shape)
    D_abc = np.stack([per_q2, s * per_q2, s * s * per_q2])
    _add_held_fibre(sums, inv, fibre, stretch, slope, D_abc)


def _paper(sums: Sums, inv: Invariants, fibre: Fibre) -> None:
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
    first = -2 * fibre.height
    D = (inv.A + first * inv.B + first * first * inv.C) * per_q2
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
            Those that are condensed at each height have the incompressible limit nu = 1/2 too.
    """

    add: Callable[[Sums, Invariants, Fibre], None]
    metric_stretch: Callable[[Invariants, Fibre], Array]
    has_energy: bool


CLOSURES: dict[str, Closure] = {
    "layer-stretch": Closure(_layer_stretch, mid_surface_stretch, True),
    "paper": Closure(_paper, implicit_stretch, False),
    "closed-form": Closure(_closed_form, closed_form_stretch, False),
    "condensed": Closure(_condensed, unit_stretch, True),
}
"""Every closure by its name in case files (``material.closure``)."""


class FibreState(NamedTuple):
    """State of a fibre at n points, each of shape (n,).

    Attributes:
        s: s = -2 xi lambda_3 with the lambda_3 of the metric, g = a + s b.
        area_ratio: D = J_s^2.
        stretch: lambda_3 in the stress.
    """

    s: Array
    area_ratio: Array
    stretch: Array


def fibre_state(closure: str, inv: Invariants, fibre: Fibre) -> FibreState:
    """Return the state of a fibre under a closure.

    Raises:
        LostFibre: There is none.
    """
    law = CLOSURES[closure]
    metric_stretch = law.metric_stretch(inv, fibre)
    s = -2 * fibre.height * metric_stretch
    D = area_ratio(inv, s, fibre)
    in_plane = np.sqrt(plane_stress_stretch(D, fibre.layer))
    return FibreState(s, D, in_plane if law.has_energy else metric_stretch)


def mean_stretches(
    closure: str,
    section: Section,
    growth: Sequence[GrowthState],
    forms: Array,
    a_ref: Array,
    k_ref: float,
) -> dict[str, Array]:
    """Return the mean of lambda_3 through each layer, shape (n,); arguments as ``resultants``."""
    inv = invariants(forms, a_ref)
    means: dict[str, Array] = {layer.name: np.zeros(len(forms)) for layer in section.layers}
    for fibre in fibres(section, growth, k_ref):
        means[fibre.layer.name] += fibre.share * fibre_state(closure, inv, fibre).stretch
    return means


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
    sums = Sums(len(forms), tangent)
    for fibre in fibres(section, growth, k_ref):
        add(sums, inv, fibre)
    return to_components(sums, forms, a_ref)
