"""Interval meshes of a meridian and the finite-element spaces on them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import basix
import basix.ufl
import numpy as np
import ufl
from numpy.typing import NDArray

from opticcup_fem.errors import MeshError
from opticcup_fem.meridian.profile import Profile

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Grading:
    """Cell sizes along a meridian, in the unit of its arc length.

    Attributes:
        largest: Size away from interfaces and rims.
        at_interface: Size of the two cells next to an interface.
        at_rim: Size of the cell next to a free rim.
        growth: Ratio of neighbouring cells, above 1.
    """

    largest: float = 0.12
    at_interface: float = 0.005
    at_rim: float = 0.02
    growth: float = 1.5

    def __post_init__(self) -> None:
        """Refuse sizes without a meaning.

        Raises:
            MeshError: A size is not positive or the ratio does not exceed 1.
        """
        sizes = (self.largest, self.at_interface, self.at_rim)
        if not (all(np.isfinite(sizes)) and min(sizes) > 0 and self.growth > 1):
            raise MeshError(
                f"cells of size {sizes} growing by {self.growth} make no mesh; "
                "give positive sizes and a growth above 1"
            )


def graded(low: float, high: float, at_low: float, at_high: float, grading: Grading) -> Array:
    """Return vertices from ``low`` to ``high`` whose spacing grows from both ends.

    Args:
        low: First vertex.
        high: Last vertex.
        at_low: Spacing at ``low``.
        at_high: Spacing at ``high``.
        grading: Largest spacing and growth.
    """
    # cells in equal steps of the integral of 1/size; the size grows linearly with the distance
    slope = np.log(grading.growth)
    s = np.linspace(low, high, 4001)
    size = np.minimum(grading.largest, at_low + slope * (s - low))
    size = np.minimum(size, at_high + slope * (high - s))
    count = np.concatenate([[0.0], np.cumsum(np.diff(s) * (1 / size[1:] + 1 / size[:-1]) / 2)])
    n = max(int(np.ceil(count[-1] - 1e-9)), 2)
    vertices = np.interp(np.linspace(0.0, count[-1], n + 1), count, s)
    vertices[[0, -1]] = low, high
    return vertices


class MeridianMesh:
    """Cells of a meridian with Lagrange nodes, numbered from the apex on.

    Attributes:
        profile: The reference meridian.
        degree: Polynomial degree of the position.
        vertices: Arc lengths of the vertices, shape (n_cells + 1,).
        cells: Nodes of each cell in basix order (two ends, then inside), shape
            (n_cells, degree + 1).
        s: Arc lengths of the nodes, shape (n_nodes,).
        region: Name of each region and its cells.
    """

    def __init__(self, profile: Profile, grading: Grading | None = None, degree: int = 3) -> None:
        """Mesh a profile.

        Args:
            profile: The reference meridian.
            grading: Cell sizes; by default 0.005 at an interface, growing to 0.12.
            degree: Polynomial degree of the position, at least 2.

        Raises:
            MeshError: The degree is too low.
        """
        if degree < 2:
            raise MeshError(f"the position has degree {degree}; curvature needs at least 2")
        self.profile, self.degree = profile, degree
        grading = grading or Grading()
        pieces, regions = _vertices(profile, grading)
        self.vertices: Array = np.concatenate([pieces[0], *(piece[1:] for piece in pieces[1:])])
        ends = np.cumsum([0, *(len(piece) - 1 for piece in pieces)])
        self.region: dict[str, Indices] = {
            name: np.arange(ends[i], ends[i + 1]) for i, name in enumerate(regions)
        }
        self._number()

    def _number(self) -> None:
        k, n = self.degree, self.n_cells
        first = k * np.arange(n)[:, None]
        self.cells: Indices = first + np.array([0, k, *range(1, k)])
        element = basix.create_element(
            basix.ElementFamily.P,
            basix.CellType.interval,
            k,
            basix.LagrangeVariant.gll_warped,
        )
        self.node_points: Array = np.asarray(element.points)
        self.s: Array = np.empty(k * n + 1)
        self.s[self.cells] = self.vertices[:-1, None] + self.sizes[:, None] * self.node_points[:, 0]
        self.basis = element

    def refined(self) -> MeridianMesh:
        """Return the mesh whose cells are the halves of this one's."""
        fine = copy(self)
        fine.vertices = np.empty(2 * self.n_cells + 1)
        fine.vertices[::2] = self.vertices
        fine.vertices[1::2] = (self.vertices[:-1] + self.vertices[1:]) / 2
        fine.region = {
            name: np.arange(2 * cells[0], 2 * cells[-1] + 2) for name, cells in self.region.items()
        }
        fine._number()
        return fine

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return len(self.vertices) - 1

    @property
    def n_nodes(self) -> int:
        """Number of Lagrange nodes."""
        return len(self.s)

    @property
    def sizes(self) -> Array:
        """Lengths of the cells, shape (n_cells,)."""
        return np.diff(self.vertices)

    @property
    def is_pole(self) -> NDArray[np.bool_]:
        """Which vertices are poles, shape (n_cells + 1,)."""
        poles = np.zeros(self.n_cells + 1, dtype=bool)
        poles[0], poles[-1] = True, self.profile.is_closed
        return poles

    def tabulate(self, points: Array, derivatives: int) -> Array:
        """Return the basis and its derivatives by s.

        Args:
            points: Reference points in [0, 1], shape (n_points,).
            derivatives: Highest derivative.

        Returns:
            Shape (derivatives + 1, n_cells, n_points, degree + 1).
        """
        table = self.basis.tabulate(derivatives, np.asarray(points)[:, None])[..., 0]
        powers = self.sizes[None, :] ** -np.arange(derivatives + 1.0)[:, None]
        return np.asarray(powers[:, :, None, None] * table[:, None])

    def points(self, reference: Array) -> Array:
        """Return the arc lengths of reference points in all cells, shape (n_cells, n_points)."""
        return self.vertices[:-1, None] + self.sizes[:, None] * np.asarray(reference)

    def corners(self) -> Array:
        """Return the corners of the cells as kernels want them, shape (n_cells, 2, 3)."""
        corners = np.zeros((self.n_cells, 2, 3))
        corners[:, 0, 0], corners[:, 1, 0] = self.vertices[:-1], self.vertices[1:]
        return corners

    def domain(self) -> ufl.Mesh:
        """Return the UFL mesh of the cells."""
        return ufl.Mesh(basix.ufl.element("Lagrange", "interval", 1, shape=(1,)))


def _vertices(profile: Profile, grading: Grading) -> tuple[list[Array], Sequence[str]]:
    """Return the vertices of each region, from the apex on, and the regions' names."""
    regions = profile.regions
    names = list(regions)
    pieces = []
    for i, name in enumerate(names):
        low, high = regions[name]
        at_low = grading.largest if i == 0 else grading.at_interface
        at_high = grading.at_interface
        if i == len(names) - 1:
            at_high = grading.largest if profile.is_closed else grading.at_rim
        pieces.append(graded(low, high, at_low, at_high, grading))
    return pieces, names
