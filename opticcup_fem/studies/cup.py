"""Grow one optic cup on the surface model and write its run folder."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from opticcup_fem.case import Case
from opticcup_fem.case.checks import require_cup
from opticcup_fem.checkpoint import Checkpoint
from opticcup_fem.contact.report import contact_report
from opticcup_fem.equilibrium.critical import CriticalPoint
from opticcup_fem.equilibrium.path import LoadStepping, PathEnd, PathPoint
from opticcup_fem.equilibrium.relaxation import Relaxed
from opticcup_fem.equilibrium.transport import balance_columns
from opticcup_fem.errors import CaseError, ClosureBreakdown, InterruptedRun, OpticCupError
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.recovery import capture, gather_nodes
from opticcup_fem.shell.tissue import Tissue
from opticcup_fem.studies.contact import TouchWatch
from opticcup_fem.studies.interruption import StopSignals, checkpoint_of
from opticcup_fem.studies.model import Stepping, remarks_on, shell_of, stepping_of
from opticcup_fem.studies.outcome import RunSummary, on_root, written
from opticcup_fem.studies.progress import Progress, sentence
from opticcup_fem.studies.recorder import ContactNumbers, Recorder, StateNumbers
from opticcup_fem.studies.restart import Restart, require_written


def run(
    case: Case,
    out_dir: Path,
    *,
    quiet: bool = False,
    comm: MPI.Comm | None = None,
    resume: bool = False,
    tissue: Tissue | None = None,
) -> RunSummary:
    """Grow the cup of a case from t_n = 0 to run.t_end (collective).

    Args:
        case: The case.
        out_dir: The run folder; an earlier run's records in it are replaced.
        quiet: No progress bar.
        comm: MPI communicator, all ranks by default.
        resume: Go on with the interrupted run of this case in the folder.
        tissue: Layers and growth in place of the case's.  No file can name them, so that such a
            run leaves no checkpoint; kappa_cap_R in its records is the case's.

    Raises:
        CaseError: The shape is not a cup, the folder cannot be written or is in use, there is
            nothing to resume, a tissue is to be resumed, or an obstacle overlaps the shell at the
            start.
        InterruptedRun: SIGINT or SIGTERM arrived; the run stopped after its step.
        MeshError: The cup cannot be meshed as the case asks.
        RecordError: A state could not be written; what was written before is kept.
    """
    require_cup(case, 'run.model = "surface" is')
    comm = comm or MPI.COMM_WORLD
    if resume and tissue is not None:
        raise CaseError("a run with layers or growth from Python is not resumed: run it again")
    progress = Progress(case.run.t_end, shown=comm.rank == 0 and not quiet)
    saved = checkpoint_of(case, out_dir, comm) if resume else None
    if saved is not None and not saved.states:  # from the beginning
        saved = None
    records = None if saved is None else saved.numbers["records"]
    remarks = remarks_on(tissue)
    recorder = on_root(comm, lambda: Recorder(case, out_dir, progress, records, remarks))
    try:
        return _grow(case, out_dir, comm, progress, recorder, saved, tissue)
    finally:
        if recorder is not None:
            recorder.folder.close()


def _grow(
    case: Case,
    out_dir: Path,
    comm: MPI.Comm,
    progress: Progress,
    recorder: Recorder | None,
    saved: Checkpoint | None,
    tissue: Tissue | None,
) -> RunSummary:
    """Follow the path and record it, from its beginning or from a checkpoint (collective)."""
    with progress.running():
        with progress.phase("meshing and compiling kernels"):
            shell = shell_of(case, comm, tissue)
            stepping = stepping_of(case, shell)
        stepping.count_iterations(progress.iteration)
        restart = Restart(case, out_dir, shell, stepping)
        restart.possible = tissue is None
        touched = (
            any(one["kind"] == "self_contact" for one in recorder.recorded) if recorder else False
        )
        watch = None
        if case.contact.mode != "off":
            watch = TouchWatch(case, shell, stepping, touched=bool(comm.bcast(touched)))
        ended = False
        with StopSignals(comm) as stop:
            for point in restart.follow(saved, recorder, watch):
                ended = not _record(recorder, stepping, point, watch)
                if not ended:
                    restart.save(recorder)
                require_written(comm, recorder, out_dir, point)
                if ended:
                    break
                if received := stop.received():
                    folder = str(out_dir) if restart.possible else ""
                    raise InterruptedRun(received, point.t_n, folder)
        if not ended and isinstance(stepping, LoadStepping) and stepping.end is not None:
            ended = _record_end(recorder, shell, stepping.end, case.contact.mode == "stop")
        failure = None if ended else stepping.failure()
    summary: RunSummary = comm.bcast(on_root(comm, lambda: _summary(recorder, out_dir, failure)))
    return summary


def _record(
    recorder: Recorder | None, stepping: Stepping, point: PathPoint, watch: TouchWatch | None
) -> bool:
    """Record a state on rank 0; return on every rank whether the run goes on (collective)."""
    shell, contact = stepping.problem.shell, stepping.problem.contact
    for critical in point.critical:
        _record_critical(recorder, shell, critical)
    snapshot = capture(shell, point.state, point.t_n)
    touch = None if watch is None else watch.see(point, snapshot)
    report = None if contact is None else contact_report(contact, point.state)
    balance = balance_columns(shell, point.state)
    goes_on = True
    if recorder is not None and snapshot is not None:
        numbers = StateNumbers(
            point.jump,
            point.iterations,
            point.negative_eigenvalues,
            point.residual,
            point.energy,
            balance,
        )
        nearest = None if watch is None else watch.nearest
        with recorder.noting_failures():
            goes_on = recorder.accept(snapshot, numbers, ContactNumbers(nearest, touch, report))
    return bool(shell.comm.bcast(goes_on))


def _record_end(recorder: Recorder | None, shell: Shell, end: PathEnd, stops: bool) -> bool:
    """Record what ended a path, and return whether it was contact (collective).

    Args:
        recorder: The records, on rank 0.
        shell: The shell.
        end: Where the path ended.
        stops: Whether contact ends a run.
    """
    if end.critical is not None:
        _record_critical(recorder, shell, end.critical)
    if not stops or not isinstance(end.attempt, Relaxed) or end.attempt.lost is not None:
        return False
    snapshot = capture(shell, end.attempt.state, end.t_n)
    crossed = False
    if recorder is not None and snapshot is not None:
        with recorder.noting_failures():
            crossed = recorder.ends_crossed(snapshot)
    return bool(shell.comm.bcast(crossed))


def _record_critical(recorder: Recorder | None, shell: Shell, critical: CriticalPoint) -> None:
    """Record a critical point with its mode on rank 0 (collective)."""
    t_n = shell.t_n
    shell.set_time(critical.at)
    snapshot, motion = (
        capture(shell, critical.state, critical.at),
        gather_nodes(shell, critical.mode.r),
    )
    shell.set_time(t_n)
    if recorder is not None and snapshot is not None and motion is not None:
        with recorder.noting_failures():
            recorder.critical(critical, snapshot, motion)


def _record_breakdown(recorder: Recorder, failure: OpticCupError | None) -> None:
    if isinstance(failure, ClosureBreakdown) and failure.t_n is not None:
        place = {
            "layer": failure.layer,
            "height": failure.height,
            "position": list(failure.position),
        }
        recorder.breakdown(failure.closure, failure.t_n, place)


def _summary(recorder: Recorder | None, out_dir: Path, failure: OpticCupError | None) -> RunSummary:
    """Close the records and put the outcome in words."""
    assert recorder is not None
    with written(out_dir):
        _record_breakdown(recorder, failure)
        events = recorder.finish()
    lines = [sentence(one) for one in events]
    reached = recorder.rows[-1]["t_n"] if recorder.rows else 0.0
    if failure is not None:
        lines.append(str(failure))
    lines.append(f"{len(recorder.rows)} states up to t_n = {reached:.4f} in {out_dir}")
    return RunSummary(failure is None, "\n".join(lines), events, len(recorder.rows))
