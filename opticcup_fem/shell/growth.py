"""Growth of the layers: laws that give e and rho_r at points of the reference surface.

A law is any callable ``law(t_n, points) -> GrowthState``; ``points.x`` are the reference positions
and ``points.evaluate(expression)`` the values there of a UFL expression or dolfinx Function, so
that a growth field is a constant, a NumPy formula or a UFL expression alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from numpy.typing import NDArray

from opticcup_fem.scalar_fields import ScalarField
from opticcup_fem.shell.fibres import GrowthState
from opticcup_fem.stimulus import GROWTH, Stimulus

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SurfacePoints:
    """Quadrature points of some cells.

    Attributes:
        x: Reference positions, shape (n, 3), the points of a cell one after the other.
        mesh: The mesh that holds the cells.
        cells: Local numbers of the cells.
        reference_points: Points in the reference cell, shape (n_points, 2).
    """

    x: Array
    mesh: dmesh.Mesh
    cells: NDArray[np.int32]
    reference_points: Array

    def evaluate(self, expression: Any) -> Array:
        """Return the values of a scalar UFL expression on the mesh, shape (n,) (collective)."""
        # compiled by all ranks together, also by those without cells here
        compiled = fem.Expression(
            ufl.as_ufl(expression), self.reference_points, comm=self.mesh.comm
        )
        if len(self.cells) == 0:
            return np.zeros(0)
        return np.asarray(compiled.eval(self.mesh, self.cells), dtype=np.float64).reshape(-1)


GrowthLaw = Callable[[float, SurfacePoints], GrowthState]
"""What a layer's growth is: (t_n, points) -> (e, rho_r)."""


def density_ratio(factor: Array | float, mass_change: bool) -> Array | float:
    """Return the stress factor rho_r of S12.

    Args:
        factor: Growth factor e.
        mass_change: True for density-preserving growth, rho_r = e^2; False for heating, swelling,
            or growth whose mass is neglected, rho_r = 1.
    """
    return np.square(factor) if mass_change else np.ones_like(np.asarray(factor, dtype=float))


@dataclass(frozen=True)
class LinearGrowth:
    """Uniform growth e = 1 + rate t_n, the paper's prescription.

    Attributes:
        rate: Rate of e in normalised time.
        mass_change: See ``density_ratio``.
    """

    rate: float
    mass_change: bool = True

    def __call__(self, t_n: float, points: SurfacePoints) -> GrowthState:
        """Return the growth at normalised time ``t_n``."""
        factor = 1 + self.rate * t_n
        return GrowthState(factor, density_ratio(factor, self.mass_change))


@dataclass(frozen=True)
class FieldGrowth:
    """Growth e = 1 + rate(x) t_n with a rate that varies over the surface.

    Attributes:
        rate: Scalar UFL expression or dolfinx Function on the mesh, or a function of the
            reference positions (n, 3) that returns (n,).  UFL's SpatialCoordinate is the flat
            cell; the smooth surface is a Function from ``SurfaceMesh.reference_position``.
        mass_change: See ``density_ratio``.
    """

    rate: Any
    mass_change: bool = True

    def __call__(self, t_n: float, points: SurfacePoints) -> GrowthState:
        """Return the growth at normalised time ``t_n``."""
        is_ufl = isinstance(self.rate, ufl.core.expr.Expr)
        rate = points.evaluate(self.rate) if is_ufl else np.asarray(self.rate(points.x))
        factor = 1 + rate * t_n
        return GrowthState(factor, density_ratio(factor, self.mass_change))


@dataclass(frozen=True)
class PrescribedGrowth:
    """Growth e = 1 + rate t_n of any stimulus, the rate a field in theta, phi and t_n.

    Attributes:
        rate: The rate.
        stimulus: What e does to the stress.
    """

    rate: ScalarField
    stimulus: Stimulus = GROWTH

    def __call__(self, t_n: float, points: SurfacePoints) -> GrowthState:
        """Return the growth at normalised time ``t_n``."""
        factor = 1 + self.rate.at(t_n, points.x) * t_n
        return GrowthState(factor, self.stimulus.density_ratio_of_factor(factor))


@dataclass(frozen=True)
class UnevenLayer:
    """A layer of uneven modulus or thickness that grows by another law.

    Attributes:
        law: Its growth.
        stiffness: Factor on both Lamé constants, in theta, phi and t_n.
        thickness: Factor on the thickness at rest, in theta and phi.
    """

    law: GrowthLaw
    stiffness: ScalarField
    thickness: ScalarField

    def __call__(self, t_n: float, points: SurfacePoints) -> GrowthState:
        """Return growth and properties at normalised time ``t_n``."""
        return self.law(t_n, points)._replace(
            stiffness=self.stiffness.at(t_n, points.x),
            thickness=self.thickness.at(t_n, points.x),
        )
