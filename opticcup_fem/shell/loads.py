r"""Kinds of loads on a shell, as data for one fixed set of forms (``external_work``).

========================  ===============================================  ======================
load                      virtual work                                     tangent of its work
========================  ===============================================  ======================
``EdgeMoment`` m          ``- int m s d(alpha) dS_ref``                    none (dead)
``EdgeForce`` f           ``int f . dr dS_ref``                            none (dead)
``SurfaceForce`` f        ``int f . dr dA_ref``                            none (dead)
``Pressure`` p            ``int p n . dr dA = int p (r_,1 x r_,2) . dr``   follower, see the class
========================  ===============================================  ======================

Signs: pressure acts along n, so that p > 0 inside a closed shell inflates it; a positive edge
moment turns the edge towards n and so makes b_nunu, and M_nunu = m at a free edge, positive.

A load is an object with the two methods of ``Load``: it adds to the values at the sites where
loads act, and says whether its work has a potential.  A new kind that needs no new form is such a
class; one that needs a new form adds its coefficient to ``LoadValues`` and a term to
``external_work.WorkForms``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import basix
import numpy as np
from numpy.typing import ArrayLike, NDArray

from opticcup_fem.errors import CaseError
from opticcup_fem.mesh import SurfaceMesh
from opticcup_fem.shell.curves import cell_edges, is_closed, region_mask
from opticcup_fem.shell.spaces import EDGE_VERTICES, ShellSpaces

Array = NDArray[np.float64]

Magnitude = ArrayLike | Callable[[float], ArrayLike]
"""A constant, or a function of the normalised time t_n that returns one."""


def quadrature_degree(spaces: ShellSpaces) -> int:
    """Return the degree at which (r_,1 x r_,2) . dr is integrated exactly.

    Only then is the tangent of the pressure on a closed surface symmetric.
    """
    return 3 * spaces.degree - 2


@dataclass(frozen=True)
class LoadSites:
    """Where loads can act on the cells of a rank.

    Attributes:
        mesh: Mesh with named curves and regions.
        spaces: Its spaces.
        edge_length: dS_ref over the flat edge's length at the edges' Gauss points, in the cells'
            own order, shape (n_cells, 3, k).
        area: dA_ref over the flat area at the points of ``quadrature_degree``, shape
            (n_cells, n_points).
    """

    mesh: SurfaceMesh
    spaces: ShellSpaces
    edge_length: Array
    area: Array

    @classmethod
    def of(cls, mesh: SurfaceMesh, spaces: ShellSpaces, reference: Array) -> LoadSites:
        """Measure edges and cells of the reference position, nodes of shape (n_nodes, 3)."""
        cell_nodes = reference[spaces.nodes]
        points = spaces.edge_reference_points().reshape(-1, 2)
        base = np.einsum("cqna,cni->cqai", spaces.gradient_operator(points), cell_nodes)
        corners = spaces.coordinates
        run = corners[:, EDGE_VERTICES[:, 1]] - corners[:, EDGE_VERTICES[:, 0]]
        run = run / np.linalg.norm(run, axis=-1, keepdims=True)
        direction = np.einsum("cei,cai->cea", run, spaces.frame[:, :2])
        base = base.reshape(spaces.n_cells, 3, -1, 2, 3)
        along = np.einsum("ceqai,cea->ceqi", base, direction)
        points, _ = basix.make_quadrature(basix.CellType.triangle, quadrature_degree(spaces))
        a_11, a_22, a_12 = np.moveaxis(
            spaces.metric(cell_nodes, spaces.gradient_operator(points)), -1, 0
        )
        area = np.sqrt(a_11 * a_22 - a_12**2)
        return cls(mesh, spaces, np.linalg.norm(along, axis=-1), area)

    def on_curve(self, curve: str, side: str | None) -> Array:
        """Return ``edge_length`` on a curve, zero elsewhere (collective)."""
        mask = cell_edges(self.mesh, self.spaces, curve, side)
        return self.edge_length * mask[:, :, None]

    def in_region(self, region: str | None) -> Array:
        """Return 1 in the cells of a region (all for None), 0 elsewhere, shape (n_cells, 1)."""
        return region_mask(self.mesh, self.spaces, region)[:, None].astype(float)


@dataclass(frozen=True)
class LoadValues:
    """Sums of all loads per flat length and flat area, to which each load adds its share.

    Attributes:
        edge_moment: Shape (n_cells, 3, k).
        edge_force: Shape (n_cells, 3, k, 3).
        surface_force: Shape (n_cells, n_points, 3).
        pressure: Per current area, shape (n_cells, n_points).
    """

    edge_moment: Array
    edge_force: Array
    surface_force: Array
    pressure: Array

    @classmethod
    def zero(cls, sites: LoadSites) -> LoadValues:
        """Return the values of no load."""
        edges, points = sites.edge_length.shape, sites.area.shape
        return cls(np.zeros(edges), np.zeros((*edges, 3)), np.zeros((*points, 3)), np.zeros(points))


class Load(Protocol):
    """What a load must know."""

    def add(self, values: LoadValues, sites: LoadSites, t_n: float) -> None:
        """Add the load at normalised time ``t_n`` to ``values`` (collective)."""
        ...

    def has_potential(self, sites: LoadSites) -> bool:
        """Return whether its work is the change of a potential: a symmetric tangent."""
        ...


def _at(value: Magnitude, t_n: float, shape: tuple[int, ...]) -> Array:
    """Return a magnitude at ``t_n``.

    Raises:
        CaseError: It has another shape, or is not finite.
    """
    result = np.asarray(value(t_n) if callable(value) else value, dtype=float)
    if result.shape != shape or not np.all(np.isfinite(result)):
        wanted = "a finite number" if shape == () else f"{shape[0]} finite components"
        raise CaseError(f"a load is {result} at t_n = {t_n:.6g}; it must be {wanted}.")
    return result


@dataclass(frozen=True)
class EdgeMoment:
    """Moment on a curve, conjugate to the turning of the edge's director about its tangent.

    Its work is that of the director angle from the lagged director: exact for tangents that do
    not tilt towards the director (rolling, axisymmetric bending); others see the moment of the
    last update of the directors, until these are updated and the state is solved for again.

    Attributes:
        curve: Named curve.
        value: Moment per reference length [force]; positive turns the edge towards n.
        side: Region that the curve bounds; needed for a curve with cells on both sides, where the
            moment acts as on the edge of that region.
    """

    curve: str
    value: Magnitude
    side: str | None = None

    def add(self, values: LoadValues, sites: LoadSites, t_n: float) -> None:
        """See ``Load``."""
        values.edge_moment[:] += _at(self.value, t_n, ()) * sites.on_curve(self.curve, self.side)

    def has_potential(self, sites: LoadSites) -> bool:
        """Return True: minus the moment times the angle."""
        return True


@dataclass(frozen=True)
class EdgeForce:
    """Dead force on a curve.

    Attributes:
        curve: Named curve.
        value: Force vector per reference length [stress times length].
        side: A region that the curve bounds; needed for a curve with cells on both sides.
    """

    curve: str
    value: Magnitude
    side: str | None = None

    def add(self, values: LoadValues, sites: LoadSites, t_n: float) -> None:
        """See ``Load``."""
        length = sites.on_curve(self.curve, self.side)
        values.edge_force[:] += length[..., None] * _at(self.value, t_n, (3,))

    def has_potential(self, sites: LoadSites) -> bool:
        """Return True: minus the force times the position."""
        return True


@dataclass(frozen=True)
class SurfaceForce:
    """Dead force on the surface, such as weight.

    Attributes:
        value: Force vector per reference area [stress].
        region: Where it acts; everywhere unless given.
    """

    value: Magnitude
    region: str | None = None

    def add(self, values: LoadValues, sites: LoadSites, t_n: float) -> None:
        """See ``Load``."""
        area = sites.in_region(self.region) * sites.area
        values.surface_force[:] += area[..., None] * _at(self.value, t_n, (3,))

    def has_potential(self, sites: LoadSites) -> bool:
        """Return True: minus the force times the position."""
        return True


@dataclass(frozen=True)
class Pressure:
    r"""Pressure along the current normal, per current area.

    The work p int n . dr dA is p dV, with V = 1/3 int r . n dA, only up to the integral of
    p/3 (r x dr) . t over the edge of the loaded surface.  That vanishes, and the tangent is
    symmetric, where the surface is closed, where the edge's position is held, and where the edge
    slides in planes through the origin that contain it.  On any other edge the follower pressure
    has no potential: the shell then counts as one without an energy, its tangent is factorised by
    L U and gives no inertia.

    Attributes:
        value: Pressure [stress]; positive acts along n, from the inside of a sphere.
        region: Where it acts; everywhere unless given.
        edge_is_held: Whether the edge of the loaded surface is held as said above.  The load
            cannot know the supports; a wrong True makes a wrong tangent.
    """

    value: Magnitude
    region: str | None = None
    edge_is_held: bool = False

    def add(self, values: LoadValues, sites: LoadSites, t_n: float) -> None:
        """See ``Load``."""
        values.pressure[:] += _at(self.value, t_n, ()) * sites.in_region(self.region)

    def has_potential(self, sites: LoadSites) -> bool:
        """Return whether it is -p V."""
        return self.edge_is_held or (self.region is None and is_closed(sites.spaces))
