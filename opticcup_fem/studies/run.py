"""Grow the shell of a case, on the model that the case names."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from opticcup_fem.case import Case
from opticcup_fem.shell.tissue import Tissue
from opticcup_fem.studies.outcome import RunSummary


def run(
    case: Case,
    folder: Path | str,
    *,
    tissue: Tissue | None = None,
    quiet: bool = True,
    comm: MPI.Comm | None = None,
    resume: bool = False,
) -> RunSummary:
    """Do what ``opticcup run`` does: follow the path of a case and write its run folder.

    Collective over ``comm``.  A run that ends early is no error: see the outcome's ``ok``.

    Args:
        case: The case.
        folder: The run folder; an earlier run's records in it are replaced.
        tissue: Layers and growth in place of the case's, see ``tissue_of``.
        quiet: No progress bar.
        comm: MPI communicator, all ranks by default.
        resume: Go on with the interrupted run of this case in the folder.

    Raises:
        CaseError: The case cannot be computed, or the folder not be written.
        InterruptedRun: SIGINT or SIGTERM arrived.
        MeshError: The shape cannot be meshed as the case asks.
        RecordError: A state could not be written.
    """
    if case.run.model == "meridian":
        from opticcup_fem.studies import meridian

        return meridian.run(
            case, Path(folder), tissue=tissue, quiet=quiet, comm=comm, resume=resume
        )
    from opticcup_fem.studies import cup

    return cup.run(case, Path(folder), tissue=tissue, quiet=quiet, comm=comm, resume=resume)
