"""What a state means layer by layer: thickness stretch, stress, and the places of the faces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.shell import closures, fibres
from opticcup_fem.shell.fibres import GrowthState
from opticcup_fem.shell.layer_geometry import layer_geometry
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.section import Section
from opticcup_fem.snapshot import NODES, Snapshot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LayerFields:
    """Layer means at some points, usually the nodes of the cells of one region.

    Attributes:
        thickness_stretch: Mean of lambda_3 through the layer, shape (n_cells, n_nodes).
        stress: Mean Cauchy stress (meridional, azimuthal, shear), shape (n_cells, n_nodes, 3),
            unit mu_IOV.  The first direction is the current image of the reference meridian.
        thickness: Factor on the thickness at rest, shape (n_cells, n_nodes).
    """

    thickness_stretch: Array
    stress: Array
    thickness: Array


def layer_fields(shell: Shell, state: ShellState, region: str) -> dict[str, LayerFields]:
    """Recover the layers' fields at the nodes of a region's cells.

    They are evaluated at the quadrature points, where the solver has made sure that every layer
    has a state, and carried to the nodes by a quadratic fit on each cell.

    With S^ab = 2 rho_r dPsi_0/dg_ab per reference volume and J = sqrt(det g/det a_ref) lambda_3,
    the Cauchy stress is S^ab g_a g_b / J; its physical components are taken in the metric g.

    Args:
        shell: The shell, at the growth that ``state`` belongs to.
        state: The state.
        region: Name of a region.
    """
    cells = shell.region_cells(region)
    means = layer_means(
        shell.closure,
        shell.sections[region],
        shell.growth[region],
        shell.forms_at_points(state)[cells].reshape(-1, 6),
        shell.a_ref[cells].reshape(-1, 3),
        shell.surface_mesh.surface.curvature,
        _meridian(shell, cells),
    )
    to_nodes = _quadratic_fit(shell)
    shape = (len(cells), to_nodes.shape[1])
    return {
        name: LayerFields(
            mean.thickness_stretch.reshape(shape) @ to_nodes.T,
            np.einsum("nq,cqi->cni", to_nodes, mean.stress.reshape(*shape, 3)),
            mean.thickness.reshape(shape) @ to_nodes.T,
        )
        for name, mean in means.items()
    }


def layer_means(
    closure: str,
    section: Section,
    growth: Sequence[GrowthState],
    forms: Array,
    a_ref: Array,
    k_ref: float,
    meridian: Array,
) -> dict[str, LayerFields]:
    """Return the layers' means through the thickness at points.

    Args:
        closure: A key of ``closures.CLOSURES``.
        section: The layers.
        growth: Growth of each layer, innermost first.
        forms: Fundamental forms (a, b), each (11, 22, 12), shape (n, 6).
        a_ref: Reference metric (11, 22, 12), shape (n, 3).
        k_ref: Number k with ``b_ref = k a_ref`` [1/length].
        meridian: Contravariant components of the first direction of stress, shape (n, 2).

    Returns:
        For each layer fields of shapes (n,), (n, 3) and (n,).
    """
    inv = fibres.invariants(forms, a_ref)
    stretches = {layer.name: np.zeros(len(forms)) for layer in section.layers}
    stresses = {layer.name: np.zeros((len(forms), 3)) for layer in section.layers}
    for fibre in fibres.fibres(section, growth, k_ref):
        share = fibre.share
        s, D, stretch = closures.fibre_state(closure, inv, fibre)
        metric = forms[:, :3] + s[:, None] * forms[:, 3:]
        stretches[fibre.layer.name] += share * stretch
        stresses[fibre.layer.name] += share * _cauchy(fibre, D, stretch, metric, a_ref, meridian)
    return {
        layer.name: LayerFields(
            stretches[layer.name],
            stresses[layer.name],
            np.broadcast_to(state.thickness, len(forms)),
        )
        for layer, state in zip(section.layers, growth, strict=True)
    }


def _quadratic_fit(shell: Shell) -> Array:
    """Return the map from values at the quadrature points to values at the nodes of a cell."""
    at_points = shell.spaces.curvature_table(shell.forms.quadrature_points)
    fit: Array = shell.spaces.curvature_table(NODES) @ np.linalg.pinv(at_points)
    return fit


def _meridian(shell: Shell, cells: NDArray[np.int32]) -> Array:
    """Return contravariant components of the meridian's direction at the quadrature points.

    On the axis, where there is none, the direction of x stands in.

    Returns:
        Shape (n_cells * n_points, 2).
    """
    spaces = shell.spaces
    points = shell.forms.quadrature_points
    nodes = spaces.nodes[cells]
    base = np.einsum("cqna,cni->cqai", spaces.gradient_operator(points)[cells], shell.rest[nodes])
    x = np.einsum("qn,cni->cqi", spaces.position_table(points), shell.rest[nodes])
    outwards = x * np.array([1.0, 1.0, 0.0])
    outwards[np.linalg.norm(outwards, axis=-1) < 1e-9] = (1.0, 0.0, 0.0)
    azimuth = np.cross(np.array([0.0, 0.0, 1.0]), outwards)
    direction = np.cross(azimuth, np.cross(base[..., 0, :], base[..., 1, :]))
    covariant = np.einsum("cqai,cqi->cqa", base, direction).reshape(-1, 2)
    return _lowered(_inverse(shell.a_ref[cells].reshape(-1, 3)), covariant)


def _cauchy(
    fibre: fibres.Fibre, D: Array, stretch: Array, metric: Array, a_ref: Array, meridian: Array
) -> Array:
    """Return the physical Cauchy components (11, 22, 12) of a fibre, shape (n, 3).

    Metrics are (11, 22, 12) components of shape (n, 3), the meridian's direction t^a is (n, 2).
    """
    mu = fibre.layer.shear_modulus
    psi_D = fibres.area_slope(D, stretch**2, fibre.layer)
    natural = np.reshape(fibre.natural, (-1, 1))
    second = 2 * (psi_D * D)[:, None] * _inverse(metric) + mu * _inverse(a_ref) / natural
    second *= np.reshape(fibre.stress_factor, (-1, 1))
    jacobian = np.sqrt(_determinant(metric) / _determinant(a_ref)) * stretch
    first = _lowered(metric, meridian)
    length = np.sqrt(np.sum(meridian * first, axis=1, keepdims=True))
    along = first / length
    # normal to the meridian in the metric g, counter-clockwise
    across = np.column_stack([-meridian[:, 1], meridian[:, 0]]) / length
    across *= np.sqrt(_determinant(metric))[:, None]
    parts = [
        second[:, 0] * p[:, 0] * q[:, 0]
        + second[:, 1] * p[:, 1] * q[:, 1]
        + second[:, 2] * (p[:, 0] * q[:, 1] + p[:, 1] * q[:, 0])
        for p, q in ((along, along), (across, across), (along, across))
    ]
    return np.stack(parts, axis=1) / jacobian[:, None]


def _determinant(metric: Array) -> Array:
    """Return the determinants of (11, 22, 12) components (n, 3), shape (n,)."""
    return metric[:, 0] * metric[:, 1] - metric[:, 2] ** 2


def _inverse(metric: Array) -> Array:
    """Return the inverses of (11, 22, 12) components (n, 3), in the same form."""
    adjoint = metric[:, [1, 0, 2]] * np.array([1.0, 1.0, -1.0])
    inverse: Array = adjoint / _determinant(metric)[:, None]
    return inverse


def _lowered(metric: Array, vectors: Array) -> Array:
    """Return the covariant components (n, 2) of contravariant vectors (n, 2)."""
    return np.column_stack(
        [
            metric[:, 0] * vectors[:, 0] + metric[:, 2] * vectors[:, 1],
            metric[:, 2] * vectors[:, 0] + metric[:, 1] * vectors[:, 1],
        ]
    )


def capture(shell: Shell, state: ShellState, t_n: float) -> Snapshot | None:
    """Gather a state on rank 0 (collective).

    Args:
        shell: A shell of degree 3.
        state: The state.
        t_n: Its normalised time; the shell must be set to it.

    Returns:
        The snapshot on rank 0, None elsewhere.
    """
    spaces = shell.spaces
    index_map = spaces.position.dofmap.index_map
    owned = index_map.size_local
    nodes = index_map.local_to_global(np.ascontiguousarray(spaces.nodes.ravel()))
    region = np.zeros(spaces.n_cells, dtype=np.int64)
    layers: dict[tuple[str, str], LayerFields] = {}
    faces: dict[str, Array] = {}
    for name in shell.sections:
        cells = shell.region_cells(name)
        region[cells] = shell.surface_mesh.regions[name]
        fields = layer_fields(shell, state, name)
        layers |= {(name, layer): value for layer, value in fields.items()}
        faces[name] = layer_faces(shell, state, name, fields)
    mine = _Part(
        _growth_at_nodes(shell, state),
        shell.reference[:owned],
        state.r[:owned],
        nodes.reshape(-1, len(NODES)),
        region,
        spaces.orientation,
        layers,
        faces,
    )
    gathered = shell.comm.gather(mine)
    return None if gathered is None else _joined(shell, gathered, t_n)


def gather_nodes(shell: Shell, values: Array) -> Array | None:
    """Return nodal values of all ranks in the order of a snapshot's nodes (collective).

    Args:
        shell: The shell.
        values: Shape (n_nodes, ...), local nodes.

    Returns:
        Shape (n_global_nodes, ...) on rank 0, None elsewhere.
    """
    owned = shell.spaces.position.dofmap.index_map.size_local
    parts = shell.comm.gather(values[:owned])
    return None if parts is None else np.concatenate(parts)


def _growth_at_nodes(shell: Shell, state: ShellState) -> dict[str, Array]:
    """Return e and rho of balanced layers at the nodes of all cells, NaN outside of the layers."""
    balance = shell.balance
    if balance is None:
        return {}
    geometry = layer_geometry(shell, state, list(balance.layers))
    to_nodes = _quadratic_fit(shell)
    nodal = {}
    for name, values in balance.fields(shell.t_n, geometry).items():
        cells = balance.layers[name.partition("_")[2]].sites.cells
        nodal[name] = np.full((shell.spaces.n_cells, len(to_nodes)), np.nan)
        nodal[name][cells] = values @ to_nodes.T
    return nodal


class _Part(NamedTuple):
    """What one rank knows of a snapshot; nodes by global number."""

    growth: dict[str, Array]
    reference: Array
    position: Array
    cells: NDArray[np.int64]
    region: NDArray[np.int64]
    orientation: Array
    layers: dict[tuple[str, str], LayerFields]
    faces: dict[str, Array]


def layer_heights(shell: Shell, state: ShellState) -> dict[str, Array]:
    """Return the heights of the layer faces over the mid-surface at the nodes of the cells.

    A face that lies at xi at rest lies at the integral of the layers' mean lambda_3 from 0 to xi.
    They are those of ``layer_fields``, without the stresses, which cost more.

    Args:
        shell: The shell, at the growth that ``state`` belongs to.
        state: The state.

    Returns:
        For each region, innermost face first, shape (n_cells, n_nodes, n_layers + 1).
    """
    forms, to_nodes = shell.forms_at_points(state), _quadratic_fit(shell).T
    heights = {}
    for region, section in shell.sections.items():
        cells, growth = shell.region_cells(region), shell.growth[region]
        means = closures.mean_stretches(
            shell.closure,
            section,
            growth,
            forms[cells].reshape(-1, 6),
            shell.a_ref[cells].reshape(-1, 3),
            shell.surface_mesh.surface.curvature,
        )
        shape = (len(cells), forms.shape[1])
        stretches = [means[layer.name].reshape(shape) @ to_nodes for layer in section.layers]
        at_rest = [np.broadcast_to(one.thickness, shape[0] * shape[1]) for one in growth]
        factors = [factor.reshape(shape) @ to_nodes for factor in at_rest]
        heights[region] = section.face_heights(stretches, factors)
    return heights


def heights_of(section: Section, fields: Mapping[str, LayerFields]) -> Array:
    """Return the heights of the layer faces over the mid-surface, from the layers' fields.

    Returns:
        Innermost face first, shape (..., n_layers + 1).
    """
    layers = [fields[layer.name] for layer in section.layers]
    return section.face_heights(
        [one.thickness_stretch for one in layers], [one.thickness for one in layers]
    )


def layer_faces(
    shell: Shell, state: ShellState, region: str, fields: dict[str, LayerFields]
) -> Array:
    """Return the places of the layer faces at the nodes of a region's cells.

    Args:
        shell: The shell, at the growth that ``state`` belongs to.
        state: The state.
        region: Name of a region.
        fields: Its layers' fields.

    Returns:
        Innermost face first, shape (n_cells, n_nodes, n_layers + 1, 3).
    """
    heights = heights_of(shell.sections[region], fields)
    spaces, cells = shell.spaces, shell.region_cells(region)
    nodes = spaces.nodes[cells]
    base = np.einsum("cqna,cni->cqai", spaces.gradient_operator(NODES)[cells], state.r[nodes])
    normal = np.cross(base[..., 0, :], base[..., 1, :])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return state.r[nodes][:, :, None, :] + heights[..., None] * normal[:, :, None, :]


def _joined(shell: Shell, parts: list[_Part], t_n: float) -> Snapshot:
    """Put the ranks' parts together."""
    region = np.concatenate([part.region for part in parts])
    regions = shell.surface_mesh.regions
    stretch: dict[str, Array] = {}
    stress: dict[str, Array] = {}
    for name, section in shell.sections.items():
        rows = np.flatnonzero(region == regions[name])
        for layer in (layer.name for layer in section.layers):
            pieces = [part.layers[name, layer] for part in parts]
            stretch.setdefault(layer, np.full((len(region), len(NODES)), np.nan))
            stress.setdefault(layer, np.full((len(region), len(NODES), 3), np.nan))
            stretch[layer][rows] = np.concatenate([piece.thickness_stretch for piece in pieces])
            stress[layer][rows] = np.concatenate([piece.stress for piece in pieces])
    return Snapshot(
        t_n=t_n,
        reference=np.concatenate([part.reference for part in parts]),
        position=np.concatenate([part.position for part in parts]),
        cells=np.concatenate([part.cells for part in parts]),
        region=region,
        orientation=np.concatenate([part.orientation for part in parts]),
        region_ids=dict(regions),
        layers={
            name: tuple(layer.name for layer in section.layers)
            for name, section in shell.sections.items()
        },
        thickness_stretch=stretch,
        stress=stress,
        faces={
            name: np.concatenate([part.faces[name] for part in parts]) for name in shell.sections
        },
        growth={
            name: np.concatenate([part.growth[name] for part in parts]) for name in parts[0].growth
        },
    )
