"""Material meridians of a cup: the middle surface's and the layers' faces from apex to bottom."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from opticcup_fem.sampling import SphereSampler, directions, interface_colatitude
from opticcup_fem.snapshot import Floats, Snapshot, cell_values, lagrange_basis


@dataclass(frozen=True)
class SectionPart:
    """A material meridian inside one region.

    Attributes:
        theta: Reference colatitudes (rad), increasing, shape (k,).
        midsurface: Current positions of the middle surface, shape (k, 3).
        faces: Current positions of the layers' faces, inside first, shape (k, n_layers + 1, 3).
        layers: The layers between these faces.
    """

    theta: Floats
    midsurface: Floats
    faces: Floats
    layers: tuple[str, ...]


@dataclass(frozen=True)
class Section:
    """The material meridian at reference azimuth phi (rad): its part in each region, apex first."""

    phi: float
    parts: Mapping[str, SectionPart]


class Meridians:
    """Takes material meridians, from the apex to the bottom pole, of snapshots of one mesh."""

    def __init__(self, snapshot: Snapshot, azimuths: ArrayLike, count: int = 48) -> None:
        """Find the meridians' points on the mesh.

        Args:
            snapshot: Any state on the mesh (regions "cap" and "oov").
            azimuths: Reference azimuths (rad), shape (n,).
            count: Points of each meridian in each region, closer together near the interface.
        """
        self.azimuths = np.atleast_1d(np.asarray(azimuths, dtype=float))
        sampler, alpha = SphereSampler(snapshot), interface_colatitude(snapshot)
        # the shape bends most sharply at the interface: points crowd there
        grading = np.sin(np.linspace(0, np.pi / 2, count))
        self.theta = {"cap": alpha * grading, "oov": np.pi - (np.pi - alpha) * grading[::-1]}
        self._located = {
            region: sampler.locate(directions(theta, self.azimuths[:, None]), region)
            for region, theta in self.theta.items()
        }

    def __call__(self, snapshot: Snapshot) -> tuple[Section, ...]:
        """Return the sections of a state, one for each azimuth.

        Each region ends on the interface circle with its own faces.
        """
        parts = {region: self._parts(snapshot, region) for region in self.theta}
        return tuple(
            Section(float(phi), {region: parts[region][k] for region in parts})
            for k, phi in enumerate(self.azimuths)
        )

    def _parts(self, snapshot: Snapshot, region: str) -> list[SectionPart]:
        located, theta = self._located[region], self.theta[region]
        row = np.searchsorted(snapshot.cells_of(region), located.cell)
        weights = lagrange_basis(located.point)
        middle = cell_values(snapshot.position, snapshot.cells[located.cell], located.point)
        middle = middle.reshape(len(self.azimuths), len(theta), 3)
        faces = np.einsum("kj,kjfi->kfi", weights, snapshot.faces[region][row])
        faces = faces.reshape(*middle.shape[:2], -1, 3)
        layers = tuple(snapshot.layers[region])
        return [SectionPart(theta, m, f, layers) for m, f in zip(middle, faces, strict=True)]


def meridian(snapshot: Snapshot, phi: float, count: int = 48) -> Section:
    """Return one state's material meridian at azimuth phi (rad); see `Meridians`."""
    return Meridians(snapshot, phi, count)(snapshot)[0]
