"""What contact does in a state: energy, forces, and how far it extends."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from opticcup_fem.contact.model import Contact
from opticcup_fem.shell.model import ShellState
from opticcup_fem.snapshot import Floats, Snapshot, subdivide


@dataclass(frozen=True)
class ContactReport:
    """Contact of one state, on rank 0.

    Attributes:
        energy: Energy of the barrier over mu_IOV R^3.
        forces: Force on each node, shape (n, 3), unit mu_IOV R^2.
    """

    energy: float
    forces: Floats

    def traction(self, snapshot: Snapshot) -> Floats:
        """Return the force per reference area at the nodes, shape (n, 3), unit mu_IOV."""
        traction: Floats = self.forces / nodal_areas(snapshot)[:, None]
        return traction

    def columns(self, snapshot: Snapshot) -> dict[str, float]:
        """Return columns of path.csv.

        Returns:
            ``contact_energy``; ``contact_force``, the sum of the forces' magnitudes, each part's
            counted; ``touching_length_over_R``, the largest distance of two nodes that are pushed.
        """
        sizes = np.linalg.norm(self.forces, axis=1)
        pushed = snapshot.position[sizes > 1e-6 * sizes.max(initial=1e-300)]
        length = 0.0
        if len(pushed):
            length = float(max(np.linalg.norm(pushed - x, axis=1).max() for x in pushed))
        return {
            "contact_energy": self.energy,
            "contact_force": float(sizes.sum()),
            "touching_length_over_R": length,
        }


def nodal_areas(snapshot: Snapshot) -> Floats:
    """Return the reference area around each node, shape (n,): their sum is that of the surface."""
    cut = subdivide(snapshot.cells, 3, n_nodes=len(snapshot.reference))
    x = cut.matrix @ snapshot.reference
    a, b, c = (x[cut.triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    shares = np.bincount(cut.triangles.ravel(), np.repeat(area / 3, 3), minlength=len(x))
    summed: Floats = cut.matrix.T @ shares
    return summed


def contact_report(contact: Contact, state: ShellState) -> ContactReport | None:
    """Return the report on rank 0, None elsewhere (collective)."""
    energy, gradient = contact.energy(state), contact.gradient(state)
    forces = contact.gather.to_root(-gradient if gradient is not None else np.zeros_like(state.r))
    return ContactReport(energy, forces) if contact.comm.rank == 0 else None
