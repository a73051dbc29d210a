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
from dataclasses import dataclass, replace

from mpi4py import MPI

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

KEEP = 0.5
"""Share of the gap that is kept when obstacles and faces are moved: a barrier that is nearly closed
is hard to open again."""

UP_TO_DATE = 0.02
"""Change of the faces, over the barrier's distance, that needs no further solve."""


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
    """Barrier between the parts of a shell, and between it and obstacles.

    Attributes:
        shell: The shell.
        settings: Barrier and collision mesh.
        has_obstacles: Whether there are any.
        gather: Numbers of all nodes.
        barrier: The barrier on rank 0, None elsewhere.
    """

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
        self.comm, self.has_obstacles = shell.comm, len(obstacles) > 0
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
        start = self.shell.reference_state()
        vertices = self._vertices(self._present(start), start.r)
        fault = ""
        if self.barrier is not None:
            half = self.shell.thickness / 2
            if self.barrier.crosses(vertices) or self.barrier.surface.holds_obstacle(half):
                fault = (
                    "an obstacle overlaps the shell at the start: move it away by at least half "
                    "the shell's thickness"
                )
            elif self.barrier.gap(vertices) < np.inf:
                reach = self.settings.distance
                fault = (
                    f"an obstacle is nearer to the shell at the start than the barrier reaches, "
                    f"{reach:.4g} (units of R): move it away or take a smaller contact.distance"
                )
        if fault := self.comm.bcast(fault):
            raise CaseError(fault)

    def _present(self, state: ShellState) -> ContactData:
        """Return faces and obstacles as they are in a state, touching or not (collective)."""
        everywhere = face_offsets(self.shell, state, self.gather)
        return ContactData(self.gather.from_root(everywhere), self.shell.t_n, True)

    def brought_up_to_date(self, state: ShellState) -> ShellState:
        """Return a state with faces and obstacles as they are at the present t_n (collective)."""
        present = replace(state, contact=self._present(state))
        return self._with_touches(present)

    def _with_touches(self, state: ShellState) -> ShellState:
        assert state.contact is not None
        touches = self.gap(state) < np.inf
        return replace(state, contact=replace(state.contact, touches=touches))

    def passes(self, before: ShellState, after: ShellState) -> ShellState | None:
        """Return ``after``, up to date, if nothing touches all the way there (collective).

        Args:
            before: A state in which nothing touches.
            after: The other end of the way.
        """
        goal = replace(after, contact=replace(self._present(after), touches=False))
        start, end = self._of(before), self._of(goal)
        clear = True
        if self.barrier is not None:
            clear = self.barrier.free_fraction(start, end, self.barrier.distance) >= 1.0
        return goal if self.comm.bcast(clear) else None

    def _vertices(self, data: ContactData, r: Array) -> Array:
        """Return the places of all vertices on rank 0, nothing elsewhere (collective)."""
        nodes, offsets = self.gather.to_root(r), self.gather.to_root(data.offsets)
        if self.barrier is None:
            return nodes
        return self.barrier.surface.vertices(nodes, offsets, data.time)

    def _of(self, state: ShellState) -> Array:
        assert state.contact is not None
        return self._vertices(state.contact, state.r)

    def energy(self, state: ShellState) -> float:
        """Return the energy of the barrier (collective)."""
        vertices = self._of(state)
        return float(self.comm.bcast(self.barrier.energy(vertices) if self.barrier else 0.0))

    def gradient(self, state: ShellState) -> Array | None:
        """Return dE_c/dr at the rank's nodes, None where nothing touches (collective)."""
        vertices = self._of(state)
        value = self.barrier.gradient(vertices) if self.barrier else None
        return self.gather.from_root(value) if self.comm.bcast(value is not None) else None

    def hessian(self, state: ShellState) -> sparse.csr_array | None:
        """Return d2E_c/dr2 in all nodes on every rank, None where nothing touches (collective)."""
        vertices = self._of(state)
        return self.comm.bcast(self.barrier.hessian(vertices) if self.barrier else None)

    def free_fraction(self, start: ShellState, end: ShellState, keep: float = 0.0) -> float:
        """Return the share of a way in r and contact data that is safe, 0 to 1 (collective).

        Args:
            start: State without a crossing.
            end: The other end of the way.
            keep: Share of the gap at the start, or of the barrier's distance, to be kept.
        """
        first, last = self._of(start), self._of(end)
        free = 1.0
        if self.barrier is not None:
            apart = keep * min(self.barrier.gap(first), self.barrier.distance) if keep else 0.0
            free = self.barrier.free_fraction(first, last, apart)
        free = float(self.comm.bcast(free))
        return 1.0 if free >= 1.0 else SAFE * free

    def gap(self, state: ShellState) -> float:
        """Return the least gap between faces, inf where it exceeds the barrier's (collective)."""
        vertices = self._of(state)
        return float(self.comm.bcast(self.barrier.gap(vertices) if self.barrier else np.inf))

    # --- ways to a state ----------------------------------------------------------------------

    def reachable(self, before: ShellState, guess: ShellState) -> tuple[ShellState, float]:
        """Return the farthest safe state on the way to a guess, and its share (collective).

        The faces move along with it, towards those of the guess if it is admissible, and obstacles
        towards where they stand at the present t_n.  The share 1 is the guess itself.
        """
        assert before.contact is not None
        arrived = replace(before.contact, time=self.shell.t_n)
        if self.shell.evaluate(guess, tangent=False)[1] is None:
            arrived = self._present(guess)
        goal = replace(guess, contact=arrived)
        share = self.free_fraction(before, goal, KEEP)
        if share >= 1.0:
            return goal, 1.0
        between = before.plus(guess.minus(before), share)
        return replace(between, contact=_between(before.contact, arrived, share)), share

    def renewed(self, state: ShellState) -> tuple[ShellState, bool]:
        """Bring faces and obstacles up to date (collective).

        Returns:
            The state with newer data, as new as is free of collisions, and whether it is as good
            as solved with them.
        """
        assert state.contact is not None
        data = self._present(state)
        goal = replace(state, contact=data)
        share = self.free_fraction(state, goal, KEEP)
        if share < 1.0:
            return replace(state, contact=_between(state.contact, data, share)), False
        change = float(np.max(np.linalg.norm(data.offsets - state.contact.offsets, axis=2)))
        largest = self.comm.allreduce(change, MPI.MAX)
        still = largest <= UP_TO_DATE * self.settings.distance and data.time == state.contact.time
        if still:
            return self._with_touches(state), True
        touched = self.gap(state) < np.inf
        goal = self._with_touches(goal)
        assert goal.contact is not None
        return goal, not (touched or goal.contact.touches)


def _between(start: ContactData, end: ContactData, share: float) -> ContactData:
    offsets = (1 - share) * start.offsets + share * end.offsets
    return ContactData(offsets, (1 - share) * start.time + share * end.time, True)
