"""The smooth surfaces that flat meshes stand for."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from opticcup_fem.errors import MeshError

__all__ = ["Plane", "Sphere", "Surface", "axis_arc"]

Array = npt.NDArray[np.float64]


class Surface(Protocol):
    """What a mesh needs to know of the surface it approximates."""

    @property
    def curvature(self) -> float:
        """Number k with ``b_ref = k a_ref`` [1/length]."""
        ...

    def project(self, x: Array) -> Array:
        """Return the surface points that belong to the points ``x``, shape (n, 3)."""
        ...

    def normal(self, x: Array) -> Array:
        """Return the unit normals at the points ``x``, shape (n, 3)."""
        ...

    def arc(self, p: Array, q: Array, t: Array) -> Array:
        """Return points at the fractions ``t`` of the shortest arcs from ``p`` to ``q``.

        Args:
            p: Start points on the surface, shape (m, 1, 3).
            q: End points on the surface, shape (m, 1, 3).
            t: Fractions from 0 to 1, shape (n,).

        Returns:
            Shape (m, n, 3).
        """
        ...


@dataclass(frozen=True)
class Sphere:
    """The sphere of a given radius about the origin, normal outward."""

    radius: float = 1.0

    def __post_init__(self) -> None:
        """Refuse a radius that is not a positive number."""
        if not (np.isfinite(self.radius) and self.radius > 0):
            raise MeshError(
                f"the radius of the sphere is {self.radius:g}; give a finite number above 0"
            )

    @property
    def curvature(self) -> float:
        """``-1/radius``: the outward normal makes ``b = n . r_,ab`` negative [1/length]."""
        return -1.0 / self.radius

    def project(self, x: Array) -> Array:
        """Return ``radius x/|x|``, shape (n, 3)."""
        projected: Array = self.radius * self.normal(x)
        return projected

    def normal(self, x: Array) -> Array:
        """Return ``x/|x|``, shape (n, 3), pointing outward."""
        direction: Array = x / np.linalg.norm(x, axis=-1, keepdims=True)
        return direction

    def arc(self, p: Array, q: Array, t: Array) -> Array:
        """Return points of great circles at equal angles; see `Surface.arc`."""
        sine = np.linalg.norm(np.cross(p, q), axis=-1)
        angle = np.arctan2(sine, np.einsum("mni,mni->mn", p, q))
        weights = [np.sin(s * angle) / np.sin(angle) for s in (1.0 - t, t)]
        points: Array = weights[0][..., None] * p + weights[1][..., None] * q
        return points


@dataclass(frozen=True)
class Plane:
    """The plane z = 0, normal +z."""

    @property
    def curvature(self) -> float:
        """Zero."""
        return 0.0

    def project(self, x: Array) -> Array:
        """Return ``x`` with z = 0, shape (n, 3)."""
        projected: Array = x * np.array([1.0, 1.0, 0.0])
        return projected

    def normal(self, x: Array) -> Array:
        """Return +z for every point, shape (n, 3)."""
        return np.broadcast_to(np.array([0.0, 0.0, 1.0]), x.shape).copy()

    def arc(self, p: Array, q: Array, t: Array) -> Array:
        """Return points of straight segments; see `Surface.arc`."""
        points: Array = p + t[:, None] * (q - p)
        return points


def axis_arc(p: Array, q: Array, t: Array) -> Array:
    """Return points at the fractions ``t`` of arcs of circles about the z axis.

    Args:
        p: Start points, shape (m, 1, 3).
        q: End points, at the height and at the distance from the axis of ``p``, shape (m, 1, 3).
        t: Fractions from 0 to 1, shape (n,).

    Returns:
        Shape (m, n, 3); the shorter way round.
    """
    start, end = np.arctan2(p[..., 1], p[..., 0]), np.arctan2(q[..., 1], q[..., 0])
    turn = (end - start + np.pi) % (2.0 * np.pi) - np.pi
    phi, radius = start + t * turn, np.hypot(p[..., 0], p[..., 1])
    height = np.broadcast_to(p[..., 2], phi.shape)
    return np.stack([radius * np.cos(phi), radius * np.sin(phi), height], axis=-1)
