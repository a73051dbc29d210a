r"""Follower pressure on a meridian: the potential -p V of a closed shell.

The work p int n . dr dA is p dV with V = 1/3 int x . n dA, for a closed shell; the tangent is
symmetric there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import ufl
from numpy.typing import NDArray

from opticcup_fem.shell.kernels import Kernel

if TYPE_CHECKING:
    from opticcup_fem.meridian.shell import MeridianShell

Array = NDArray[np.float64]
CellData = Mapping[ufl.Coefficient, Array]


class PressureWork:
    """Work p V over one period of the azimuth."""

    def __init__(self, kernels: Mapping[str, Kernel], pressure: float) -> None:
        """Keep the compiled blocks ``V_r`` and ``V_rr`` and the pressure (positive inflates)."""
        self._kernels, self._factor = kernels, 2 * np.pi * pressure

    @classmethod
    def of(cls, shell: MeridianShell, t_n: float) -> PressureWork | None:
        """Return the work of a shell's pressure at ``t_n``, None where it has none."""
        return None if shell.pressure is None else cls(shell.kernels, shell.pressure(t_n))

    def gradient(self, data: CellData) -> Array:
        """Return the first derivative in the cells' (r, alpha), shape (n_cells, n_u)."""
        in_r = self._kernels["V_r"](data)
        return self._factor * np.concatenate([in_r, np.zeros((len(in_r), 2))], axis=1)

    def tangent(self, data: CellData) -> Array:
        """Return the second derivative in r, shape (n_cells, n_r, n_r)."""
        return self._factor * self._kernels["V_rr"](data)
