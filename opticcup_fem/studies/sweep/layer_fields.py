"""Stress of the layers along an axisymmetric state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.shell import closures, fibres

Array = NDArray[np.float64]


def layer_stresses(
    shell: MeridianShell, state: MeridianState, t_n: float, region: str
) -> dict[str, Array]:
    r"""Return each layer's mean meridional Cauchy stress at the quadrature points of a region.

    With S^11 = 2 rho_r dPsi_0/dg_11 per reference volume and J = sqrt(det g/det a_ref) lambda_3 it
    is S^11 g_11/J.

    Returns:
        Shape (n_cells of the region, n_points), unit mu_IOV.
    """
    cells = shell.mesh.region[region]
    section = shell.sections[region]
    shape = shell.points[cells].shape
    forms = shell.forms_at_points(state)[cells].reshape(-1, 6)
    inv = fibres.invariants(forms, np.broadcast_to([1.0, 1.0, 0.0], (len(forms), 3)))
    means = {layer.name: np.zeros(len(forms)) for layer in section.layers}
    growth = shell.growth_at(t_n, region)
    for fibre in fibres.fibres(section, growth, shell.mesh.profile.curvature):
        s, D, stretch = closures.fibre_state(shell.closure, inv, fibre)
        g_11, g_22 = forms[:, 0] + s * forms[:, 3], forms[:, 1] + s * forms[:, 4]
        slope = fibres.area_slope(D, stretch**2, fibre.layer)
        work = 2 * slope * D + fibre.layer.shear_modulus * g_11 / fibre.natural
        jacobian = np.sqrt(g_11 * g_22) * stretch
        share = fibre.gauss_weight / fibre.layer.thickness
        means[fibre.layer.name] += share * fibre.density_ratio * work / jacobian
    return {name: mean.reshape(shape) for name, mean in means.items()}
