r"""Contact of a shell on all ranks: geometry on rank 0, forces and stiffness on every rank.

Besides the positions r of its nodes a state carries what contact keeps fixed while it is solved
for: the vectors from the nodes to the faces and the time at which obstacles stand
(``ContactData``).  Both are brought up to date along ways that are free of collisions, and the
state is solved again, until they are those of the state itself (``equilibrium.newton``).
Frictionless contact pushes along the normal, so that the lever of a face makes no moment and the
force may act on the mid-surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from opticcup_fem.contact.barrier import Barrier
from opticcup_fem.contact.faces import face_offsets
from opticcup_fem.contact.gather import NodeGather
from opticcup_fem.contact.obstacles import Obstacle
from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.errors import CaseError
from opticcup_fem.shell.model import ContactData, Shell, ShellState

Array = NDArray[np.float64]

EXEMPT = 1.5
"""Parts nearer than this many thicknesses in the reference surface cannot touch."""

SAFE = 0.8
"""Share of the way to a collision that a step may go."""


@dataclass(frozen=True)
class ContactSettings:
    """How contact is resisted.

    Attributes:
        distance: Gap at which the barrier begins, unit of length of the mesh.
        stiffness: Stress scale of the barrier.
        parts: Parts of each cell's edge in the collision mesh.
    """

    distance: float
    stiffness: float
    parts: int = 3


class Contact:
    """Barrier between the parts of a shell, and between it and obstacles."""

    def __init__(
        self, shell: Shell, settings: ContactSettings, obstacles: Sequence[Obstacle] = ()
    ) -> None:
        """Build the collision mesh on rank 0 (collective).

        Args:
            shell: The shell.
            settings: Barrier and collision mesh.
            obstacles: Rigid bodies.

        Raises:
            CaseError: An obstacle overlaps the shell in its reference position.
        """
        self.shell, self.settings = shell, settings
        self.comm = shell.comm
        self.gather = NodeGather(shell.spaces)
        reference = self.gather.to_root(shell.reference)
        orientation = self.gather.cell_values(shell.spaces.orientation)
        self.barrier: Barrier | None = None
        if self.comm.rank == 0:
            surface = ContactSurface(
                reference,
                self.gather.cells,
                orientation,
                EXEMPT * shell.thickness,
                settings.parts,
                obstacles,
            )
            self.barrier = Barrier(surface, settings.distance, settings.stiffness)
        self._check_start()

    def _check_start(self) -> None:
        vertices = self._vertices(self.data_of(self.shell.reference_state()), self.shell.reference)
        crosses = False
        if self.barrier is not None and vertices is not None:
            crosses = self.barrier.crosses(vertices) or self.barrier.gap(vertices) == 0.0
        if self.comm.bcast(crosses):
            raise CaseError(
                "an obstacle overlaps the shell at the start: move it away by at least half the "
                "shell's thickness"
            )

    def data_of(self, state: ShellState) -> ContactData:
        """Return faces and obstacles as they are in a state at the present t_n (collective)."""
        everywhere = face_offsets(self.shell, state, self.gather)
        return ContactData(self.gather.from_root(everywhere), self.shell.t_n)

    def _vertices(self, data: ContactData, r: Array) -> Array | None:
        """Return the places of all vertices on rank 0 (collective)."""
        nodes, offsets = self.gather.to_root(r), self.gather.to_root(data.offsets)
        if self.barrier is None:
            return None
        return self.barrier.surface.vertices(nodes, offsets, data.time)

    def _of(self, state: ShellState) -> Array | None:
        assert state.contact is not None
        return self._vertices(state.contact, state.r)

    def energy(self, state: ShellState) -> float:
        """Return the energy of the barrier (collective)."""
        vertices = self._of(state)
        value = 0.0
        if self.barrier is not None and vertices is not None:
            value = self.barrier.energy(vertices)
        return float(self.comm.bcast(value))

    def gradient(self, state: ShellState) -> Array | None:
        """Return dE_c/dr at the rank's nodes, None where nothing touches (collective)."""
        vertices = self._of(state)
        value = None
        if self.barrier is not None and vertices is not None:
            value = self.barrier.gradient(vertices)
        touches = self.comm.bcast(value is not None)
        return self.gather.from_root(value) if touches else None

    def hessian(self, state: ShellState) -> sparse.csr_array | None:
        """Return d2E_c/dr2 in all nodes on every rank, None where nothing touches (collective)."""
        vertices = self._of(state)
        value = None
        if self.barrier is not None and vertices is not None:
            value = self.barrier.hessian(vertices)
        return self.comm.bcast(value)

    def free_fraction(self, start: ShellState, end: ShellState) -> float:
        """Return the share of a step in r and contact data that is safe, 0 to 1 (collective)."""
        first, last = self._of(start), self._of(end)
        free = 1.0
        if self.barrier is not None and first is not None and last is not None:
            free = self.barrier.free_fraction(first, last)
        free = float(self.comm.bcast(free))
        return 1.0 if free >= 1.0 else SAFE * free

    def gap(self, state: ShellState) -> float:
        """Return the least gap between faces, inf where it exceeds the barrier's (collective)."""
        vertices = self._of(state)
        gap = np.inf
        if self.barrier is not None and vertices is not None:
            gap = self.barrier.gap(vertices)
        return float(self.comm.bcast(gap))
