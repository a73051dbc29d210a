"""Reference meridians: closed sphere with cap, open spherical cap, flat disc."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.errors import CaseError

Array = NDArray[np.float64]


class Profile(Protocol):
    """A reference meridian by arc length s from the pole at the apex, radius or rim size 1 R."""

    @property
    def regions(self) -> Mapping[str, tuple[float, float]]:
        """Interval of s of each region, from the apex on, without gaps."""
        ...

    @property
    def curvature(self) -> float:
        """Number k with ``b_ref = k a_ref`` [1/length]."""
        ...

    @property
    def is_closed(self) -> bool:
        """Whether the meridian ends in a second pole."""
        ...

    def position(self, s: Array) -> Array:
        """Return (r, z) at arc lengths s, shape (n, 2)."""
        ...

    def angle(self, s: Array) -> Array:
        """Return the angle of the tangent with the radial direction, shape (n,), 0 at the apex."""
        ...


@dataclass(frozen=True)
class _Spherical:
    """What a closed sphere and an open cap of it share."""

    opening_angle: float
    radius: float = 1.0

    def __post_init__(self) -> None:
        """Refuse a cap that is empty or the whole sphere.

        Raises:
            CaseError: The opening angle or the radius is out of range.
        """
        _check_sphere(self.opening_angle, self.radius)

    @property
    def curvature(self) -> float:
        """See ``Profile``."""
        return -1.0 / self.radius

    def position(self, s: Array) -> Array:
        """See ``Profile``."""
        return _circle(s, self.radius)

    def angle(self, s: Array) -> Array:
        """See ``Profile``."""
        return np.asarray(-s / self.radius)


@dataclass(frozen=True)
class ClosedSphere(_Spherical):
    """The sphere of a given radius: cap and OOV, which meet at a colatitude.

    Attributes:
        opening_angle: Colatitude alpha of the interface, radians.
        radius: Radius R.
    """

    @property
    def regions(self) -> Mapping[str, tuple[float, float]]:
        """See ``Profile``."""
        interface = self.opening_angle * self.radius
        return {"cap": (0.0, interface), "oov": (interface, math.pi * self.radius)}

    @property
    def is_closed(self) -> bool:
        """See ``Profile``."""
        return True


@dataclass(frozen=True)
class OpenCap(_Spherical):
    """A spherical cap with a free rim; its one region is "cap".

    Attributes:
        opening_angle: Colatitude alpha of the rim, radians.
        radius: Radius R of the sphere.
    """

    @property
    def regions(self) -> Mapping[str, tuple[float, float]]:
        """See ``Profile``."""
        return {"cap": (0.0, self.opening_angle * self.radius)}

    @property
    def is_closed(self) -> bool:
        """See ``Profile``."""
        return False


@dataclass(frozen=True)
class Disc:
    """A flat disc with a free rim; its one region is "cap", with the normal along +z.

    Attributes:
        radius: Radius Rp.
    """

    radius: float = 1.0

    def __post_init__(self) -> None:
        """Refuse a radius that is not a positive number.

        Raises:
            CaseError: The radius is out of range.
        """
        if not (math.isfinite(self.radius) and self.radius > 0):
            raise CaseError(f"the radius of the disc is {self.radius}; it must be positive.")

    @property
    def regions(self) -> Mapping[str, tuple[float, float]]:
        """See ``Profile``."""
        return {"cap": (0.0, self.radius)}

    @property
    def curvature(self) -> float:
        """See ``Profile``."""
        return 0.0

    @property
    def is_closed(self) -> bool:
        """See ``Profile``."""
        return False

    def position(self, s: Array) -> Array:
        """See ``Profile``."""
        return np.stack([s, np.zeros_like(s)], axis=-1)

    def angle(self, s: Array) -> Array:
        """See ``Profile``."""
        return np.zeros_like(s)


def _circle(s: Array, radius: float) -> Array:
    """Return (r, z) on a circle about the origin, shape (n, 2)."""
    return radius * np.stack([np.sin(s / radius), np.cos(s / radius)], axis=-1)


def _check_sphere(opening_angle: float, radius: float) -> None:
    if not 0 < opening_angle < math.pi:
        raise CaseError(f"the opening angle is {opening_angle} rad; it must lie between 0 and pi.")
    if not (math.isfinite(radius) and radius > 0):
        raise CaseError(f"the radius of the sphere is {radius}; it must be positive.")
