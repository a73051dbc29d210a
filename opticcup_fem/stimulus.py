"""What makes a layer expand, and what that does to its stress: (S10), (S12)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from opticcup_fem.case import Case

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stimulus:
    """Growth, swelling or heating of a layer.

    M = J rho/rho_0 is the mass per initial mass.  With v_m in 1/rho_0 and s the energy per mass of
    what is added, over that of the tissue,

        e = sqrt(1 + v_m (M - 1))      (S10)
        rho_r = 1 + s (M - 1)          (S12)

    so that s = 1, growth by the same material, has rho_r = J rho/rho_0, and s = 0, swelling by a
    fluid without stiffness or heating, has rho_r = 1.  Of heating M - 1 is a heat, not a mass.

    Attributes:
        specific_volume: v_m rho_0; 1 preserves the density.
        stiffness: s.
    """

    specific_volume: float = 1.0
    stiffness: float = 1.0

    def factor(self, mass: ArrayLike) -> Array:
        """Return e of M; NaN where the layer would vanish."""
        square = 1 + self.specific_volume * (np.asarray(mass, dtype=float) - 1)
        return np.sqrt(np.where(square > 0, square, np.nan))

    def mass(self, factor: ArrayLike) -> Array:
        """Return M of e."""
        return np.asarray(1 + (np.square(factor) - 1) / self.specific_volume)

    def density_ratio(self, mass: ArrayLike) -> Array:
        """Return rho_r of M."""
        return np.asarray(1 + self.stiffness * (np.asarray(mass, dtype=float) - 1))

    def density_ratio_of_factor(self, factor: ArrayLike) -> Array:
        """Return rho_r of e."""
        if self == GROWTH:  # to the last digit
            return np.square(np.asarray(factor, dtype=float))
        return self.density_ratio(self.mass(factor))


GROWTH = Stimulus()
"""Density-preserving growth by the same material."""

NO_MASS = Stimulus(stiffness=0.0)
"""Swelling, heating, and growth whose mass is neglected."""


def stimulus_of(case: Case, layer: str) -> Stimulus:
    """Return what makes a layer of a case expand."""
    keys = getattr(case.mass, layer)
    kind = keys.kind
    if kind == "default":
        kind = "growth" if case.growth.mass_change else "swelling"
    stiffness = {"growth": 1.0, "other": keys.stiffness}.get(kind, 0.0)
    return Stimulus(keys.specific_volume, stiffness)
