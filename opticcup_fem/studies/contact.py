"""From a case's contact table to contact, and the first touch of a shell with itself."""

from __future__ import annotations

from typing import Any

from opticcup_fem.case import Case
from opticcup_fem.case.tables import ObstacleTable
from opticcup_fem.contact.model import Contact
from opticcup_fem.contact.obstacles import Box, Obstacle, Plate, Sphere
from opticcup_fem.contact.potential import EXEMPT, ContactSettings
from opticcup_fem.contact.touch import Nearest, TouchMeter
from opticcup_fem.equilibrium.branch import BranchStepping
from opticcup_fem.equilibrium.path import LoadStepping, PathPoint
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.recovery import capture
from opticcup_fem.snapshot import Snapshot

CLOSE_ENOUGH = 0.01
"""A touch is localised once the least gap, over h, is this near to zero."""

MOST_SOLVES = 6
"""States that are solved for at most to localise a touch."""


def obstacle_of(table: ObstacleTable) -> Obstacle:
    """Return the body that a table describes."""
    if table.kind == "plate":
        return Plate(table.centre, table.normal, table.width, velocity=table.velocity)
    if table.kind == "box":
        return Box(table.centre, table.sides, velocity=table.velocity)
    return Sphere(table.centre, table.radius, velocity=table.velocity)


def mirrors_of(case: Case) -> tuple[int, ...]:
    """Return the components of position that are nought on a mirror which a case keeps."""
    return (0, 1) if case.run.keep_mirrors else ()


def contact_of(case: Case, shell: Shell) -> Contact | None:
    """Return the contact that a case resists, None where it resists none (collective).

    Raises:
        CaseError: An obstacle overlaps the shell at the start.
    """
    table = case.contact
    if table.mode != "resist":
        return None
    distance = table.distance * case.shape.thickness
    settings = ContactSettings(distance, table.stiffness, table.subdivision)
    obstacles = [obstacle_of(one) for one in table.obstacles]
    return Contact(shell, settings, obstacles, mirrors_of(case))


class TouchWatch:
    """Measures the gap of every state and localises the first touch, thickness counted.

    Faces touch where their gap is zero or, where contact is resisted, where the barrier begins.

    Attributes:
        nearest: The nearest parts of the last state, on rank 0; None where none is near.
    """

    def __init__(
        self,
        case: Case,
        shell: Shell,
        stepping: LoadStepping | BranchStepping,
        *,
        touched: bool = False,
    ) -> None:
        """Watch a path.

        Args:
            case: The case.
            shell: Its shell.
            stepping: What follows the path.
            touched: Whether the first touch has been seen already.
        """
        self._shell, self._stepping, self._h = shell, stepping, case.shape.thickness
        self._alpha = case.shape.opening_angle
        self._reach = case.contact.distance if case.contact.mode == "resist" else 0.0
        self._meter: TouchMeter | None = None
        self._last: PathPoint | None = None
        self._gap: float | None = None
        self._touched = touched
        self.nearest: Nearest | None = None

    def measure(self, snapshot: Snapshot) -> Nearest | None:
        """Return the nearest parts of a state (rank 0)."""
        if self._meter is None:
            self._meter = TouchMeter(snapshot, EXEMPT * self._h)
        return self._meter(snapshot)

    def begin(self, point: PathPoint, snapshot: Snapshot | None) -> None:
        """Take a state behind which the path goes on (collective).

        Args:
            point: The state.
            snapshot: The same on rank 0.
        """
        if snapshot is not None:
            self.nearest = self.measure(snapshot)
        self._last, self._gap = point, self._on_root(self.nearest)

    def see(self, point: PathPoint, snapshot: Snapshot | None) -> dict[str, Any] | None:
        """Look at an accepted state (collective).

        Args:
            point: The state, the next one on the path.
            snapshot: The same on rank 0.

        Returns:
            On every rank fields of the first touch, ``t_n`` among them, when it has happened.
        """
        low, low_gap = self._last, self._gap
        self.begin(point, snapshot)
        if self._gap is None or self._gap > 0 or self._touched:
            return None
        self._touched = True
        return self._localised(low, low_gap, point, self._gap)

    def _on_root(self, nearest: Nearest | None) -> float | None:
        """Return on every rank the gap over h, less where touch begins, that rank 0 knows."""
        gap = None if nearest is None else nearest.gap / self._h - self._reach
        return self._shell.comm.bcast(gap)

    def _localised(
        self, low: PathPoint | None, low_gap: float | None, point: PathPoint, gap: float
    ) -> dict[str, Any]:
        """Return the fields of the touch between two states and their gaps (collective)."""
        high, found = point, self.nearest
        if low is not None and not high.jump and isinstance(self._stepping, LoadStepping):
            for _ in range(MOST_SOLVES):
                if abs(gap) < CLOSE_ENOUGH:
                    break
                share = 0.5 if low_gap is None else min(max(low_gap / (low_gap - gap), 0.1), 0.9)
                t_n = low.t_n + share * (high.t_n - low.t_n)
                middle = self._stepping.between(low, high, t_n)
                if middle is None:
                    break
                snapshot = capture(self._shell, middle.state, t_n)
                nearest = None if snapshot is None else self.measure(snapshot)
                middle_gap = self._on_root(nearest)
                if middle_gap is None or middle_gap > 0:
                    low, low_gap = middle, middle_gap
                else:
                    high, gap, found = middle, middle_gap, nearest
        self._shell.set_time(point.t_n)
        start = high.t_n if low is None else low.t_n
        t_n = high.t_n
        if low_gap is not None and not high.jump:
            t_n = start + low_gap / (low_gap - gap) * (high.t_n - start)
        fields: dict[str, Any] = {"t_n": t_n, "t_n_range": [start, high.t_n]}
        if found is not None:
            fields |= found.describe(self._alpha)
        return fields
