"""Named numbers of a closed cup: heights, radii, depth, thickness at the apex, loss of symmetry.

An `Observer` prepares what depends on the mesh alone and then turns snapshots into numbers.  All
of them are measured about the cup's own axis, so that a rigid motion changes none.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.sampling import SphereSampler, azimuths, directions, interface_colatitude
from opticcup_fem.snapshot import (
    Floats,
    Snapshot,
    cell_tangents,
    lagrange_basis,
)

WAVENUMBERS = 9
"""Amplitudes on the interface circle are given for m = 0 .. 8."""

_RINGS = {"cap": 12, "oov": 20}
"""Gauss-Legendre colatitudes in each region (their weights are areas of the reference sphere)."""

_AZIMUTHS = 48
"""Points on each ring; resolves wavenumbers up to 23."""

_MERIDIAN_POINTS = 129
"""Points on each meridian in the search for the rim and for the largest radius."""

TOP = 1e-5
"""Depths (over R) below this are the cubic interpolation's, not a dimple's: D is 0."""


@dataclass(frozen=True)
class Frame:
    """The cup's own axes.

    Attributes:
        rotation: Rows are the cup's axes, the last one from the bottom to the apex; shape (3, 3).
        centre: A point on the axis, the area-weighted mean position, shape (3,).
    """

    rotation: Floats
    centre: Floats

    def __call__(self, points: Floats) -> Floats:
        """Return points (..., 3) in the cup's axes."""
        moved: Floats = (points - self.centre) @ self.rotation.T
        return moved


def cylindrical(points: Floats, phi: Floats) -> Floats:
    """Return components along e_r, e_phi, e_z of the azimuth phi; shapes (..., 3) and (...)."""
    c, s = np.cos(phi), np.sin(phi)
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([c * x + s * y, c * y - s * x, z], axis=-1)


def fit_axis(points: Floats, weights: Floats, phi: Floats, reference: Floats) -> Frame:
    """Return the frame in which the shape is as nearly axisymmetric as a rigid motion makes it.

    Alternates between the azimuthal mean of the shape and the best rigid motion onto it; each
    round removes what a rigid motion adds to m = 1 up to second order, so a few rounds suffice.

    Args:
        points: Current positions on rings, shape (n_rings, n_phi, 3).
        weights: Area weight of each ring's points, shape (n_rings,), n_phi times their sum is 1.
        phi: Reference azimuths, equally spaced, shape (n_phi,).
        reference: Reference positions of the same points; tells the apex from the bottom.

    Returns:
        The frame; its third axis is the cup's.
    """
    weighted = weights[:, None, None]
    centre = (weighted * points).sum(axis=(0, 1))
    target, rotation = reference, np.eye(3)
    for _ in range(20):
        covariance = np.einsum("tpi,tpj->ij", weighted * target, points - centre)
        left, _, right = np.linalg.svd(covariance)
        left[:, 2] *= np.sign(np.linalg.det(left @ right))
        change = np.linalg.norm(left @ right - rotation)
        rotation = left @ right
        mean = cylindrical((points - centre) @ rotation.T, phi).mean(axis=1, keepdims=True)
        target = cylindrical(np.broadcast_to(mean, points.shape), -phi)
        if change < 1e-13:
            break
    return Frame(rotation, centre)


def azimuthal_spectrum(points: Floats, phi: Floats) -> NDArray[np.complex128]:
    """Return the complex amplitudes of the positions' cylindrical components.

    Args:
        points: Positions about the axis at equally spaced azimuths, shape (..., n_phi, 3).
        phi: The reference azimuths, shape (n_phi,).

    Returns:
        c_m with x(phi) = sum over m of Re(c_m exp(i m phi)), m = 0 .. n_phi/2, shape
        (..., n_phi/2 + 1, 3); components along e_r, e_phi, e_z of the reference azimuth.
    """
    n = len(phi)
    spectrum = np.fft.rfft(cylindrical(points, phi), axis=-2) / n
    spectrum[..., 1 : (n + 1) // 2, :] *= 2
    return spectrum


def relative_asymmetry(spectrum: NDArray[np.complex128], weights: Floats) -> float:
    """Return the share of wavenumbers m >= 1 in the mean square of the positions.

    Args:
        spectrum: Amplitudes on rings, shape (n_rings, n_m, 3), about the centre.
        weights: Area weight of each ring, shape (n_rings,).
    """
    energy = np.einsum("t,tmi->m", weights, np.abs(spectrum) ** 2)
    energy[1:] /= 2
    return float(energy[1:].sum() / energy.sum())


def mean_peak(values: Floats) -> float:
    """Return the mean over meridians of the largest value on each.

    Where it lies inside a meridian it is the top of the parabola through the largest sample and
    its two neighbours.

    Args:
        values: A function at equally spaced points of each meridian, shape (n_theta, n_phi).
    """
    peak = values.max(axis=0)
    at = np.argmax(values, axis=0)
    inside = np.flatnonzero((at > 0) & (at < len(values) - 1))
    before, after = (values[at[inside] + step, inside] for step in (-1, 1))
    bend = before - 2 * peak[inside] + after
    flat = bend == 0
    peak[inside] -= np.where(flat, 0.0, (after - before) ** 2 / (8 * np.where(flat, 1.0, bend)))
    return float(peak.mean())


class Observer:
    """Turns snapshots of one mesh into named numbers."""

    def __init__(self, snapshot: Snapshot) -> None:
        """Prepare what depends on the mesh alone.

        Args:
            snapshot: Any state on the mesh (regions "cap" and "oov", a closed sphere).

        Raises:
            MeshError: The mesh is not a closed sphere of cap and OOV.
        """
        self.sampler = SphereSampler(snapshot)
        self.radius = float(np.linalg.norm(snapshot.reference, axis=1).mean())
        self.phi = azimuths(_AZIMUTHS)
        alpha = interface_colatitude(snapshot)
        theta, self.weights = _ring_rule(alpha)
        self._ring_reference = directions(theta[:, None], self.phi)
        self._rings = self.sampler.matrix(self.sampler.locate(self._ring_reference))
        circle = directions(alpha, self.phi)
        self._circle = self.sampler.matrix(self.sampler.locate(circle, "cap"))
        # off the interface's vertices, where the normal would be that of whichever cell comes first
        self._side_phi = self.phi + 0.38 * (self.phi[1] - self.phi[0])
        between = directions(alpha, self._side_phi)
        self._sides = [self.sampler.locate(between, region) for region in ("cap", "oov")]
        self._poles = self.sampler.matrix(self.sampler.locate([[0, 0, 1], [0, 0, -1]]))
        dense = np.linspace(0.0, np.pi, _MERIDIAN_POINTS)
        reference = directions(dense[:, None], self.phi)
        self._meridians = self.sampler.matrix(self.sampler.locate(reference))
        self._apex_cells = self.sampler.locate_all([0, 0, 1], "cap")

    def frame(self, snapshot: Snapshot) -> Frame:
        """Return the cup's own axes."""
        points = (self._rings @ snapshot.position).reshape(self._ring_reference.shape)
        return fit_axis(points, self.weights / len(self.phi), self.phi, self._ring_reference)

    def __call__(self, snapshot: Snapshot) -> dict[str, float]:
        """Return the observables of a state.

        Returns:
            ``D_over_r``, ``lambda_iov``, ``apex_height_over_R``, ``max_radius_over_R``,
            ``depth_over_R`` (docs/theory.md, "Observables"; rim and largest radius are means over
            the meridians, so that a mesh's small loss of symmetry counts in second order),
            ``tangent_angle_interface`` (rad; alpha on
            the sphere, 0 where the meridian is horizontal, mean over the circle), ``asymmetry``
            (share of m >= 1 in the mean square position), ``mouth_length_over_R`` and
            ``mouth_width_over_R`` (r.m.s. extents of the interface circle along its horizontal
            principal axes; equal where it is round) and ``interface_m0`` .. ``interface_m8``
            (amplitude over R of the displacement of the interface circle in wavenumber m).
        """
        frame = self.frame(snapshot)
        position = np.asarray(frame(snapshot.position) / self.radius, dtype=np.float64)
        aligned = replace(snapshot, position=position)
        apex, bottom = (self._poles @ aligned.position)[:, 2]
        meridians = (self._meridians @ aligned.position).reshape(_MERIDIAN_POINTS, -1, 3)
        top = mean_peak(meridians[..., 2])
        r = mean_peak(np.hypot(meridians[..., 0], meridians[..., 1]))
        depth = float(top - apex) if top - apex > TOP else 0.0
        numbers = {
            "D_over_r": depth / r,
            "lambda_iov": self._apex_stretch(snapshot),
            "apex_height_over_R": float(apex - bottom),
            "max_radius_over_R": r,
            "depth_over_R": depth,
            "tangent_angle_interface": self._tangent_angle(aligned),
            "asymmetry": relative_asymmetry(self.ring_spectrum(position), self.weights),
        }
        return numbers | self._mouth(aligned) | self._wavenumbers(aligned)

    def ring_spectrum(self, aligned: Floats) -> NDArray[np.complex128]:
        """Return the azimuthal amplitudes of a nodal field on rings, (n_rings, n_m, 3).

        Args:
            aligned: The field at the nodes, in the cup's axes, shape (n_nodes, 3).
        """
        rings = (self._rings @ aligned).reshape(self._ring_reference.shape)
        return azimuthal_spectrum(rings, self.phi)

    def on_interface(self, aligned: Floats) -> Floats:
        """Return a nodal field (n_nodes, 3) on the interface circle, shape (n_phi, 3)."""
        on_circle: Floats = self._circle @ aligned
        return on_circle

    def _apex_stretch(self, snapshot: Snapshot) -> float:
        """Return the mean of lambda_3 through the IOV at the apex, over the cells that meet."""
        values = snapshot.thickness_stretch["iov"][self._apex_cells.cell]
        at_apex = np.einsum("kj,kj->k", lagrange_basis(self._apex_cells.point), values)
        return float(at_apex.mean())

    def _tangent_angle(self, aligned: Snapshot) -> float:
        """Return the meridian's slope below the horizontal at the interface (rad)."""
        normals = np.zeros((len(self._side_phi), 3))
        for side in self._sides:
            tangents = cell_tangents(aligned.position, aligned.cells[side.cell], side.point)
            normal = np.cross(tangents[:, 0], tangents[:, 1])
            normal *= aligned.orientation[side.cell, None]
            normals += normal / np.linalg.norm(normal, axis=1, keepdims=True)
        # the normal of a meridian that falls by psi points psi away from the axis
        radial, _, axial = cylindrical(normals, self._side_phi).mean(axis=0)
        return float(np.arctan2(radial, axial))

    def _mouth(self, aligned: Snapshot) -> dict[str, float]:
        """Return the r.m.s. extents of the interface circle, the longer first."""
        circle = (self._circle @ aligned.position)[:, :2]
        squares = np.linalg.eigvalsh(np.cov(circle.T, bias=True))
        width, length = np.sqrt(np.maximum(squares, 0.0))
        return {"mouth_length_over_R": float(length), "mouth_width_over_R": float(width)}

    def _wavenumbers(self, aligned: Snapshot) -> dict[str, float]:
        """Return the amplitudes of the interface circle's displacement, m = 0 .. 8."""
        displacement = aligned.position - aligned.reference / self.radius
        spectrum = azimuthal_spectrum(self.on_interface(displacement), self.phi)
        amplitude = np.linalg.norm(spectrum, axis=1)
        return {f"interface_m{m}": float(amplitude[m]) for m in range(WAVENUMBERS)}


def _ring_rule(alpha: float) -> tuple[Floats, Floats]:
    """Return colatitudes of rings and their area weights (which sum to 1), each (n_rings,)."""
    edges = {"cap": (np.cos(alpha), 1.0), "oov": (-1.0, np.cos(alpha))}
    heights, weights = [], []
    for region, (low, high) in edges.items():
        x, w = np.polynomial.legendre.leggauss(_RINGS[region])
        heights.append((high - low) / 2 * x + (high + low) / 2)
        weights.append((high - low) / 4 * w)
    return np.arccos(np.concatenate(heights)), np.concatenate(weights)
