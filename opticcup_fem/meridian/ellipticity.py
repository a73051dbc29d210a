r"""Whether a closure still resists short waves along the meridian.

Along a meridian W is a function of the stretch l and of the rotation per length omega' = b_11/l.
Waves that are short against every length of the shell see only its Hessian in (l, omega'),

    W_ll = 2 W_a + 4 l^2 W_aa + 4 b W_ab + omega'^2 W_bb
    W_lw = W_b + 2 l^2 W_ab + b W_bb
    W_ww = l^2 W_bb

(a = a_11, b = b_11).  Where it is not positive definite the equations are not elliptic: the
tissue may fold at any wavelength, and the solution is that of the mesh.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.meridian.shell import MeridianShell, MeridianState

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Ellipticity:
    """Least stiffness against short waves.

    Attributes:
        value: Smallest eigenvalue of the Hessian in (l, h omega'), unit mu_IOV R.
        position: Its place (r, z).
    """

    value: float
    position: tuple[float, float]


def short_wave_hessian(forms: Array, stress: Array, tangent: Array, thickness: float) -> Array:
    """Return the Hessian of W in (l, h omega').

    Args:
        forms: (a_11, a_22, a_12, b_11, b_22, b_12), shape (..., 6).
        stress: Derivative of W in them, same shape.
        tangent: Second derivative, shape (..., 6, 6).
        thickness: h.

    Returns:
        Shape (..., 2, 2).
    """
    a, b = forms[..., 0], forms[..., 3]
    stretch = np.sqrt(a)
    turn = b / stretch
    w_aa, w_ab, w_bb = tangent[..., 0, 0], tangent[..., 0, 3], tangent[..., 3, 3]
    ll = 2 * stress[..., 0] + 4 * a * w_aa + 4 * b * w_ab + turn**2 * w_bb
    lw = (stress[..., 3] + 2 * a * w_ab + b * w_bb) / thickness
    ww = a * w_bb / thickness**2
    return np.stack([np.stack([ll, lw], -1), np.stack([lw, ww], -1)], -2)


def ellipticity(shell: MeridianShell, state: MeridianState, t_n: float) -> Ellipticity:
    """Return the least stiffness against short waves over the quadrature points."""
    forms = shell.forms_at_points(state)
    result = shell.resultants_of(forms, t_n)
    assert result.tangent is not None
    thickness = max(section.thickness for section in shell.sections.values())
    hessian = short_wave_hessian(forms, result.stress, result.tangent, thickness)
    lowest = np.linalg.eigvalsh((hessian + np.swapaxes(hessian, -1, -2)) / 2)[..., 0]
    cell, point = np.unravel_index(int(np.argmin(lowest)), lowest.shape)
    r, z = shell.basis[cell, point] @ state.r[shell.mesh.cells[cell]]
    return Ellipticity(float(lowest[cell, point]), (float(r), float(z)))
