r"""Kirchhoff-Love kinematics on flat cells, in UFL.

Every cell is its flat facet T with an orthonormal frame (t_1, t_2) and the outward normal n_0;
the position r is a cubic field on T.  Vectors of three components hold the (11, 22, 12)
components of symmetric 2x2 tensors in that frame.  Theory: docs/theory.md, "Surface shell".
"""

from __future__ import annotations

from dataclasses import dataclass

import ufl


@dataclass(frozen=True)
class CellFrame:
    """Orthonormal frame of the flat cell: tangents t_1, t_2 and outward normal n_0."""

    t_1: ufl.core.expr.Expr
    t_2: ufl.core.expr.Expr
    n_0: ufl.core.expr.Expr


def cell_frame(domain: ufl.Mesh, orientation: ufl.core.expr.Expr) -> CellFrame:
    """Return the frame of a flat cell.

    Args:
        domain: UFL mesh of affine triangles in space.
        orientation: +1 where the cross product of the cell's edges points outwards, else -1.
    """
    jacobian = ufl.Jacobian(domain)
    t_1 = jacobian[:, 0] / ufl.sqrt(ufl.dot(jacobian[:, 0], jacobian[:, 0]))
    normal = ufl.cross(jacobian[:, 0], jacobian[:, 1])
    n_0 = orientation * normal / ufl.sqrt(ufl.dot(normal, normal))
    return CellFrame(t_1, ufl.cross(n_0, t_1), n_0)


def metric(r: ufl.core.expr.Expr, frame: CellFrame) -> ufl.core.expr.Expr:
    """Return the metric a_ab = r_,a . r_,b (S3) as (a_11, a_22, a_12)."""
    gradient = ufl.grad(r)
    a_1, a_2 = ufl.dot(gradient, frame.t_1), ufl.dot(gradient, frame.t_2)
    return ufl.as_vector([ufl.dot(a_1, a_1), ufl.dot(a_2, a_2), ufl.dot(a_1, a_2)])


def curvature(r: ufl.core.expr.Expr, frame: CellFrame) -> ufl.core.expr.Expr:
    """Return the curvature b_ab = n . r_,ab (S5) inside a cell as (b_11, b_22, b_12).

    The sphere of radius R, with n outside, has b = -a/R.
    """
    gradient = ufl.grad(r)
    second = ufl.grad(gradient)
    normal = ufl.cross(ufl.dot(gradient, frame.t_1), ufl.dot(gradient, frame.t_2))
    n = normal / ufl.sqrt(ufl.dot(normal, normal))

    def component(s: ufl.core.expr.Expr, t: ufl.core.expr.Expr) -> ufl.core.expr.Expr:
        return ufl.dot(n, ufl.dot(ufl.dot(second, t), s))

    return ufl.as_vector(
        [
            component(frame.t_1, frame.t_1),
            component(frame.t_2, frame.t_2),
            component(frame.t_1, frame.t_2),
        ]
    )


@dataclass(frozen=True)
class EdgeFrame:
    """Conormal nu and tangent tau = n_0 x nu of a cell's edge, in the plane of the flat cell."""

    nu: ufl.core.expr.Expr
    tau: ufl.core.expr.Expr


def edge_frame(domain: ufl.Mesh, frame: CellFrame) -> EdgeFrame:
    """Return the frame of an edge as its cell sees it (counter-clockwise about n_0)."""
    nu = ufl.FacetNormal(domain)
    return EdgeFrame(nu, ufl.cross(frame.n_0, nu))


def edge_kink(
    r: ufl.core.expr.Expr,
    edge: EdgeFrame,
    director: ufl.core.expr.Expr,
    alpha: ufl.core.expr.Expr,
    sign: ufl.core.expr.Expr,
) -> ufl.core.expr.Expr:
    r"""Return the one-sided rotation y of a cell's normal against the edge director.

    With t = r_,tau/|r_,tau|, F_nu = r_,nu, its part F_p normal to t and the stretch l = |F_p|,

    .. math:: y = -l (\operatorname{atan2}(F_p \cdot d_0, F_\nu \cdot (t \times d_0)) + s \alpha).

    The edge director is d = cos(alpha) d_0 + sin(alpha) t_E x d_0, with t_E from the edge's low
    to its high vertex; y vanishes where the cell's normal is d.  The stretch l makes y nu nu a
    covariant curvature, which is essential under large growth.

    Args:
        r: Position.
        edge: Frame of the edge.
        director: Lagged unit vector d_0, normal to the (lagged) edge.
        alpha: Angle of the director from d_0, radians.
        sign: +1 where tau runs along t_E, else -1.
    """
    gradient = ufl.grad(r)
    along, across = ufl.dot(gradient, edge.tau), ufl.dot(gradient, edge.nu)
    t = along / ufl.sqrt(ufl.dot(along, along))
    normal_part = across - ufl.dot(across, t) * t
    stretch = ufl.sqrt(ufl.dot(normal_part, normal_part))
    angle = ufl.atan2(ufl.dot(normal_part, director), ufl.dot(across, ufl.cross(t, director)))
    return -stretch * (angle + sign * alpha)


def conormal_dyad(edge: EdgeFrame, frame: CellFrame) -> ufl.core.expr.Expr:
    """Return nu nu as (nu_1 nu_1, nu_2 nu_2, nu_1 nu_2).

    Its scalar product with test functions (eta_11, eta_22, 2 eta_12) is eta_nunu; all products of
    curvatures and their test functions in this package are such plain scalar products.
    """
    nu_1, nu_2 = ufl.dot(edge.nu, frame.t_1), ufl.dot(edge.nu, frame.t_2)
    return ufl.as_vector([nu_1 * nu_1, nu_2 * nu_2, nu_1 * nu_2])
