"""Where the layers of an axisymmetric state are: thickness stretch, faces, meridian sections."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.sections import Section, SectionPart
from opticcup_fem.shell import closures

Array = NDArray[np.float64]


def layer_stretches(
    shell: MeridianShell, state: MeridianState, t_n: float, region: str
) -> dict[str, Array]:
    """Return each layer's mean of lambda_3 at the nodes of a region's cells.

    Evaluated at the quadrature points and carried to the nodes by a quadratic fit on each cell.

    Returns:
        Shape (n_cells of the region, degree + 1), ends first.
    """
    cells = shell.mesh.region[region]
    forms = shell.forms_at_points(state)[cells].reshape(-1, 6)
    means = closures.mean_stretches(
        shell.closure,
        shell.sections[region],
        shell.growth_at(t_n, region),
        forms,
        np.broadcast_to([1.0, 1.0, 0.0], (len(forms), 3)),
        shell.mesh.profile.curvature,
    )
    powers = np.arange(3)
    at_points = shell.forms.quadrature_points[:, None] ** powers
    fit = shell.mesh.node_points**powers @ np.linalg.pinv(at_points)
    return {name: mean.reshape(len(cells), -1) @ fit.T for name, mean in means.items()}


def region_profile(
    shell: MeridianShell, state: MeridianState, t_n: float, region: str
) -> tuple[Array, Array, Array]:
    """Return a region's mid-surface and faces along the meridian.

    Returns:
        Arc lengths, shape (k,); positions (r, z), shape (k, 2); faces, inside first, shape
        (k, n_layers + 1, 2).
    """
    mesh, section = shell.mesh, shell.sections[region]
    cells = mesh.region[region]
    order = np.argsort(mesh.node_points[:, 0])
    nodes = mesh.cells[cells][:, order]
    s, position = mesh.s[nodes], state.r[nodes]
    tangent = np.einsum(
        "cqn,cni->cqi",
        mesh.tabulate(mesh.node_points[order, 0], 1)[1, cells],
        state.r[mesh.cells[cells]],
    )
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    normal = np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)
    means = layer_stretches(shell, state, t_n, region)
    stretches = [means[layer.name][:, order] for layer in section.layers]
    faces = position[:, :, None] + section.face_heights(stretches)[..., None] * normal[:, :, None]
    keep = np.ones(s.shape, dtype=bool)
    # neighbours share their end
    keep[1:, 0] = False
    return s[keep], position[keep], faces[keep]


def sections(
    shell: MeridianShell, state: MeridianState, t_n: float, azimuths: Sequence[float]
) -> tuple[Section, ...]:
    """Return the meridian at some azimuths, as ``opticcup_fem.sections`` has it.

    Args:
        shell: The shell.
        state: A state.
        t_n: Its normalised time.
        azimuths: Azimuths phi, radians.
    """
    radius = 1.0 if shell.mesh.profile.curvature == 0 else -1.0 / shell.mesh.profile.curvature
    profiles = {name: region_profile(shell, state, t_n, name) for name in shell.mesh.region}

    def part(name: str, phi: float) -> SectionPart:
        s, middle, faces = profiles[name]
        layers = tuple(layer.name for layer in shell.sections[name].layers)
        return SectionPart(np.asarray(s / radius), _at(middle, phi), _at(faces, phi), layers)

    return tuple(
        Section(float(phi), {name: part(name, float(phi)) for name in profiles}) for phi in azimuths
    )


def _at(points: Array, phi: float) -> Array:
    """Return points (..., 2) of the meridian at an azimuth, shape (..., 3)."""
    r, z = np.moveaxis(points, -1, 0)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)
