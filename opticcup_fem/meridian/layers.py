"""Where the layers of an axisymmetric state are: thickness stretch, faces, meridian sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.meridian.transport import meridian_geometry
from opticcup_fem.sections import Section, SectionPart
from opticcup_fem.shell.recovery import LayerFields, heights_of, layer_means

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Meridian:
    """A region's mid-surface and layers at points of the meridian.

    Attributes:
        position: (r, z), shape (k, 2).
        faces: (r, z) of the layers' faces, inside first, shape (k, n_layers + 1, 2).
        growth: ``e_<layer>``, ``rho_<layer>`` of balanced layers in the region, shape (k,).
        fields: Thickness stretch, (k,), stress, (k, 3), factor on the thickness, (k,), by layer.
    """

    position: Array
    faces: Array
    fields: dict[str, LayerFields]
    growth: dict[str, Array]


def evaluate(
    shell: MeridianShell, state: MeridianState, t_n: float, region: str, s: Array
) -> Meridian:
    """Return a region's mid-surface and layers at arc lengths.

    Layers are evaluated at the quadrature points and carried on by a quadratic fit on each cell.

    Args:
        shell: The shell.
        state: A state.
        t_n: Its normalised time.
        region: Name of the region.
        s: Arc lengths within the region, its ends included, shape (k,).
    """
    mesh, section, cells = shell.mesh, shell.sections[region], shell.mesh.region[region]
    forms = shell.forms_at_points(state)[cells].reshape(-1, 6)
    means = layer_means(
        shell.closure,
        section,
        shell.growth_at(t_n, region),
        forms,
        np.broadcast_to([1.0, 1.0, 0.0], (len(forms), 3)),
        mesh.profile.curvature,
        np.broadcast_to([1.0, 0.0], (len(forms), 2)),
    )
    inside = np.searchsorted(mesh.vertices[cells[1:]], s, side="right")
    cell = cells[inside]
    x = (s - mesh.vertices[cell]) / mesh.sizes[cell]

    def at(values: Array) -> Array:
        return shell.carried(region, values, s)

    fields = {
        name: LayerFields(at(mean.thickness_stretch), at(mean.stress), at(mean.thickness))
        for name, mean in means.items()
    }
    table = mesh.basis.tabulate(1, x[:, None])[..., 0]
    position, tangent = np.einsum("dkn,kni->dki", table, state.r[mesh.cells[cell]])
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    heights = heights_of(section, fields)
    faces = position[:, None] + heights[..., None] * normal[:, None]
    return Meridian(position, faces, fields, _growth(shell, state, t_n, region, s))


def _growth(
    shell: MeridianShell, state: MeridianState, t_n: float, region: str, s: Array
) -> dict[str, Array]:
    """Return e and rho of a region's balanced layers at arc lengths."""
    balance = shell.balance
    if balance is None:
        return {}
    found = {}
    geometry = meridian_geometry(shell, state, t_n)
    for name, values in balance.fields(t_n, geometry).items():
        cells = balance.layers[name.partition("_")[2]].sites.cells
        inside = np.isin(cells, shell.mesh.region[region])
        if inside.any():
            found[name] = shell.carried(region, values[inside].ravel(), s)
    return found


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
    nodes = {
        name: np.unique(shell.mesh.s[shell.mesh.cells[cells]])
        for name, cells in shell.mesh.region.items()
    }
    profiles = {name: evaluate(shell, state, t_n, name, s) for name, s in nodes.items()}

    def part(name: str, phi: float) -> SectionPart:
        on = profiles[name]
        layers = tuple(layer.name for layer in shell.sections[name].layers)
        theta = np.asarray(nodes[name] / radius)
        return SectionPart(theta, at_azimuth(on.position, phi), at_azimuth(on.faces, phi), layers)

    return tuple(
        Section(float(phi), {name: part(name, float(phi)) for name in profiles}) for phi in azimuths
    )


def at_azimuth(points: Array, phi: float | Array) -> Array:
    """Return points (r, z), shape (..., 2), in space at azimuths that fit (...), shape (..., 3)."""
    r, z = np.moveaxis(points, -1, 0)
    return np.stack([r * np.cos(phi), r * np.sin(phi), np.broadcast_to(z, np.shape(r * phi))], -1)
