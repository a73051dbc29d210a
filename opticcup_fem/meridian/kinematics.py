r"""Kirchhoff-Love kinematics of a meridian and of its perturbations cos(m phi), in UFL.

The frame of the reference surface is physical: t_1 along the meridian (arc length s), t_2 along
the circle of radius r_ref(s), so that a_ref is the identity.  Vectors are (radial, azimuthal,
axial) components in the cylindrical frame of their azimuth; the current normal is
x_,s x x_,phi/|.|, outward on the sphere.  Theory: docs/theory.md, "Meridian".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import ufl

Expr: TypeAlias = ufl.core.expr.Expr


@dataclass(frozen=True)
class Strains:
    """What the material and the mixed form need of a placement.

    Attributes:
        direct: Fundamental forms that need first derivatives along the meridian only.
        components: Their places in (a_11, a_22, a_12, b_11, b_22, b_12).
        curvature: b_11 inside a cell.
        kink: One-sided rotation y of the meridian at an end of a cell, times its stretch.
    """

    direct: Expr
    components: tuple[int, ...]
    curvature: Expr
    kink: Expr


@dataclass(frozen=True)
class EndData:
    """Data at the ends of a cell.

    Attributes:
        alpha: Rotation of the vertex from ``angle``, radians.
        angle: Angle of the vertex's tangent with the radial direction, held constant, radians.
        pole: 1 at a pole, else 0.
        side: +1 at the end of a cell, -1 at its start.
    """

    alpha: Expr
    angle: Expr
    pole: Expr
    side: Expr


def meridian_strains(x: Expr, radius: Expr, end: EndData) -> Strains:
    r"""Return the strains of an axisymmetric placement x = (r, z).

    .. math:: a_{11} = l^2 = r'^2 + z'^2,\; a_{22} = (r/r_{ref})^2,\;
              b_{11} = l \omega',\; b_{22} = r z'/(l\, r_{ref}^2)

    with omega the tangent's angle, tan(omega) = z'/r'.

    Args:
        x: Placement, shape (2,).
        radius: Reference radius r_ref.
        end: Data at the ends of the cells.
    """
    d = x.dx(0)
    dd = d.dx(0)
    stretch = ufl.sqrt(ufl.dot(d, d))
    direct = [ufl.dot(d, d), (x[0] / radius) ** 2, x[0] * d[1] / (stretch * radius**2)]
    curvature = (d[0] * dd[1] - d[1] * dd[0]) / stretch
    c, s = ufl.cos(end.angle), ufl.sin(end.angle)
    turned = ufl.atan2(c * d[1] - s * d[0], c * d[0] + s * d[1])
    kink = end.side * stretch * (end.alpha - turned)
    return Strains(ufl.as_vector(direct), (0, 1, 4), curvature, kink)


@dataclass(frozen=True)
class Wave:
    """Wavenumber m and the cosine and sine of m phi at one azimuth."""

    m: Expr
    cosine: Expr
    sine: Expr


@dataclass(frozen=True)
class Placement:
    """Position x(s, phi) and its derivatives at one azimuth, each of shape (3,)."""

    x: Expr
    d_s: Expr
    d_phi: Expr
    d_ss: Expr
    d_sphi: Expr
    d_phiphi: Expr


def perturbed_placement(x: Expr, u: Expr, wave: Wave) -> Placement:
    """Return (r + u_r cos, u_phi sin, z + u_z cos) and its exact derivatives.

    Args:
        x: Axisymmetric placement (r, z).
        u: Amplitudes (u_r, u_phi, u_z).
        wave: Wavenumber and azimuth.
    """
    m, c, s = wave.m, wave.cosine, wave.sine

    def at(f: Expr, g: Expr) -> Expr:
        return ufl.as_vector([f[0] + g[0] * c, g[1] * s, f[1] + g[2] * c])

    def along_circle(f: Expr, g: Expr) -> Expr:
        return ufl.as_vector([-(m * g[0] + g[1]) * s, f[0] + (g[0] + m * g[1]) * c, -m * g[2] * s])

    d, du = x.dx(0), u.dx(0)
    turn = (m * u[0] + u[1], u[0] + m * u[1])
    twice = ufl.as_vector(
        [
            -(x[0] + (m * turn[0] + turn[1]) * c),
            -(turn[0] + m * turn[1]) * s,
            -m * m * u[2] * c,
        ]
    )
    return Placement(
        at(x, u), at(d, du), along_circle(x, u), at(d.dx(0), du.dx(0)), along_circle(d, du), twice
    )


def wave_strains(x: Expr, u: Expr, radius: Expr, wave: Wave, end: EndData) -> Strains:
    """Return the strains of an axisymmetric placement perturbed in one wavenumber, at one azimuth.

    Args:
        x: Axisymmetric placement (r, z).
        u: Amplitudes (u_r, u_phi, u_z); ``end.alpha`` is that of the rotation, times cos(m phi).
        radius: Reference radius.
        wave: Wavenumber and azimuth.
        end: Data at the ends of the cells.
    """
    p = perturbed_placement(x, u, wave)
    # the factor r of the circle's tangent would vanish at the poles; none is evaluated there
    normal = ufl.cross(p.d_s, p.d_phi)
    n = normal / ufl.sqrt(ufl.dot(normal, normal))
    direct = [
        ufl.dot(p.d_s, p.d_s),
        ufl.dot(p.d_phi, p.d_phi) / radius**2,
        ufl.dot(p.d_s, p.d_phi) / radius,
        ufl.dot(n, p.d_phiphi) / radius**2,
        ufl.dot(n, p.d_sphi) / radius,
    ]
    kink = _wave_kink(p, wave, end)
    return Strains(ufl.as_vector(direct), (0, 1, 2, 4, 5), ufl.dot(n, p.d_ss), kink)


def _wave_kink(p: Placement, wave: Wave, end: EndData) -> Expr:
    """Return y at an end of a cell.

    Away from the poles the rotation is measured about the tangent t of the circle, from the
    tangent d_t of the axisymmetric vertex as t sees it: a rigid motion changes it alike on both
    sides.  At a pole, where there is no t, it is measured from the plane normal to n_pole, a unit
    vector that turns by ``end.alpha`` about the horizontal axis at phi = pi/(2m).
    """
    cos, sin = ufl.cos(end.angle), ufl.sin(end.angle)
    d_t = ufl.as_vector([cos, 0, sin])
    d_n = ufl.as_vector([-sin, 0, cos])
    circle = p.d_phi + end.pole * ufl.as_vector([0, 1, 0])
    t = circle / ufl.sqrt(ufl.dot(circle, circle))
    normal_part = p.d_s - ufl.dot(p.d_s, t) * t
    stretch = ufl.sqrt(ufl.dot(normal_part, normal_part))
    turned = ufl.atan2(ufl.dot(p.d_s, ufl.cross(d_t, t)), ufl.dot(normal_part, d_t))
    at_edge = stretch * (end.alpha * wave.cosine - turned)
    whole = ufl.sqrt(ufl.dot(p.d_s, p.d_s))
    tilt = ufl.as_vector([wave.cosine, -wave.sine, 0])
    n_pole = ufl.cos(end.alpha) * d_n - ufl.sin(end.alpha) * cos * tilt
    at_pole = -whole * ufl.asin(ufl.dot(p.d_s, n_pole) / whole)
    return end.side * ((1 - end.pole) * at_edge + end.pole * at_pole)
