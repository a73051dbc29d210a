"""Follow one cup's whole axisymmetric path and its stability, and write its run folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np

from opticcup_fem.case import Case, case_to_toml
from opticcup_fem.case.checks import require_axisymmetric, require_perfect
from opticcup_fem.checkpoint import Checkpoint
from opticcup_fem.errors import CaseError, ClosureBreakdown, InterruptedRun, OpticCupError
from opticcup_fem.events import Event, event
from opticcup_fem.meridian.contact import self_crossing
from opticcup_fem.meridian.crossings import Crossing, crossings
from opticcup_fem.meridian.ellipticity import ellipticity
from opticcup_fem.meridian.events import path_events
from opticcup_fem.meridian.layers import sections
from opticcup_fem.meridian.mesh import Grading, MeridianMesh
from opticcup_fem.meridian.observables import CupObserver
from opticcup_fem.meridian.path import MeridianPath, MeridianPoint
from opticcup_fem.meridian.profile import ClosedSphere, Disc, OpenCap, Profile
from opticcup_fem.meridian.revolution import SEGMENTS, Revolution
from opticcup_fem.meridian.shell import MeridianShell
from opticcup_fem.meridian.transport import balance_columns, meridian_balance
from opticcup_fem.meridian.waves import Waves
from opticcup_fem.records import AZIMUTHS, RunFolder
from opticcup_fem.sampling import azimuths
from opticcup_fem.shell.tissue import Tissue
from opticcup_fem.studies.curvature import cap_curvature_of_run
from opticcup_fem.studies.interruption import StopSignals, checkpoint_of
from opticcup_fem.studies.model import balance_laws_of, remarks_on, tissue_of
from opticcup_fem.studies.outcome import RunSummary, on_root, written
from opticcup_fem.studies.progress import Progress, sentence
from opticcup_fem.versions import versions


def grading_of(case: Case) -> Grading:
    """Return cells that resolve the bending length sqrt(R h): 0.3 of it, and 0.1 R at most.

    An open cap has ten cells or more, however small it is.
    """
    largest = min(0.1, 0.3 * case.shape.thickness**0.5)
    if case.shape.kind == "cap":
        largest = min(largest, case.shape.opening_angle / 10)
    return Grading(largest, at_rim=min(0.02, largest / 2))


def profile_of(case: Case) -> Profile:
    """Return the reference meridian of a case, in units of R."""
    shape = case.shape
    if shape.kind == "disk":
        return Disc()
    kind = OpenCap if shape.kind == "cap" else ClosedSphere
    return kind(shape.opening_angle)


def shell_of(case: Case, tissue: Tissue | None = None) -> MeridianShell:
    """Return the axisymmetric shell of a case, of another tissue if one is given."""
    mesh, own = MeridianMesh(profile_of(case), grading_of(case)), tissue or tissue_of(case)
    sections = {name: own.sections[name] for name in mesh.region}
    shell = MeridianShell(mesh, sections, own.laws, case.material.closure)
    balances = balance_laws_of(case) if tissue is None else {}
    if balances:
        meridian_balance(shell, balances, case.mass.tolerance)
    return shell


def path_of(case: Case, tissue: Tissue | None = None) -> MeridianPath:
    """Return the path of a case, with the stability in m = 0 .. run.max_wavenumber."""
    shell = shell_of(case, tissue)
    return MeridianPath(shell, Waves(shell, tuple(range(case.run.max_wavenumber + 1))))


def run(
    case: Case,
    out_dir: Path,
    *,
    quiet: bool = False,
    comm: MPI.Comm | None = None,
    tissue: Tissue | None = None,
    resume: bool = False,
) -> RunSummary:
    """Follow the path of a case from t_n = 0 to run.t_end on rank 0 (collective).

    An interrupted run, which takes seconds, starts again when it is resumed.

    Args:
        case: The case.
        out_dir: The run folder; an earlier run's records in it are replaced.
        quiet: No progress bar.
        comm: MPI communicator, all ranks by default.
        tissue: Layers and growth in place of the case's; laws are functions of place and time.
        resume: The folder holds an interrupted run of this case.

    Raises:
        CaseError: The shell has an imperfection or is not axisymmetric, the folder cannot be
            written or is in use, there is nothing to resume, or a tissue is to be resumed.
        InterruptedRun: SIGINT or SIGTERM arrived.
        RecordError: The records could not be written; what was written before is kept.
    """
    require_perfect(case, 'run.model = "meridian" is')
    require_axisymmetric(case, 'run.model = "meridian" is')
    comm = comm or MPI.COMM_WORLD
    if resume and tissue is not None:
        raise CaseError("a run with layers or growth from Python is not resumed: run it again")
    if resume:
        checkpoint_of(case, out_dir, comm)
    with StopSignals(MPI.COMM_SELF) as stop:
        summary: RunSummary | None = on_root(comm, lambda: _run(case, out_dir, quiet, stop, tissue))
    shared: RunSummary = comm.bcast(summary)
    return shared


def _run(
    case: Case, out_dir: Path, quiet: bool, stop: StopSignals, tissue: Tissue | None
) -> RunSummary:
    progress = Progress(case.run.t_end, shown=not quiet)
    recorder = MeridianRecorder(case, out_dir, remarks_on(tissue))
    try:
        with written(out_dir), progress.running():
            with progress.phase("compiling kernels"):
                path = path_of(case, tissue)
            path.count_iterations(progress.iteration)
            recorder.begin(path)
            for point in path.follow(case.run.t_end, case.output.times):
                recorder.accept(point)
                progress.step(point.t_n)
                if received := stop.received():
                    folder = str(out_dir) if tissue is None else ""
                    raise InterruptedRun(received, point.t_n, folder)
            failure = path.failure()
            with progress.phase("localising events"):
                events = recorder.finish(failure)
    finally:
        recorder.folder.close()
    lines = [sentence(one) for one in events if one.get("followed", True)]
    if failure is not None:
        lines.append(str(failure))
    reached = max((row["t_n"] for row in recorder.rows), default=0.0)
    lines.append(f"{len(recorder.rows)} states up to t_n = {reached:.4f} in {out_dir}")
    # a contact of the shell with itself ends what a cup can follow: nothing is promised beyond
    ok = failure is None or recorder.touched
    return RunSummary(ok, "\n".join(lines), events, len(recorder.rows))


class MeridianRecorder:
    """Writes a run folder from the points of a path.

    Attributes:
        rows: The rows of path.csv.
        points: Their points.
        touched: Whether the followed part has come to cross itself.
    """

    def __init__(self, case: Case, out_dir: Path, remarks: Mapping[str, str]) -> None:
        """Open the folder, whose case.toml shall begin with the ``remarks`` too.

        Raises:
            CaseError: The folder cannot be written.
        """
        self.case = case
        text = case_to_toml(case, {**versions(), **remarks})
        beginning = None if remarks else Checkpoint(case.model_dump_json())
        self.folder = RunFolder(out_dir, text, overwrite=True, beginning=beginning)
        self.rows: list[dict[str, Any]] = []
        self.points: list[MeridianPoint] = []
        self._recorded: list[Event] = []
        self.touched = False
        self._elliptic = True

    def begin(self, path: MeridianPath) -> None:
        """Take the path whose points will come."""
        self.path, self.shell = path, path.problem.shell
        self._observer = CupObserver(self.shell)
        self._revolution = Revolution(self.shell)

    def accept(self, point: MeridianPoint) -> None:
        """Record a point; from the first that crosses itself on, no cup follows the path."""
        crossing = self_crossing(self.shell, point.state)
        if crossing is not None and point.followed and not self.touched:
            place = [float(crossing[0]), 0.0, float(crossing[1])]
            t_n, arc = point.t_n, point.path.arc
            self._recorded.append(
                event(
                    "self_contact",
                    "mid-surface",
                    t_n,
                    self._kappa(t_n),
                    position=place,
                    arc_length=arc,
                )
            )
            self.touched = True
        self._watch_ellipticity(point)
        if self.touched:
            point = replace(point, followed=False, jump=False)
        if point.followed and self.case.output.states:
            state = self._revolution.snapshot(point.state, point.t_n)
            self.folder.write_state(state, jump=point.jump)
        row = self._row(point, crossing is not None)
        self.folder.append(row)
        self.rows.append(row)
        self.points.append(point)
        due = any(abs(point.t_n - t) < 1e-12 for t in self.case.output.times)
        if point.followed and due and self.case.output.fields:
            self.folder.write_fields(self._revolution.snapshot(point.state, point.t_n))
        if point.followed and (due or point.jump or point.path.is_fold):
            where = [float(phi) for phi in azimuths(AZIMUTHS)]
            self.folder.append_sections(
                point.t_n, sections(self.shell, point.state, point.t_n, where)
            )

    def _watch_ellipticity(self, point: MeridianPoint) -> None:
        """Record the first followed state in which the closure does not resist short waves."""
        if self._elliptic and point.followed:
            least = ellipticity(self.shell, point.state, point.t_n)
            if least.value <= 0:
                self._elliptic = False
                place = [least.position[0], 0.0, least.position[1]]
                self._recorded.append(
                    event(
                        "closure_breakdown",
                        "loss of ellipticity",
                        point.t_n,
                        self._kappa(point.t_n),
                        position=place,
                        arc_length=point.path.arc,
                    )
                )

    def finish(self, failure: OpticCupError | None) -> list[Event]:
        """Localise and write the events, modes and pictures; return the events."""
        if isinstance(failure, ClosureBreakdown) and failure.t_n is not None:
            place = {
                "layer": failure.layer,
                "height": failure.height,
                "position": list(failure.position),
                "followed": bool(self.points) and self.points[-1].followed,
            }
            self._recorded.append(
                event(
                    "closure_breakdown",
                    failure.closure,
                    failure.t_n,
                    self._kappa(failure.t_n),
                    **place,
                )
            )
        found = crossings(self.path, self.points)
        events = path_events(self.path, self.points, self.rows, found, self._kappa)
        events = sorted([*events, *self._recorded], key=lambda one: float(one["t_n"]))
        self.folder.write_events(events)
        if found:
            self._write_modes(found)
        if self.case.output.picture and len(self.rows) > 1:
            from opticcup_fem.plots.bifurcation import bifurcation
            from opticcup_fem.plots.summary import summary

            summary(self.folder.path)
            bifurcation(self.folder.path)
        self.folder.finish()
        return events

    def _kappa(self, t_n: float) -> float:
        return cap_curvature_of_run(self.case, self.rows, t_n)

    def _row(self, point: MeridianPoint, crosses: bool) -> dict[str, Any]:
        pairs = sum(count if m == 0 else 2 * count for m, count in point.negative.items())
        balance = balance_columns(self.shell, point.state, point.t_n)
        rows = [*self.rows, {"t_n": point.t_n, **balance}]
        return {
            "t_n": point.t_n,
            "kappa_cap_R": cap_curvature_of_run(self.case, rows, point.t_n),
            **self._observer(point.state, point.t_n),
            "jump": point.jump,
            "newton_iterations": point.path.iterations,
            "negative_eigenvalues": pairs,
            "residual": point.path.residual,
            "energy": self.shell.energy(point.state, point.t_n),
            "stable": point.stable,
            "followed": point.followed,
            "limit_point": point.path.is_fold,
            "self_crossing": crosses,
            "arc_length": point.path.arc,
            **balance,
            **{f"negative_m{m}": one.negative for m, one in point.spectra.items()},
            **{f"eigenvalue_m{m}": one.nearest for m, one in point.spectra.items()},
        }

    def _write_modes(self, found: list[Crossing]) -> None:
        """Write for each crossing the state and the critical mode, as curves and in space."""
        self.folder.write_modes(
            t_n=np.array([one.t_n for one in found]),
            wavenumber=np.array([one.wavenumber for one in found]),
            lost=np.array([one.lost for one in found]),
            followed=np.array([one.followed for one in found]),
            theta=self.shell.mesh.s,
            interface=np.array(self.shell.mesh.profile.regions["cap"][1]),
            position=np.array([one.state.r for one in found]),
            amplitude=np.array([one.mode.u for one in found]),
        )
        if self.case.output.fields:
            for one in found:
                # nine nodes and more on a wave
                surface = Revolution(self.shell, max(SEGMENTS, 3 * one.wavenumber))
                self.folder.write_mode_fields(
                    surface.snapshot(one.state, one.t_n), surface.wave(one.mode.u, one.wavenumber)
                )
