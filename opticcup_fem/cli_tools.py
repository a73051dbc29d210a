"""What every command needs: a folder to write in, one line for every error, one rank that talks.

Nothing heavy is imported at the top: `--help` must answer at once.
"""

from __future__ import annotations

import errno
import os
import sys
import tempfile
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from opticcup_fem.errors import CaseError, InterruptedRun, MeshError, OpticCupError, RecordError

FAILED_RUN, BAD_INPUT, INTERRUPTED = 1, 2, 130

UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)
"""Errors of a disk that is full or cannot be written, and not of this program."""


def prepare_folder(folder: Path) -> None:
    """Make a folder and try to write in it now, not after an hour of computing."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise CaseError(
            f"{folder}: cannot write there ({error.strerror}); give another place with --out"
        ) from None


@contextmanager
def errors_as_one_line() -> Iterator[None]:
    """Turn an error of the package into one line and an exit code."""
    try:
        yield
    except OpticCupError as error:
        text = str(error) if isinstance(error, InterruptedRun) else f"error: {error}"
        say(text, err=True)
        raise typer.Exit(_exit_code(error)) from None


def _exit_code(error: OpticCupError) -> int:
    if isinstance(error, InterruptedRun):
        return 128 + error.signal  # as shells report a signal: 130 after Ctrl-C
    return BAD_INPUT if isinstance(error, CaseError | MeshError) else FAILED_RUN


@contextmanager
def one_error_for_all_ranks() -> Iterator[None]:
    """Raise the first rank's error on every rank: none may wait in a collective for the others."""
    error: OpticCupError | None = None
    try:
        yield
    except OpticCupError as own:
        error = own
    if is_under_mpi():
        from mpi4py import MPI

        errors = MPI.COMM_WORLD.allgather(error)
        error = next((one for one in errors if one is not None), None)
    if error is not None:
        raise error


@contextmanager
def abort_all_ranks_on_a_bug() -> Iterator[None]:
    """Keep an unforeseen exception on one rank from leaving the others waiting for ever.

    Raises:
        RecordError: The disk is full, or cannot be written any more.
    """
    try:
        yield
    except OpticCupError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno in UNWRITABLE:
            sentence = (
                f"the results cannot be written ({error.strerror}): make room, and give the same "
                "command again"
            )
            if not is_under_mpi():
                raise RecordError(sentence) from None
            typer.echo(f"error: {sentence}", err=True)
            sys.stderr.flush()
            _abort()
        if is_under_mpi():
            traceback.print_exc()
            sys.stderr.flush()
            _abort()
        raise


def _abort() -> None:
    """End all ranks."""
    from mpi4py import MPI

    MPI.COMM_WORLD.Abort(FAILED_RUN)


def say(text: str, err: bool = False) -> None:
    """Print a text on rank 0."""
    if rank() == 0:
        typer.echo(text, err=err)


def is_under_mpi() -> bool:
    """Tell whether a launcher of Open MPI, MPICH or Slurm started this process."""
    return any(name in os.environ for name in ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK"))


def rank() -> int:
    """Return this process's rank, 0 without MPI."""
    if not is_under_mpi():
        return 0
    # Starting MPI here also makes every rank wait for the others when it ends: otherwise the
    # first to exit with an error has the launcher kill the one that is about to print it.
    from mpi4py import MPI

    return MPI.COMM_WORLD.rank
