r"""Contact of a shell on all ranks: geometry on rank 0, forces and stiffness on every rank.

Besides the positions r of its nodes a state carries what contact keeps fixed while it is solved
for: the heights of the faces and the time at which obstacles stand (``ContactData``).  Both are
brought up to date along ways that are free of collisions, and the state is solved again, until they
are those of the state itself (``equilibrium.newton``).  Where the normals point follows r exactly
(``faces``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeVar

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.compiled import root_first
from opticcup_fem.contact.blocks import Blocks
from opticcup_fem.contact.faces import FaceVariations, ShellFaces, face_heights
from opticcup_fem.contact.gather import NodeGather
from opticcup_fem.contact.obstacles import Obstacle
from opticcup_fem.contact.pairs import library
from opticcup_fem.contact.potential import ContactSettings, Placed, Potential
from opticcup_fem.errors import CaseError
from opticcup_fem.shell.model import ContactData, Shell, ShellState
from opticcup_fem.snapshot import NODES, Integers

Array = NDArray[np.float64]
T = TypeVar("T")

SAFE = 0.8
"""Share of the way to a collision that a step may go."""

KEEP = 0.5
"""Share of the gap that one move keeps: a barrier that is nearly closed is hard to open again."""

UP_TO_DATE = 0.02
"""Change of the heights, over the barrier's distance, that needs no further solve."""

MOST_CUTS = 20
"""Times that a way is shortened until it is free."""


class Contact:
    """Barrier between the parts of a shell, and between it and obstacles.

    Attributes:
        shell: The shell.
        settings: Barrier and collision mesh.
        has_obstacles: Whether there are any.
        gather: Numbers of all nodes.
        potential: The potential on rank 0, None elsewhere.
        faces: The shell's faces on rank 0, None elsewhere.
    """

    def __init__(
        self,
        shell: Shell,
        settings: ContactSettings,
        obstacles: Sequence[Obstacle] = (),
        mirrors: Sequence[int] = (),
    ) -> None:
        """Build the collision mesh on rank 0 (collective).

        Args:
            shell: The shell.
            settings: Barrier and collision mesh.
            obstacles: Rigid bodies.
            mirrors: Planes x_i = 0 that the deformation keeps as mirrors.

        Raises:
            CaseError: An obstacle overlaps the shell in its reference position.
            RuntimeError: The loops over pairs could not be compiled.
        """
        self.shell, self.settings = shell, settings
        self.comm, self.has_obstacles = shell.comm, len(obstacles) > 0
        self.gather = NodeGather(shell.spaces)
        self._placed: tuple[ShellState, Placed | None] | None = None
        self._pushed: tuple[ShellState, Array | None] | None = None
        root_first(self.comm, library)
        reference = self.gather.to_root(shell.reference)
        orientation = self.gather.cell_values(shell.spaces.orientation)
        gradient = self.gather.cell_values(shell.spaces.gradient_operator(NODES))
        self.potential: Potential | None = None
        self.faces: ShellFaces | None = None
        if self.comm.rank == 0:
            self.faces = ShellFaces(self.gather.cells, gradient, len(reference))
            self.potential = Potential(
                reference,
                self.gather.cells,
                orientation,
                shell.thickness,
                settings,
                obstacles,
                mirrors,
            )
        if obstacles:
            self._check_start()

    def _check_start(self) -> None:
        start = self.shell.reference_state()
        placed = self._place(self._present(start), start.r)
        fault = ""
        if self.potential is not None and placed is not None:
            half = self.shell.thickness / 2
            if self.potential.crosses(placed) or self.potential.holds_obstacle(half):
                fault = (
                    "an obstacle overlaps the shell at the start: move it away by at least half "
                    "the shell's thickness"
                )
            elif self.potential.gap(placed) < np.inf:
                reach = self.settings.distance
                fault = (
                    f"an obstacle is nearer to the shell at the start than the barrier reaches, "
                    f"{reach:.4g} (units of R): move it away or take a smaller contact.distance"
                )
        if fault := self.comm.bcast(fault):
            raise CaseError(fault)

    def _present(self, state: ShellState) -> ContactData:
        """Return faces and obstacles as they are in a state, touching or not (collective)."""
        return ContactData(face_heights(self.shell, state), self.shell.t_n, True)

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
        if self.potential is not None and start is not None and end is not None:
            clear = self.potential.passes(start, end)
        return goal if self.comm.bcast(clear) else None

    def _ask(self, state: ShellState, question: Callable[[Potential, Placed], T]) -> T | None:
        """Return an answer about a state on rank 0, None elsewhere (collective)."""
        placed = self._of(state)
        if self.potential is None or placed is None:
            return None
        return question(self.potential, placed)

    def _place(self, data: ContactData, r: Array) -> Placed | None:
        """Return where the faces are on rank 0, None elsewhere (collective)."""
        nodes, heights = self.gather.to_root(r), self.gather.cell_values(data.heights)
        if self.potential is None or self.faces is None:
            return None
        return self.potential.placed(self.faces.places(nodes, heights), data.time)

    def _of(self, state: ShellState) -> Placed | None:
        """Return the places of a state, those of the last one asked for at once (collective)."""
        if self._placed is None or self._placed[0] is not state:
            assert state.contact is not None
            self._placed = state, self._place(state.contact, state.r)
        return self._placed[1]

    def energy(self, state: ShellState) -> float:
        """Return the energy of the barrier (collective)."""
        return float(self.comm.bcast(self._ask(state, Potential.energy)))

    def forces(self, state: ShellState) -> Array | None:
        """Return -dE_c/dx of both faces at all nodes on rank 0 (collective).

        Returns:
            Shape (2, n_nodes, 3), the inner face first; None on other ranks and where nothing
            touches.
        """
        forces = self._forces_of_part(state)
        if forces is None or self.potential is None or self.faces is None:
            return None
        return self.potential.of_all(self.faces.at_nodes(forces))

    def _forces_of_part(self, state: ShellState) -> Array | None:
        """Return the forces in the energy of the part that stands for its images (collective).

        Shape (2, n_sites, 3), see ``forces``.
        """
        if self._pushed is None or self._pushed[0] is not state:
            slope = self._ask(state, Potential.gradient)
            self._pushed = state, None if slope is None else -slope
        return self._pushed[1]

    def gradient(self, state: ShellState) -> Array | None:
        """Return dE_c/dr at the rank's nodes, None where nothing touches (collective)."""
        forces, value = self._forces_of_part(state), None
        touched = None
        if forces is not None:
            touched = np.flatnonzero(_pushed_cells(forces))
        variations = self._variations(state, touched)
        if variations is not None and forces is not None and self.potential is not None:
            value = self.potential.of_all(-variations.pulled_back_forces(forces))
        return self.gather.from_root(value) if self.comm.bcast(value is not None) else None

    def hessian(self, state: ShellState, convex: bool = False) -> Blocks | None:
        """Return d2E_c/dr2 between cells on rank 0, none elsewhere (collective).

        With mirrors it is that of all images' energy in the positions of the part that stands for
        them: what is folded by the mirrors afterwards is the same.

        Args:
            state: The state.
            convex: Leave out what contact that turns or faces that turn have of negative
                stiffness: for descent, where the tangent must have none.

        Returns:
            None on every rank where nothing touches.
        """
        forces = self._forces_of_part(state)
        stiffness = self._ask(state, lambda potential, placed: potential.hessian(placed, convex))
        touched, value = None, None
        if forces is not None and stiffness is not None:
            pushed = _pushed_cells(forces)
            pushed[np.concatenate([stiffness.first, stiffness.second]) % len(pushed)] = True
            touched = np.flatnonzero(pushed)
        variations = self._variations(state, touched)
        if variations is not None and forces is not None and stiffness is not None:
            parts = [variations.pulled_back(stiffness)]
            if not convex:
                second = variations.second(forces)
                parts.append(second._replace(values=-second.values))
            value = Blocks.sum(parts)
            if self.potential is not None and self.potential.images > 1:
                value.values[:] *= self.potential.images
        touches = self.comm.bcast(value is not None)
        return (value or Blocks.none()) if touches else None

    def _variations(self, state: ShellState, touched: Integers | None) -> FaceVariations | None:
        """Return on rank 0 the variations of the faces of cells that touch (collective)."""
        assert state.contact is not None
        r, heights = self.gather.to_root(state.r), self.gather.cell_values(state.contact.heights)
        if self.faces is None or touched is None:
            return None
        return self.faces.at(r, heights, touched)

    def free_fraction(self, start: ShellState, end: ShellState, keep: float = 0.0) -> float:
        """Return the share of a way in r and contact data that is safe, 0 to 1 (collective).

        The faces' vertices go straight to where they are at the end of the way that remains.

        Args:
            start: State without a crossing.
            end: The other end of the way.
            keep: Share of the gap at the start, or of the barrier's distance, to be kept.
        """
        first, last = self._of(start), self._of(end)
        apart, share = 0.0, 1.0
        if self.potential is not None and first is not None and keep:
            apart = keep * self.potential.clearance(first)
        for _ in range(MOST_CUTS):
            free = 1.0
            if self.potential is not None and first is not None and last is not None:
                free = self.potential.free_fraction(first, last, apart)
            free = float(self.comm.bcast(free))
            if free >= 1.0:
                return share
            share *= SAFE * free
            last = self._of(between(start, end, share))
        return 0.0

    def gap(self, state: ShellState) -> float:
        """Return the least gap between faces, inf where it exceeds the barrier's (collective)."""
        return float(self.comm.bcast(self._ask(state, Potential.gap)))

    # --- ways to a state ----------------------------------------------------------------------

    def begin(self, start: ShellState) -> None:
        """Let what begins here depend on nothing before: resumed runs repeat it (collective)."""
        placed = self._of(start)
        if self.potential is not None and placed is not None:
            self.potential.begin(placed)

    def reachable(self, before: ShellState, guess: ShellState) -> tuple[ShellState, float]:
        """Return the farthest safe state on the way to a guess, and its share (collective).

        The faces move along with it, towards those of the guess if it is admissible, and obstacles
        towards where they stand at the present t_n.  The share 1 is the guess itself.
        """
        assert before.contact is not None
        self.begin(before)
        arrived = replace(before.contact, time=self.shell.t_n)
        if self.shell.evaluate(guess, tangent=False)[1] is None:
            arrived = self._present(guess)
        goal = replace(guess, contact=arrived)
        share = self.free_fraction(before, goal, KEEP)
        return (goal if share >= 1.0 else between(before, goal, share)), share

    def renewed(self, state: ShellState, lag: float = UP_TO_DATE) -> tuple[ShellState, bool]:
        """Bring heights and obstacles up to date (collective).

        Args:
            state: The state.
            lag: Change of the heights, over the barrier's distance, that is left as it is.

        Returns:
            The state with newer data, as new as is free of collisions, and whether it is as good
            as solved with them.
        """
        assert state.contact is not None
        data = self._present(state)
        change = np.max(np.abs(data.heights - state.contact.heights), initial=0.0)
        largest = self.comm.allreduce(float(change), MPI.MAX)
        if largest <= lag * self.settings.distance and data.time == state.contact.time:
            return self._with_touches(state), True
        goal = replace(state, contact=data)
        share = self.free_fraction(state, goal, KEEP)
        if share < 1.0:
            return between(state, goal, share), False
        touched = self.gap(state) < np.inf
        goal = self._with_touches(goal)
        assert goal.contact is not None
        return goal, not (touched or goal.contact.touches)


def _pushed_cells(forces: Array) -> NDArray[np.bool_]:
    """Return which cells have a force, (2, n_sites, 3), on one of their faces, shape (m,)."""
    return np.any(forces.reshape(2, -1, 3 * len(NODES)) != 0, axis=(0, 2))


def between(start: ShellState, end: ShellState, share: float) -> ShellState:
    """Return the state on the straight way between two, contact data included."""
    first, last = start.contact, end.contact
    assert first is not None and last is not None
    heights = (1 - share) * first.heights + share * last.heights
    data = ContactData(heights, (1 - share) * first.time + share * last.time, True)
    return replace(start.plus(end.minus(start), share), contact=data)
