"""What contact does in a state: energy, forces, and how far it extends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import pdist

from opticcup_fem.contact.model import Contact
from opticcup_fem.shell.model import ShellState
from opticcup_fem.snapshot import Floats, Integers, Snapshot, subdivide

PUSHED = 0.01
"""A node touches where the force per reference area exceeds this share of the largest."""


@dataclass(frozen=True)
class ContactReport:
    """Contact of one state, on rank 0.

    Attributes:
        energy: Energy of the barrier over mu_IOV R^3.
        forces: Force on both faces at each node, shape (n, 3), unit mu_IOV R^2.
    """

    energy: float
    forces: Floats

    def traction(self, snapshot: Snapshot) -> Floats:
        """Return the force per reference area at the nodes, shape (n, 3), unit mu_IOV."""
        traction: Floats = self.forces / nodal_areas(snapshot, snapshot.reference)[:, None]
        return traction

    def columns(self, snapshot: Snapshot) -> dict[str, float]:
        """Return columns of path.csv.

        Returns:
            ``contact_energy``; ``contact_force``, the sum of the forces' magnitudes;
            ``touching_area_over_R2``, the current area of the mid-surface that is pushed;
            ``touching_length_over_R``, the extent of the longest patch of it.  Where two parts
            touch, the forces and areas of both count.
        """
        sizes = np.linalg.norm(self.traction(snapshot), axis=1)
        pushed = np.flatnonzero(sizes > PUSHED * sizes.max(initial=0.0))
        patches = _patches(pushed, snapshot.cells, len(sizes))
        extents = [pdist(snapshot.position[patch]).max(initial=0.0) for patch in patches]
        areas = nodal_areas(snapshot, snapshot.position)
        return {
            "contact_energy": self.energy,
            "contact_force": float(np.linalg.norm(self.forces, axis=1).sum()),
            "touching_area_over_R2": float(areas[pushed].sum()),
            "touching_length_over_R": float(max(extents, default=0.0)),
        }


def _patches(nodes: Integers, cells: Integers, n_nodes: int) -> list[Integers]:
    """Return the nodes in patches: nodes of one cell belong to one patch."""
    if len(nodes) == 0:
        return []
    member = np.isin(cells, nodes)
    rows, columns = np.nonzero(member)[0], cells[member]
    shape = (len(cells), n_nodes)
    touching = sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=shape)[:, nodes]
    count, label = connected_components(touching.T @ touching, directed=False)
    return [nodes[label == k] for k in range(count)]


def nodal_areas(snapshot: Snapshot, x: Floats) -> Floats:
    """Return the area around each node, shape (n,): their sum is that of the surface.

    Args:
        snapshot: Any state on the mesh.
        x: Positions of the nodes, reference or current, shape (n, 3).
    """
    cut = subdivide(snapshot.cells, 3, n_nodes=len(x))
    vertices = cut.matrix @ x
    a, b, c = (vertices[cut.triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    shares = np.bincount(cut.triangles.ravel(), np.repeat(area / 3, 3), minlength=len(vertices))
    summed: Floats = cut.matrix.T @ shares
    return summed


def contact_report(contact: Contact, state: ShellState) -> ContactReport | None:
    """Return the report on rank 0, None elsewhere (collective)."""
    energy, forces = contact.energy(state), contact.forces(state)
    n_nodes = len(contact.gather.to_root(state.r))
    together = np.zeros((n_nodes, 3)) if forces is None else forces.sum(axis=0)
    return ContactReport(energy, together) if contact.comm.rank == 0 else None
