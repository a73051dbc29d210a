"""Azimuthal content about a cup's own axis: the wavenumber of a mode, the mean of a shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.interpolate import make_interp_spline

from opticcup_fem.observables import (
    WAVENUMBERS,
    Observer,
    azimuthal_spectrum,
    cylindrical,
    relative_asymmetry,
)
from opticcup_fem.sampling import directions, interface_colatitude
from opticcup_fem.snapshot import Floats, Snapshot, colatitudes


@dataclass(frozen=True)
class AzimuthalContent:
    """How a motion is spread over azimuthal wavenumbers.

    Attributes:
        shares: Share of m = 0, 1, 2 .. in the mean square of the motion over the reference
            sphere; they sum to 1.
        interface: Amplitude of the motion of the interface circle in m = 0 .. 8, largest 1.
        asymmetry: Of the state that moves (share of m >= 1 in its mean square position).
    """

    shares: tuple[float, ...]
    interface: tuple[float, ...]
    asymmetry: float

    @property
    def wavenumber(self) -> int:
        """The m of the largest share."""
        return int(np.argmax(self.shares))

    @property
    def purity(self) -> float:
        """The largest share."""
        return max(self.shares)

    def describe(self) -> dict[str, Any]:
        """Return the fields that an event records."""
        return {"wavenumber": self.wavenumber, "purity": self.purity}


def azimuthal_content(observer: Observer, snapshot: Snapshot, motion: Floats) -> AzimuthalContent:
    """Return the azimuthal content of a motion of a nearly axisymmetric state.

    Args:
        observer: Observer of the snapshot's mesh.
        snapshot: The state.
        motion: Displacement of its nodes, shape (n_nodes, 3).
    """
    frame = observer.frame(snapshot)
    turned = motion @ frame.rotation.T
    energy = np.einsum("t,tmi->m", observer.weights, np.abs(observer.ring_spectrum(turned)) ** 2)
    energy[1:] /= 2
    circle = np.linalg.norm(azimuthal_spectrum(observer.on_interface(turned), observer.phi), axis=1)
    largest = circle[:WAVENUMBERS].max()
    return AzimuthalContent(
        tuple((energy / energy.sum()).tolist()),
        tuple((circle[:WAVENUMBERS] / largest).tolist()),
        relative_asymmetry(observer.ring_spectrum(frame(snapshot.position)), observer.weights),
    )


class AxisymmetricPart:
    """The azimuthal mean of a cup, as positions of its mesh's nodes."""

    def __init__(self, observer: Observer, snapshot: Snapshot) -> None:
        """Prepare what depends on the mesh alone.

        Args:
            observer: Observer of the snapshot's mesh.
            snapshot: Any state on it.
        """
        self._observer = observer
        x, y, _ = snapshot.reference.T
        self._theta, self._phi = colatitudes(snapshot.reference), np.arctan2(y, x)
        alpha = interface_colatitude(snapshot)
        spread: dict[str, Floats] = {
            "cap": np.linspace(0.0, alpha, 41, dtype=np.float64),
            "oov": np.linspace(alpha, np.pi, 121, dtype=np.float64),
        }
        in_cap = self._theta <= alpha
        nodes = {"cap": in_cap, "oov": ~in_cap}
        self._profiles = [
            (theta, self._on_rings(theta, region), nodes[region])
            for region, theta in spread.items()
        ]

    def _on_rings(self, theta: Floats, region: str) -> sparse.csr_array:
        """Return the map from nodes to points at all azimuths of each colatitude of a region."""
        observer = self._observer
        points = directions(theta[:, None], observer.phi)
        return observer.sampler.matrix(observer.sampler.locate(points, region))

    def __call__(self, snapshot: Snapshot) -> Floats:
        """Return the positions of the nodes in the axisymmetric mean, shape (n_nodes, 3)."""
        frame, phi = self._observer.frame(snapshot), self._observer.phi
        aligned = frame(snapshot.position)
        mean = np.empty_like(aligned)
        for theta, matrix, nodes in self._profiles:
            rings = (matrix @ aligned).reshape(len(theta), len(phi), 3)
            profile = cylindrical(rings, phi).mean(axis=1)
            mean[nodes] = make_interp_spline(theta, profile, k=5)(self._theta[nodes])
        turned = cylindrical(mean, -self._phi)
        return np.asarray(turned @ frame.rotation + frame.centre, dtype=np.float64)
