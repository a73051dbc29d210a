r"""The weak form of the shell, in UFL: kinematics, constitutive data, and their derivatives.

Mixed form, for all (v, beta, eta, tau):

    sum_T int_T (N . da(v) + M . eta) + d/d(r, alpha) <sigma, L> - int_T sigma . eta = 0
    L(eta) = sum_T int_T b . eta + int_dT y (nu nu) . eta,     L(tau) - int_T kappa . tau = 0

(docs/theory.md, "Mixed form").  N, M and their tangent enter as data at the quadrature points, so
that neither another closure nor another layer touches a form.  Cell and edge integrals are kept
apart because their kernels are called apart (``kernels``).
"""

from __future__ import annotations

from dataclasses import dataclass

import basix
import basix.ufl
import numpy as np
import ufl
from numpy.typing import NDArray

from opticcup_fem.shell import kinematics
from opticcup_fem.shell.spaces import ShellSpaces

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Integral:
    """One block of the weak form.

    Attributes:
        form: UFL form with a single integral.
        on_edges: Whether it lives on cell edges (one-sided) rather than in cells.
        edge_coefficients: Coefficients with values of their own on every edge of a cell, apart
            from those that live on a mesh of edges.
    """

    form: ufl.Form
    on_edges: bool
    edge_coefficients: frozenset[ufl.Coefficient] = frozenset()


class ShellForms:
    """All blocks of residual and tangent, by name.

    Cells: ``Fr, Fk`` (material residual in r and kappa), ``Krr, Krk, Kkr, Kkk`` (its tangent),
    ``L, B`` (curvature functional and its derivative in r), ``G`` (second derivative of
    <sigma, L> in r).  Edges: ``L_edge, B_edge, Ba_edge`` (derivative in alpha), ``G_edge`` and
    ``Ga_edge`` (the alpha-r block).

    Attributes:
        integrals: The blocks.
        quadrature_degree: Degree of the cell quadrature.
        quadrature_points: Its points, shape (n_points, 2).
        quadrature_weights: Its weights, shape (n_points,), adding up to one half.
    """

    def __init__(self, spaces: ShellSpaces, quadrature_degree: int = 6) -> None:
        """Write the forms.

        Args:
            spaces: Spaces of the shell.
            quadrature_degree: Degree of the cell quadrature; 4 shifts the secondary fold.
        """
        self.spaces, self.quadrature_degree = spaces, quadrature_degree
        self.domain = spaces.mesh.ufl_domain()
        points, weights = basix.make_quadrature(basix.CellType.triangle, quadrature_degree)
        self.quadrature_points: Array = points
        self.quadrature_weights: Array = weights
        self._make_coefficients()
        self.integrals = {**self._material_blocks(), **self._kinematic_blocks()}

    def _make_coefficients(self) -> None:
        spaces, domain = self.spaces, self.domain
        edges = spaces.edge_domain
        curvature_space = ufl.FunctionSpace(domain, spaces.curvature_element)
        position_space = ufl.FunctionSpace(domain, spaces.element)
        angle_space = ufl.FunctionSpace(edges, spaces.edge_element())
        edge_constant = basix.ufl.element("DG", "interval", 0)
        cell_constant = basix.ufl.element("DG", "triangle", 0)

        def at_points(shape: tuple[int, ...]) -> ufl.Coefficient:
            element = basix.ufl.quadrature_element(
                "triangle", value_shape=shape, degree=self.quadrature_degree
            )
            return ufl.Coefficient(ufl.FunctionSpace(domain, element))

        self.r = ufl.Coefficient(position_space)
        self.sigma = ufl.Coefficient(curvature_space)
        self.alpha = ufl.Coefficient(angle_space)
        self.director = ufl.Coefficient(ufl.FunctionSpace(edges, spaces.edge_element((3,))))
        self.sign = ufl.Coefficient(ufl.FunctionSpace(edges, edge_constant))
        self.orientation = ufl.Coefficient(ufl.FunctionSpace(domain, cell_constant))
        self.stress = at_points((6,))
        self.tangent = at_points((6, 6))
        self.v, self.dr = ufl.TestFunction(position_space), ufl.TrialFunction(position_space)
        self.eta, self.dk = ufl.TestFunction(curvature_space), ufl.TrialFunction(curvature_space)
        self.beta = ufl.TestFunction(angle_space)
        self.dalpha = ufl.TrialFunction(angle_space)
        self.frame = kinematics.cell_frame(domain, self.orientation)
        self.dx = ufl.Measure(
            "dx",
            domain=domain,
            metadata={"quadrature_degree": self.quadrature_degree, "quadrature_rule": "default"},
        )
        self.ds = ufl.Measure(
            "ds", domain=domain, metadata={"quadrature_degree": 2 * spaces.degree - 1}
        )

    def _material_blocks(self) -> dict[str, Integral]:
        """Virtual work of the resultants and its tangent."""
        a = kinematics.metric(self.r, self.frame)
        da_test, da_trial = ufl.derivative(a, self.r, self.v), ufl.derivative(a, self.r, self.dr)
        membrane = ufl.as_vector([self.stress[i] for i in range(3)])
        bending = ufl.as_vector([self.stress[i] for i in range(3, 6)])

        def block(row: int, column: int) -> ufl.core.expr.Expr:
            return ufl.as_matrix(
                [[self.tangent[row + i, column + j] for j in range(3)] for i in range(3)]
            )

        virtual_work = ufl.dot(membrane, da_test) * self.dx
        cells = {
            "Fr": virtual_work,
            "Fk": ufl.dot(bending, self.eta) * self.dx,
            "Krr": ufl.dot(da_test, ufl.dot(block(0, 0), da_trial)) * self.dx
            + ufl.derivative(virtual_work, self.r, self.dr),
            "Krk": ufl.dot(da_test, ufl.dot(block(0, 3), self.dk)) * self.dx,
            "Kkr": ufl.dot(self.eta, ufl.dot(block(3, 0), da_trial)) * self.dx,
            "Kkk": ufl.dot(self.eta, ufl.dot(block(3, 3), self.dk)) * self.dx,
        }
        return {name: Integral(form, False) for name, form in cells.items()}

    def _kinematic_blocks(self) -> dict[str, Integral]:
        """Curvature functional L(eta) and the derivatives of <sigma, L>."""
        b = kinematics.curvature(self.r, self.frame)
        edge = kinematics.edge_frame(self.domain, self.frame)
        kink = kinematics.edge_kink(self.r, edge, self.director, self.alpha, self.sign)
        dyad = kinematics.conormal_dyad(edge, self.frame)
        inside = ufl.inner(b, self.eta) * self.dx
        across = kink * ufl.dot(dyad, self.eta) * self.ds
        work = ufl.inner(b, self.sigma) * self.dx
        edge_work = kink * ufl.dot(dyad, self.sigma) * self.ds
        in_r = ufl.derivative(work, self.r, self.v)
        edge_in_r = ufl.derivative(edge_work, self.r, self.v)
        # the transpose, derivative(edge_in_r, alpha), takes three times as long to compile
        edge_in_alpha = ufl.derivative(edge_work, self.alpha, self.beta)
        cells = {
            "L": inside,
            "B": ufl.derivative(inside, self.r, self.dr),
            "G": ufl.derivative(in_r, self.r, self.dr),
        }
        edges = {
            "L_edge": across,
            "B_edge": ufl.derivative(across, self.r, self.dr),
            "Ba_edge": ufl.derivative(across, self.alpha, self.dalpha),
            "G_edge": ufl.derivative(edge_in_r, self.r, self.dr),
            "Ga_edge": ufl.derivative(edge_in_alpha, self.r, self.dr),
        }
        return {
            **{name: Integral(form, False) for name, form in cells.items()},
            **{name: Integral(form, True) for name, form in edges.items()},
        }
