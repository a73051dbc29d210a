"""Supports: which unknowns of the shell are held.

A support is a function of the shell that returns a mask over the rank's local unknowns: 3 per
node, then k per edge.  Masks combine with ``|``; a new kind of support is a new function.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from dolfinx import la
from numpy.typing import NDArray
from scipy.linalg import qr

from opticcup_fem.errors import MeshError
from opticcup_fem.shell.curves import curve_edges
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.spaces import EDGE_VERTICES

Mask = NDArray[np.bool_]


def free(shell: Shell) -> Mask:
    """Return the mask of a shell that nothing holds."""
    spaces = shell.spaces
    return np.zeros(3 * spaces.n_nodes + spaces.degree * spaces.n_edges, dtype=bool)


def hinged(shell: Shell, curve: str) -> Mask:
    """Hold the position of the nodes on a curve; the shell may turn about it."""
    mask = free(shell)
    nodes, _ = _on_curve(shell, curve)
    positions = mask[: 3 * shell.spaces.n_nodes].reshape(-1, 3)
    positions[nodes] = True
    return mask


def clamped(shell: Shell, curve: str) -> Mask:
    """Hold position and director on a curve."""
    mask = hinged(shell, curve)
    _, edges = _on_curve(shell, curve)
    angles = mask[3 * shell.spaces.n_nodes :].reshape(-1, shell.spaces.degree)
    angles[edges] = True
    return mask


def held_components(shell: Shell, held: list[tuple[tuple[float, float, float], str]]) -> Mask:
    """Hold components of the nodes nearest to given places, without reactions if they suffice.

    Args:
        shell: The shell.
        held: Pairs of a reference place and the components to hold there, such as "xyz" or "y".
    """
    mask = free(shell)
    positions = mask[: 3 * shell.spaces.n_nodes].reshape(-1, 3)
    for place, components in held:
        node = _nearest_node(shell, np.array(place))
        for component in components:
            positions[node, "xyz".index(component)] = True
    return mask


def rigid_modes_of_cup(shell: Shell) -> Mask:
    """Hold the six rigid motions of a free-floating cup, with no reaction in its equilibrium.

    The bottom pole is held, the apex may move along the axis only, and the interface's point at
    phi = 0 may not turn about the axis.  An axisymmetric deformation meets all six by itself.
    """
    radius = 1 / abs(shell.surface_mesh.surface.curvature)
    side = _interface_point(shell)
    return held_components(
        shell,
        [((0.0, 0.0, -radius), "xyz"), ((0.0, 0.0, radius), "xy"), (side, "y")],
    )


def rigid_modes(shell: Shell) -> Mask:
    """Hold the six rigid motions of any shell that floats freely, with no reaction (collective).

    Six components of nodes far apart, those that a pivoted QR factorisation of the rigid motions
    chooses: no motion is held by a short lever.
    """
    owned = shell.spaces.position.dofmap.index_map.size_local
    parts = shell.comm.gather(shell.reference[:owned])
    held: list[tuple[tuple[float, float, float], str]] | None = None
    if parts is not None:
        # sorted, so that the choice does not depend on the ranks
        places = np.concatenate(parts)
        places = places[np.lexsort(np.round(places, 9).T)]
        arms = places - places.mean(axis=0)
        turns = [np.cross(axis, arms) for axis in np.eye(3)]
        shifts = [np.broadcast_to(axis, arms.shape) for axis in np.eye(3)]
        motions = np.stack([*shifts, *turns]).reshape(6, -1)
        pivots = qr(motions, mode="r", pivoting=True)[1][:6]
        held = [(tuple(places[one // 3].tolist()), "xyz"[one % 3]) for one in pivots]
    return held_components(shell, shell.comm.bcast(held))


def _interface_point(shell: Shell) -> tuple[float, float, float]:
    """Return the place of the interface's point at phi = 0."""
    nodes, _ = _on_curve(shell, "interface")
    heights = shell.reference[nodes, 2]
    every = [h for part in shell.comm.allgather(heights[:1].tolist()) for h in part]
    height = every[0]
    radius = 1 / abs(shell.surface_mesh.surface.curvature)
    return (float(np.sqrt(radius**2 - height**2)), 0.0, float(height))


def _nearest_node(shell: Shell, place: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the local copies (one or none) of the node that lies at ``place``.

    Raises:
        MeshError: No node of the mesh lies there.
    """
    distance = np.linalg.norm(shell.reference - place, axis=1)
    nearest = shell.comm.allreduce(np.min(distance, initial=np.inf), MPI.MIN)
    if nearest > 1e-8:
        where = ", ".join(f"{value:.6g}" for value in place)
        raise MeshError(
            f"no node lies at ({where}), where rigid motions are held (the nearest is "
            f"{nearest:.2g} away); mesh the shell with a vertex there."
        )
    return np.flatnonzero(distance < 1e-8)


def _on_curve(shell: Shell, curve: str) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Return the local nodes and edges of a named curve (collective).

    Raises:
        MeshError: The mesh has no such curve.
    """
    edges = curve_edges(shell.surface_mesh, curve)
    spaces = shell.spaces
    on_edge = np.isin(spaces.edges, edges)
    k = spaces.degree
    per_edge = k - 1
    marked = la.vector(spaces.position.dofmap.index_map)
    for local, (low, high) in enumerate(EDGE_VERTICES):
        cells = np.flatnonzero(on_edge[:, local])
        interior = 3 + local * per_edge + np.arange(per_edge)
        marked.array[spaces.nodes[np.ix_(cells, [low, high, *interior])]] = 1.0
    # a rank may hold an end of the curve without holding any of its edges
    marked.scatter_reverse(la.InsertMode.add)
    marked.scatter_forward()
    return np.flatnonzero(marked.array > 0), edges
