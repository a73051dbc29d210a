"""How a surface run is stopped without loss, and goes on."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Self

from mpi4py import MPI

from opticcup_fem.case import Case
from opticcup_fem.checkpoint import Checkpoint, read_checkpoint, write_checkpoint
from opticcup_fem.equilibrium.path import LoadStepping, PathPoint, SteppingState
from opticcup_fem.errors import CaseError, RecordError
from opticcup_fem.shell.cellwise import Cellwise
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.recovery import capture
from opticcup_fem.studies.model import Stepping
from opticcup_fem.studies.outcome import on_root
from opticcup_fem.studies.recorder import Recorder


def resumable(case: Case) -> bool:
    """Return whether a checkpoint holds all that a run depends on.

    Contact that is resisted has data of its own, and other paths than the stable one a history.
    """
    return case.run.follow == "stable" and case.contact.mode != "resist"


def read_for(case: Case, folder: Path, comm: MPI.Comm) -> Checkpoint:
    """Return the checkpoint of a case's run on every rank (collective).

    Raises:
        CaseError: There is none that can be used for this case.
    """

    def read() -> Checkpoint:
        if not resumable(case):
            raise CaseError(
                f'{folder}: a run with run.follow = "{case.run.follow}" and contact.mode = '
                f'"{case.contact.mode}" cannot be resumed: run its case again'
            )
        saved = read_checkpoint(folder)
        if saved.case != case.model_dump_json():
            raise CaseError(
                f"{folder} holds the run of another case: resume it without a case, or run this "
                "case in another folder"
            )
        return saved

    found: Checkpoint = comm.bcast(on_root(comm, read))
    return found


class Restart:
    """Saves a run after its steps, and follows its path from where it was saved.

    Attributes:
        possible: Whether the run can be resumed.
    """

    def __init__(self, case: Case, folder: Path, shell: Shell, stepping: Stepping) -> None:
        """Take the parts of a run (collective)."""
        self._case, self._folder, self._shell, self._stepping = case, folder, shell, stepping
        self._cellwise = Cellwise(shell)
        self.possible = resumable(case)

    def follow(self, saved: Checkpoint | None, recorder: Recorder | None) -> Iterator[PathPoint]:
        """Yield the points of the path, those behind the checkpoint if there is one (collective).

        Args:
            saved: The checkpoint, None for a run from its beginning.
            recorder: The records, on rank 0.

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
        if resumed is None:
            return stepping.follow(first, run.t_end, times)
        assert isinstance(stepping, LoadStepping)
        return stepping.follow(first, run.t_end, times, resumed=resumed)

    def save(self, recorder: Recorder | None) -> None:
        """Write the checkpoint of the last point (collective)."""
        if not self.possible or not isinstance(self._stepping, LoadStepping):
            return
        present = self._stepping.present
        assert present is not None
        states = tuple(self._cellwise.pack(state) for _, state in present.states)
        balance = self._cellwise.pack_balance()
        if recorder is not None and recorder.failed is None:
            numbers = {**_numbers(present), "records": recorder.present()}
            numbers |= _balance_numbers(self._shell)
            case, corners = self._case.model_dump_json(), self._cellwise.corners
            with recorder.noting_failures():
                write_checkpoint(self._folder, Checkpoint(case, numbers, states, corners, balance))

    def _restored(self, saved: Checkpoint) -> SteppingState:
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
        states = [self._cellwise.unpack(dict(arrays)) for arrays in saved.states]
        point = PathPoint(state=states[-1], **numbers["point"])
        return SteppingState(
            point,
            numbers["accepted"],
            numbers["dt"],
            tuple(zip(numbers["times"], states, strict=True)),
            numbers["blocked"],
        )


def _numbers(present: SteppingState) -> dict[str, Any]:
    """Return the numbers of a state of the stepping, its critical points excepted."""
    point = present.point
    names = ("t_n", "jump", "negative_eigenvalues", "iterations", "residual", "energy")
    return {
        "point": {name: getattr(point, name) for name in names},
        "accepted": present.accepted,
        "dt": present.dt,
        "times": [t_n for t_n, _ in present.states],
        "blocked": present.blocked,
    }


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


class StopSignals:
    """Notes SIGINT and SIGTERM instead of stopping at once; the second one stops at once."""

    def __init__(self, comm: MPI.Comm) -> None:
        """Take the ranks that stop together."""
        self._comm, self._mine = comm, 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Self:
        """Begin to note."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._note)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Let signals do what they did before."""
        self._restore()

    def received(self) -> int:
        """Return the signal that any rank has received, 0 for none (collective)."""
        number: int = self._comm.allreduce(self._mine, op=MPI.MAX)
        return number

    def _note(self, number: int, frame: FrameType | None) -> None:
        self._mine = number
        self._restore()

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before = {}
