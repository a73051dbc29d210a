"""How a surface run saves what its path depends on, and goes on from there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mpi4py import MPI

from opticcup_fem.case import Case
from opticcup_fem.checkpoint import Checkpoint, write_checkpoint
from opticcup_fem.equilibrium.branch import BranchState, BranchStepping
from opticcup_fem.equilibrium.path import PathPoint, SteppingState
from opticcup_fem.errors import CaseError, RecordError
from opticcup_fem.shell.cellwise import Cellwise
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.recovery import capture
from opticcup_fem.studies.contact import TouchWatch
from opticcup_fem.studies.model import Stepping
from opticcup_fem.studies.recorder import Recorder

Present = SteppingState | BranchState
"""All that a path beyond an accepted point depends on."""


class Restart:
    """Saves a run after its steps, and follows its path from where it was saved.

    Attributes:
        possible: Whether the run can be resumed.
    """

    def __init__(self, case: Case, folder: Path, shell: Shell, stepping: Stepping) -> None:
        """Take the parts of a run (collective)."""
        self._case, self._folder, self._shell, self._stepping = case, folder, shell, stepping
        self._cellwise = Cellwise(shell)
        self._saved: Present | None = None
        self.possible = True

    def follow(
        self, saved: Checkpoint | None, recorder: Recorder | None, watch: TouchWatch | None
    ) -> Iterator[PathPoint]:
        """Yield the points of the path, those behind the checkpoint if there is one (collective).

        Args:
            saved: The checkpoint, None for a run from its beginning.
            recorder: The records, on rank 0.
            watch: Looks for the first touch, if one is looked for.

        Raises:
            CaseError: The checkpoint belongs to another mesh.
        """
        shell, stepping, run = self._shell, self._stepping, self._case.run
        times = self._case.output.times
        resumed = None if saved is None else self._restored(saved)
        first = shell.reference_state() if resumed is None else resumed.point.state
        t_n = 0.0 if resumed is None else resumed.point.t_n
        shell.set_time(t_n)
        snapshot = capture(shell, first, t_n)
        if recorder is not None and snapshot is not None and self._cellwise.order is not None:
            recorder.order_cells(snapshot, self._cellwise.order)
            if resumed is not None:
                recorder.continue_from(snapshot)
        if resumed is not None and watch is not None:
            watch.begin(resumed.point, snapshot)
        if isinstance(stepping, BranchStepping):
            return stepping.follow(first, run.t_end, times, resumed=resumed)
        assert not isinstance(resumed, BranchState)
        return stepping.follow(first, run.t_end, times, resumed=resumed)

    def save(self, recorder: Recorder | None) -> None:
        """Write the checkpoint of the last point that the path can go on from (collective)."""
        present = self._stepping.present
        if not self.possible or present is None or present is self._saved:
            return
        self._saved = present
        states = tuple(self._cellwise.pack(state) for state in _states(present))
        balance = self._cellwise.pack_balance()
        if recorder is not None and recorder.failed is None:
            numbers = {**_numbers(present), "records": recorder.present()}
            numbers |= _balance_numbers(self._shell)
            case, corners = self._case.model_dump_json(), self._cellwise.corners
            with recorder.noting_failures():
                write_checkpoint(self._folder, Checkpoint(case, numbers, states, corners, balance))

    def _restored(self, saved: Checkpoint) -> Present:
        """Return what the path goes on from (collective)."""
        if not self._cellwise.fits(saved.corners):
            raise CaseError(
                f"{self._folder}: the case is meshed differently now (another version of Gmsh?), "
                "so its run cannot be resumed: run the case again"
            )
        numbers = saved.numbers
        if self._shell.balance is not None:
            known = numbers["balance"]
            self._cellwise.unpack_balance(dict(saved.balance), known["t_n"], known["steps"])
        states = [
            self._cellwise.unpack(dict(arrays), **contact)
            for arrays, contact in zip(saved.states, numbers["contact"], strict=True)
        ]
        if "arc" in numbers:
            state, along, *before = states
            return BranchState(
                PathPoint(state=state, **numbers["point"]),
                numbers["accepted"],
                state,
                along,
                before[0] if before else None,
                tuple(numbers["arc"]),
                tuple(numbers["arc_before"]) if before else None,
                numbers["count"],
            )
        return SteppingState(
            PathPoint(state=states[-1], **numbers["point"]),
            numbers["accepted"],
            numbers["dt"],
            tuple(zip(numbers["times"], states, strict=False)),
            numbers["blocked"],
            numbers["lost_by"],
        )


def _states(present: Present) -> list[ShellState]:
    """Return the states that a path depends on; on a stem the last one is its last point's."""
    if isinstance(present, BranchState):
        states = [present.state, present.along]
        return states if present.before is None else [*states, present.before]
    states = [state for _, state in present.states]
    last = present.point.state
    return states if states[-1] is last else [*states, last]


def _numbers(present: Present) -> dict[str, Any]:
    """Return the numbers that a path depends on, critical points of its last point excepted."""
    point = present.point
    names = ("t_n", "jump", "negative_eigenvalues", "iterations", "residual", "energy")
    numbers: dict[str, Any] = {
        "point": {name: getattr(point, name) for name in names},
        "accepted": present.accepted,
        "contact": [_contact_numbers(state) for state in _states(present)],
    }
    if isinstance(present, BranchState):
        arcs = {"arc": present.numbers, "arc_before": present.numbers_before}
        return {**numbers, **arcs, "count": present.count}
    times = [t_n for t_n, _ in present.states]
    limits = {"blocked": present.blocked, "lost_by": present.lost_by}
    return {**numbers, "dt": present.dt, "times": times, **limits}


def _contact_numbers(state: ShellState) -> dict[str, Any]:
    """Return the numbers of a state's contact data, {} where it has none."""
    data = state.contact
    return {} if data is None else {"time": data.time, "touches": data.touches}


def _balance_numbers(shell: Shell) -> dict[str, Any]:
    """Return the numbers of the mass balance that belong to ``Cellwise.pack_balance``."""
    balance = shell.balance
    if balance is None:
        return {}
    steps = []
    for by_layer in balance.past:
        one = next(iter(by_layer.values()))
        layers = {name: (step.total, step.error) for name, step in by_layer.items()}
        steps.append({"start": one.start, "end": one.end, "layers": layers})
    return {"balance": {"t_n": balance.t_n, "steps": steps}}


def require_written(
    comm: MPI.Comm, recorder: Recorder | None, folder: Path, point: PathPoint
) -> None:
    """Raise on every rank if the point could not be written on rank 0 (collective).

    Raises:
        RecordError: It could not.
    """
    failed = None if recorder is None else recorder.failed
    reason = comm.bcast(None if failed is None else failed.strerror or str(failed))
    if reason is not None:
        raise RecordError(
            f"{folder}: the state at t_n = {point.t_n:.6g} cannot be written ({reason}); what was "
            f"written before is kept: make room and go on with: opticcup run --resume {folder}"
        ) from failed
