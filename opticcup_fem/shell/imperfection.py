"""Deliberate geometric imperfections of a spherical mid-surface: waves around its axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MIXED = tuple(range(2, 9))
"""Wavenumbers of a random mixture."""


@dataclass(frozen=True)
class Wave:
    """A radial wave, amplitude sin^k theta cos(m phi + phase) with k = min(m, 3).

    It vanishes at the poles, where it and its curvature are continuous.

    Attributes:
        wavenumber: m, 2 or more.
        amplitude: Largest displacement, outward, unit of length of the mesh.
        phase: Radians.
    """

    wavenumber: int
    amplitude: float
    phase: float = 0.0

    def __call__(self, x: Array) -> Array:
        """Return the displacement of points (n, 3) of a sphere about the origin, shape (n, 3)."""
        direction = x / np.linalg.norm(x, axis=1, keepdims=True)
        sine = np.hypot(direction[:, 0], direction[:, 1])
        phi = np.arctan2(direction[:, 1], direction[:, 0])
        around = np.cos(self.wavenumber * phi + self.phase)
        out = self.amplitude * sine ** min(self.wavenumber, 3) * around
        return np.asarray(out[:, None] * direction, dtype=np.float64)


@dataclass(frozen=True)
class Imperfection:
    """A sum of waves.

    The shell is free of membrane stress on the imperfect surface.  The curvature that it is free
    of moments at remains the perfect sphere's, b_ref = -a_ref/R: a dent is an unwanted shape of a
    shell that would rather be round, not a shell that was made with a dent.
    """

    waves: tuple[Wave, ...]

    def __call__(self, x: Array) -> Array:
        """Return the displacement of points (n, 3) of the perfect sphere, shape (n, 3)."""
        total: Array = np.zeros_like(x)
        for wave in self.waves:
            total = total + wave(x)
        return total


def draw_imperfection(wavenumber: int, amplitude: float, seed: int) -> Imperfection:
    """Return an imperfection whose phases, and in a mixture amplitudes, are drawn at random.

    Args:
        wavenumber: m of a single wave, or 0 for a mixture of m = 2 .. 8 with normally distributed
            amplitudes, the root of the sum of whose squares is ``amplitude``.
        amplitude: Unit of length of the mesh.
        seed: Of the draw.
    """
    rng = np.random.default_rng(seed)
    wavenumbers = MIXED if wavenumber == 0 else (wavenumber,)
    phases = rng.uniform(0.0, 2 * np.pi, len(wavenumbers))
    shares = np.ones(1) if wavenumber else rng.normal(size=len(wavenumbers))
    amplitudes = amplitude * shares / np.linalg.norm(shares)
    return Imperfection(
        tuple(
            Wave(m, float(a), float(phase))
            for m, a, phase in zip(wavenumbers, amplitudes, phases, strict=True)
        )
    )
