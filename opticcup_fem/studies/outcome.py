"""What a study hands back, and how ranks agree on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from mpi4py import MPI

from opticcup_fem.errors import OpticCupError, RecordError
from opticcup_fem.events import Event

T = TypeVar("T")


@dataclass(frozen=True)
class RunSummary:
    """Outcome of a run, the same on every rank.

    Attributes:
        ok: Whether it ended as a run should: at run.t_end, or in a contact of the shell with
            itself, which is reported and not resisted.
        message: What happened, and where the results are.
        events: The events found.
        rows: Number of rows in path.csv.
    """

    ok: bool
    message: str
    events: list[Event]
    rows: int


@contextmanager
def written(folder: Path) -> Iterator[None]:
    """Say in one sentence that the records of a run cannot be written.

    Raises:
        RecordError: They cannot.
    """
    try:
        yield
    except OSError as error:
        raise RecordError(
            f"{folder} cannot be written ({error.strerror or error}); what was written before is "
            f"kept: make room and go on with: opticcup run --resume {folder}"
        ) from error


def on_root(comm: MPI.Comm, make: Callable[[], T]) -> T | None:
    """Return what ``make`` gives on rank 0, None elsewhere; its error is raised on every rank."""
    made, error = None, None
    if comm.rank == 0:
        try:
            made = make()
        except OpticCupError as exc:  # the other ranks must learn of it before this one raises
            error = exc
    error = comm.bcast(error)
    if error is not None:
        raise error
    return made
