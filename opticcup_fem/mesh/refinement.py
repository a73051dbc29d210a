"""Places of a sphere where a mesh has smaller cells."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from opticcup_fem.errors import MeshError

__all__ = ["STEEPEST", "Refinement", "refined"]

STEEPEST = 0.5
"""Largest growth of the cell size per distance; beyond it, angles fall below 30 degrees."""


@dataclass(frozen=True)
class Refinement:
    """A disc on a sphere in which cells are no larger than a size; around it they grow.

    Attributes:
        colatitude: Of the disc's centre [rad], 0 to pi.
        azimuth: Of the disc's centre [rad].
        extent: Distance of the disc's edge from its centre, along the sphere.
        cell_size: Edge length of its cells.
    """

    colatitude: float
    azimuth: float
    extent: float
    cell_size: float

    def __post_init__(self) -> None:
        """Refuse what is no place, or no size."""
        if not (0.0 <= self.colatitude <= np.pi and np.isfinite(self.azimuth)):
            raise MeshError(
                f"a refinement is at the colatitude {self.colatitude:g} rad and the azimuth "
                f"{self.azimuth:g} rad; give a colatitude between 0 and pi (180 degrees)"
            )
        if not (self.extent >= 0.0 and self.cell_size > 0.0):
            raise MeshError(
                f"a refinement has the extent {self.extent:g} and the cell size "
                f"{self.cell_size:g}; give an extent from 0 and a size above 0"
            )

    @cached_property
    def centre(self) -> npt.NDArray[np.float64]:
        """Direction of the disc's centre, shape (3,)."""
        sine = np.sin(self.colatitude)
        return np.array(
            [
                sine * np.cos(self.azimuth),
                sine * np.sin(self.azimuth),
                np.cos(self.colatitude),
            ]
        )

    def folded(self, symmetry: int) -> Refinement:
        """Return the image in the wedge 0 <= phi <= pi/symmetry; itself without symmetry."""
        if symmetry == 0:
            return self
        wedge = np.pi / symmetry
        azimuth = self.azimuth % (2 * wedge)
        return replace(self, azimuth=min(azimuth, 2 * wedge - azimuth))

    def in_radii(self, radius: float) -> Refinement:
        """Return it with lengths in units of a radius."""
        return replace(self, extent=self.extent / radius, cell_size=self.cell_size / radius)

    def upside_down(self) -> Refinement:
        """Return the image behind z = 0."""
        return replace(self, colatitude=np.pi - self.colatitude)


def refined(
    size: float, place: npt.NDArray[np.float64], refinements: Iterable[Refinement]
) -> float:
    """Return the cell size at a place of the unit sphere.

    Args:
        size: Cell size without refinements.
        place: Unit vector, shape (3,).
        refinements: Lengths in units of the radius.
    """
    for spot in refinements:
        distance = float(np.arccos(np.clip(place @ spot.centre, -1.0, 1.0)))
        size = min(size, spot.cell_size + STEEPEST * max(0.0, distance - spot.extent))
    return size
