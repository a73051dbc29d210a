r"""The weak form of a meridian, in UFL: one set of blocks for every kind of placement.

For a placement with unknown u, forms g (direct) and b_11 (mixed), and with vertex rotations alpha,

    int (stress . dg + M_11 eta) ds + d<sigma, L>(v, beta) - int sigma eta ds = 0
    L(eta) = int b_11 eta ds + sum over the ends of a cell of y eta,   L(tau) = int kappa tau ds

(docs/theory.md, "Meridian").  ``stress`` and ``tangent`` come from ``shell.closures`` times
2 pi r_ref; the blocks carry the names of ``shell.forms`` and are condensed by
``shell.condensation``.
"""

from __future__ import annotations

import basix
import basix.ufl
import numpy as np
import ufl
from numpy.typing import NDArray

from opticcup_fem.meridian.kinematics import (
    EndData,
    Expr,
    Strains,
    Wave,
    meridian_strains,
    perturbed_placement,
    wave_strains,
)
from opticcup_fem.meridian.mesh import MeridianMesh
from opticcup_fem.shell.forms import Integral

Array = NDArray[np.float64]


class MeridianForms:
    """Coefficients and blocks of the weak form; subclasses say what the placement is.

    Attributes:
        integrals: The blocks by name; see ``shell.forms.ShellForms``.  ``V_r`` and ``V_rr`` are
            the derivatives of the enclosed volume over 2 pi.
        quadrature_points: Points of the cell quadrature in [0, 1], shape (n_points,).
        quadrature_weights: Its weights, adding up to one.
    """

    components: int

    def __init__(self, mesh: MeridianMesh, quadrature_points: int = 5) -> None:
        """Write the forms.

        Args:
            mesh: The meridian's mesh.
            quadrature_points: Gauss points of a cell.
        """
        self.mesh, self.domain = mesh, mesh.domain()
        self.degree = 2 * quadrature_points - 1
        points, weights = basix.make_quadrature(basix.CellType.interval, self.degree)
        self.quadrature_points: Array = points[:, 0]
        self.quadrature_weights: Array = weights
        self._make_coefficients()
        self.integrals = self._blocks(self._strains())
        self.integrals |= self._volume_blocks()

    def _space(self, element: basix.ufl._ElementBase) -> ufl.FunctionSpace:
        return ufl.FunctionSpace(self.domain, element)

    def _position_space(self, components: int) -> ufl.FunctionSpace:
        return self._space(
            basix.ufl.element(
                "Lagrange",
                "interval",
                self.mesh.degree,
                lagrange_variant=basix.LagrangeVariant.gll_warped,
                shape=(components,),
            )
        )

    def _make_coefficients(self) -> None:
        constant = self._space(basix.ufl.element("DG", "interval", 0))
        self.position_space = self._position_space(self.components)
        # degree k and not k - 1 as on triangles: L(tau) = -int y' tau' + ends must see all of the
        # slope y' in P_{k-1}, else one bubble a cell bends freely
        curvature_space = self._space(
            basix.ufl.element(
                "Lagrange",
                "interval",
                self.mesh.degree,
                lagrange_variant=basix.LagrangeVariant.legendre,
                discontinuous=True,
            )
        )

        def at_points(shape: tuple[int, ...]) -> ufl.Coefficient:
            element = basix.ufl.quadrature_element(
                "interval", value_shape=shape, degree=self.degree
            )
            return ufl.Coefficient(self._space(element))

        self.r = ufl.Coefficient(self.position_space)
        self.sigma = ufl.Coefficient(curvature_space)
        self.alpha, self.angle, self.pole = (ufl.Coefficient(constant) for _ in range(3))
        self.radius, self.stress, self.tangent = at_points(()), at_points((6,)), at_points((6, 6))
        self.v, self.dr = (
            ufl.TestFunction(self.position_space),
            ufl.TrialFunction(self.position_space),
        )
        self.eta, self.dk = ufl.TestFunction(curvature_space), ufl.TrialFunction(curvature_space)
        self.beta, self.dalpha = ufl.TestFunction(constant), ufl.TrialFunction(constant)
        self.dx = ufl.Measure(
            "dx",
            domain=self.domain,
            metadata={"quadrature_degree": self.degree, "quadrature_rule": "default"},
        )
        self.ds = ufl.Measure("ds", domain=self.domain)
        side = ufl.FacetNormal(self.domain)[0]
        self.end = EndData(self.alpha, self.angle, self.pole, side)

    def _strains(self) -> Strains:
        raise NotImplementedError

    def _volume_density(self) -> Expr:
        """Return x . (x_,s x x_,phi)/3, whose integral is the volume over 2 pi."""
        raise NotImplementedError

    def _blocks(self, strains: Strains) -> dict[str, Integral]:
        components, bending = strains.components, 3
        dg_test = ufl.derivative(strains.direct, self.r, self.v)
        dg_trial = ufl.derivative(strains.direct, self.r, self.dr)
        force = ufl.as_vector([self.stress[i] for i in components])
        stiffness = ufl.as_matrix([[self.tangent[i, j] for j in components] for i in components])
        to_bending = ufl.as_vector([self.tangent[i, bending] for i in components])
        from_bending = ufl.as_vector([self.tangent[bending, i] for i in components])
        virtual_work = ufl.dot(force, dg_test) * self.dx
        inside = strains.curvature * self.eta * self.dx
        across = strains.kink * self.eta * self.ds
        work = ufl.derivative(strains.curvature * self.sigma * self.dx, self.r, self.v)
        end_work = strains.kink * self.sigma * self.ds
        end_in_r = ufl.derivative(end_work, self.r, self.v)
        end_in_alpha = ufl.derivative(end_work, self.alpha, self.beta)
        cells = {
            "Fr": virtual_work,
            "Fk": self.stress[bending] * self.eta * self.dx,
            "Krr": ufl.dot(dg_test, ufl.dot(stiffness, dg_trial)) * self.dx
            + ufl.derivative(virtual_work, self.r, self.dr),
            "Krk": ufl.dot(dg_test, to_bending) * self.dk * self.dx,
            "Kkr": self.eta * ufl.dot(from_bending, dg_trial) * self.dx,
            "Kkk": self.eta * self.tangent[bending, bending] * self.dk * self.dx,
            "L": inside,
            "B": ufl.derivative(inside, self.r, self.dr),
            "G": ufl.derivative(work, self.r, self.dr),
        }
        ends = {
            "L_edge": across,
            "B_edge": ufl.derivative(across, self.r, self.dr),
            "Ba_edge": ufl.derivative(across, self.alpha, self.dalpha),
            "G_edge": ufl.derivative(end_in_r, self.r, self.dr),
            "Ga_edge": ufl.derivative(end_in_alpha, self.r, self.dr),
        } | self._second_in_alpha(end_in_alpha)
        fields = frozenset({self.alpha, self.angle, self.pole})
        return {name: Integral(form, False) for name, form in cells.items()} | {
            name: Integral(form, True, fields) for name, form in ends.items()
        }

    def _second_in_alpha(self, end_in_alpha: ufl.Form) -> dict[str, ufl.Form]:
        """Return the block of second derivatives in alpha, where y is not linear in it."""
        return {}

    def _volume_blocks(self) -> dict[str, Integral]:
        in_r = ufl.derivative(self._volume_density() * self.dx, self.r, self.v)
        return {
            "V_r": Integral(in_r, False),
            "V_rr": Integral(ufl.derivative(in_r, self.r, self.dr), False),
        }


class AxisymmetricForms(MeridianForms):
    """Placement (r, z)."""

    components = 2

    def _strains(self) -> Strains:
        return meridian_strains(self.r, self.radius, self.end)

    def _volume_density(self) -> Expr:
        x, d = self.r, self.r.dx(0)
        return x[0] * (x[1] * d[0] - x[0] * d[1]) / 3


class WaveForms(MeridianForms):
    """Perturbation (u_r cos m phi, u_phi sin m phi, u_z cos m phi) at one azimuth.

    Attributes:
        base: Axisymmetric placement (r, z).
        wave: (m, cos m phi, sin m phi), constant in a cell.
    """

    components = 3

    def _make_coefficients(self) -> None:
        super()._make_coefficients()
        self.base = ufl.Coefficient(self._position_space(2))
        self.wave = ufl.Coefficient(self._space(basix.ufl.element("DG", "interval", 0, shape=(3,))))

    def _wave(self) -> Wave:
        return Wave(self.wave[0], self.wave[1], self.wave[2])

    def _strains(self) -> Strains:
        return wave_strains(self.base, self.r, self.radius, self._wave(), self.end)

    def _volume_density(self) -> Expr:
        p = perturbed_placement(self.base, self.r, self._wave())
        return ufl.dot(p.x, ufl.cross(p.d_s, p.d_phi)) / 3

    def _second_in_alpha(self, end_in_alpha: ufl.Form) -> dict[str, ufl.Form]:
        return {"Gaa_edge": ufl.derivative(end_in_alpha, self.alpha, self.dalpha)}
