"""How a run is stopped without loss, and what it left to go on from."""

from __future__ import annotations

import json
import signal
import threading
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Self

from mpi4py import MPI

from opticcup_fem.case import Case, parse_case
from opticcup_fem.checkpoint import CHECKPOINT, Checkpoint, read_checkpoint
from opticcup_fem.errors import CaseError
from opticcup_fem.studies.outcome import on_root


def checkpoint_of(case: Case, folder: Path, comm: MPI.Comm) -> Checkpoint:
    """Return the checkpoint of a case's interrupted run on every rank (collective).

    Raises:
        CaseError: There is none that can be used for this case.
    """

    def read() -> Checkpoint:
        saved = read_checkpoint(folder)
        if parse_case(json.loads(saved.case), f"{folder / CHECKPOINT}") != case:
            raise CaseError(
                f"{folder} holds the run of another case: resume it without a case, or run this "
                "case in another folder"
            )
        return saved

    found: Checkpoint = comm.bcast(on_root(comm, read))
    return found


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
