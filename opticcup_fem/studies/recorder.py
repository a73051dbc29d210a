"""What a run leaves behind: rows, events, fields, sections and the picture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from opticcup_fem.case import Case, case_to_toml
from opticcup_fem.checkpoint import Checkpoint
from opticcup_fem.contact.report import ContactReport
from opticcup_fem.contact.touch import Nearest
from opticcup_fem.crossing import Crossing, surface_check
from opticcup_fem.equilibrium.critical import CriticalPoint
from opticcup_fem.events import Event, detect_events, event, with_limit_points
from opticcup_fem.folds import fold_columns
from opticcup_fem.observables import Observer
from opticcup_fem.records import RunFolder, Written
from opticcup_fem.reordering import Reordering
from opticcup_fem.snapshot import Floats, Integers, Snapshot
from opticcup_fem.studies.critical_modes import CriticalMode, critical_arrays
from opticcup_fem.studies.curvature import cap_curvature_of_run
from opticcup_fem.studies.progress import Progress
from opticcup_fem.versions import versions


@dataclass(frozen=True)
class StateNumbers:
    """What the solver knows of an accepted state, for its row.

    Attributes:
        jump: Whether the state was reached by relaxation.
        iterations: Newton iterations and relaxation steps spent on it.
        negative_eigenvalues: Of the tangent, None where it has no inertia.
        residual: Norm of the residual.
        energy: Energy over mu_IOV R^3.
        balance: Numbers of the mass balance by column, where one is solved.
    """

    jump: bool
    iterations: int
    negative_eigenvalues: int | None
    residual: float
    energy: float
    balance: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ContactNumbers:
    """What is known of contact in an accepted state.

    Attributes:
        nearest: The nearest parts of the shell, None where none are near or none were looked for.
        touch: Fields of the first touch, if it happened on the way to this state.
        report: Energy and forces, where contact is resisted.
    """

    nearest: Nearest | None = None
    touch: dict[str, Any] | None = None
    report: ContactReport | None = None


class Recorder:
    """Writes a run folder from snapshots; lives on one process.

    Attributes:
        rows: The rows of path.csv.
        recorded: Events that the run itself knows.
        failed: The first failure to write, None for none.
    """

    def __init__(
        self,
        case: Case,
        out_dir: Path,
        progress: Progress,
        resumed: Mapping[str, Any] | None = None,
        remarks: Mapping[str, str] | None = None,
    ) -> None:
        """Open the folder.

        Args:
            case: The case.
            out_dir: The run folder.
            progress: Where events are announced.
            resumed: What ``present`` gave when the run in the folder could last be resumed.
            remarks: What case.toml shall begin with, beside the versions; such a run is not the
                case's, and nobody can go on with it from its folder.

        Raises:
            CaseError: The folder cannot be written, or is in use.
        """
        self.case, self.progress = case, progress
        self.rows: list[dict[str, Any]] = []
        self.recorded: list[Event] = []
        self._announced: set[str] = set()
        self._last_sectioned = False
        self._observer: Observer | None = None
        self._reordering: Reordering | None = None
        self._last: Snapshot | None = None
        self.failed: OSError | None = None
        written = None
        if resumed is not None:
            written = Written(**resumed["written"])
            self.rows = [dict(row) for row in written.rows]
            self.recorded = [dict(one) for one in resumed["recorded"]]
            self._announced = set(resumed["announced"])
            self._last_sectioned = bool(resumed["last_sectioned"])
        text = case_to_toml(case, {**versions(), **(remarks or {})})
        beginning = None if remarks else Checkpoint(case.model_dump_json())
        self.folder = RunFolder(out_dir, text, overwrite=True, resumed=written, beginning=beginning)
        self._has_modes = written is not None and written.critical > 0
        if resumed is not None:
            self.folder.write_events(self.events())

    @contextmanager
    def noting_failures(self) -> Iterator[None]:
        """Note a failure to write in the context: no rank may be left alone in a collective."""
        try:
            yield
        except OSError as error:
            self.failed = self.failed or error

    def present(self) -> dict[str, Any]:
        """Return what the records to come depend on, as JSON knows it."""
        return {
            "written": asdict(self.folder.written(self.rows)),
            "recorded": self.recorded,
            "announced": sorted(self._announced),
            "last_sectioned": self._last_sectioned,
        }

    def continue_from(self, last: Snapshot) -> None:
        """Take the last recorded state, which a jump may want to show."""
        self._last = last
        self.progress.step(last.t_n)

    def order_cells(self, snapshot: Snapshot, order: Integers) -> None:
        """Write cells in an ``order``, shape (n_cells,), from now on; ``snapshot`` is any state."""
        self._reordering = Reordering(snapshot, order)

    def accept(
        self, snapshot: Snapshot, numbers: StateNumbers, contact: ContactNumbers | None = None
    ) -> bool:
        """Record an accepted state.

        Returns:
            False if the run ends in contact: the surface crosses itself, or its faces have met
            and the run is to end there.  The state is then not a row.
        """
        contact = contact or ContactNumbers()
        self._prepare(snapshot)
        if contact.report is not None:
            snapshot = replace(snapshot, contact_traction=contact.report.traction(snapshot))
        row = self._row(snapshot, numbers) | self._contact_columns(snapshot, contact)
        if contact.touch is not None:
            self._note_touch(contact.touch)
            table = self.case.contact
            if table.mode == "stop" and table.stop_at == "thickness":
                return False
        if self.case.contact.mode != "off":
            crossing = self._crossing(snapshot)
            if crossing is not None:
                self._end_in_contact(row, crossing)
                return False
        if self.case.output.states:
            self.folder.write_state(self._ordered(snapshot), jump=numbers.jump)
        self.folder.append(row)
        self.rows.append(row)
        self._write_state(snapshot, numbers.jump)
        self._note_events()
        self.progress.step(snapshot.t_n)
        return True

    def ends_crossed(self, snapshot: Snapshot) -> bool:
        """Record where a way down that came to no rest has crossed itself, and return whether.

        What a surface does beyond that is nothing that a tissue would do: its contact is the end.
        """
        self._prepare(snapshot)
        crossing = self._crossing(snapshot)
        if crossing is not None:
            numbers = StateNumbers(True, 0, None, float("nan"), float("nan"))
            self._end_in_contact(self._row(snapshot, numbers), crossing)
        return crossing is not None

    def _prepare(self, snapshot: Snapshot) -> None:
        """Make what depends on the mesh alone, once."""
        if self._observer is None:
            self._observer = Observer(snapshot)
            self._check, self._subdivision = surface_check(snapshot)

    def _crossing(self, snapshot: Snapshot) -> Crossing | None:
        return self._check(self._subdivision.matrix @ snapshot.position)

    def critical(self, point: CriticalPoint, snapshot: Snapshot, motion: Floats) -> None:
        """Record a critical point: its event, and its mode for ParaView and for the picture.

        Args:
            point: The critical point.
            snapshot: The state beside it.
            motion: The mode's displacement of the snapshot's nodes, shape (n, 3).
        """
        fields = {
            **point.content.describe(),
            "t_n_range": list(point.t_n_range),
            "eigenvalue": point.mode.eigenvalue,
            "eigenvalues": list(point.eigenvalues),
            "row": len(self.rows),
        }
        if point.kind == "limit_point":
            kind, how = "limit_point", "fold"
        else:
            kind, how = "symmetry_breaking" if point.lost else "symmetry_regained", "bifurcation"
        self.recorded.append(event(kind, how, point.t_n, self._kappa(point.t_n), **fields))
        if self.case.output.fields:
            self.folder.write_mode_fields(snapshot, motion)
        if self.case.run.follow == "branch":  # output.times do not tell its states apart
            self.folder.write_sections(snapshot)
        if self._reordering is not None:
            snapshot, motion = self._ordered(snapshot), self._reordering.at_nodes(motion)
        mode = CriticalMode(point.t_n, kind, snapshot, motion, point.content)
        self.folder.append_critical(**critical_arrays(mode))
        self._has_modes = True

    def breakdown(self, closure: str, t_n: float, fields: dict[str, Any]) -> None:
        """Record that the closure broke down at ``t_n``."""
        self.recorded.append(event("closure_breakdown", closure, t_n, self._kappa(t_n), **fields))

    def finish(self) -> list[Event]:
        """Write events, last sections and the picture; return the events.

        Raises:
            OSError: There is no room for them; the run can still be resumed.
        """
        if self._last is not None and not self._last_sectioned:
            self.folder.write_sections(self._last)
        events = self.events()
        self.folder.write_events(events)
        if self.case.output.picture and len(self.rows) > 1:
            from opticcup_fem.plots.summary import summary

            summary(self.folder.path)
            if self._has_modes:
                from opticcup_fem.plots.critical import critical

                critical(self.folder.path)
        self.folder.finish()
        return events

    def events(self) -> list[Event]:
        """Return the events so far."""
        return with_limit_points(detect_events(self.rows, self.recorded, curvature=self._kappa))

    def _ordered(self, snapshot: Snapshot) -> Snapshot:
        return snapshot if self._reordering is None else self._reordering(snapshot)

    def _kappa(self, t_n: float) -> float:
        return cap_curvature_of_run(self.case, self.rows, t_n)

    def _row(self, snapshot: Snapshot, numbers: StateNumbers) -> dict[str, Any]:
        assert self._observer is not None
        negative = numbers.negative_eigenvalues
        here = {"t_n": snapshot.t_n, **numbers.balance}
        return {
            "t_n": snapshot.t_n,
            "kappa_cap_R": cap_curvature_of_run(self.case, [*self.rows, here], snapshot.t_n),
            **self._observer(snapshot),
            "jump": numbers.jump,
            "newton_iterations": numbers.iterations,
            "negative_eigenvalues": "" if negative is None else negative,
            "stable": not negative,
            "residual": numbers.residual,
            "energy": numbers.energy,
            **fold_columns(snapshot),
            **numbers.balance,
        }

    def _contact_columns(self, snapshot: Snapshot, contact: ContactNumbers) -> dict[str, Any]:
        """Return the least gap and, where contact is resisted, what it does."""
        h = self.case.shape.thickness
        columns: dict[str, Any] = {
            "gap_over_h": None if contact.nearest is None else contact.nearest.gap / h
        }
        if contact.report is not None:
            columns |= contact.report.columns(snapshot)
        return columns

    def _note_touch(self, touch: dict[str, Any]) -> None:
        """Record where faces first met."""
        fields = {key: value for key, value in touch.items() if key != "t_n"}
        fields["row"] = len(self.rows)
        t_n = float(touch["t_n"])
        self.recorded.append(event("self_contact", "thickness", t_n, self._kappa(t_n), **fields))
        self.progress.event(self.recorded[-1])

    def _write_state(self, snapshot: Snapshot, jump: bool) -> None:
        """Write fields at the output times, sections there and on both sides of a jump."""
        due = any(abs(snapshot.t_n - t) < 1e-12 for t in self.case.output.times)
        if jump and self._last is not None and not self._last_sectioned:
            self.folder.write_sections(self._last)
        if due and self.case.output.fields:
            self.folder.write_fields(snapshot)
        if due or jump:
            self.folder.write_sections(snapshot)
        self._last, self._last_sectioned = snapshot, due or jump

    def _note_events(self) -> None:
        """Keep events.json up to date and announce what is new and certain."""
        events = self.events()
        self.folder.write_events(events)
        for one in events:
            if one["kind"] not in self._announced and one["type"] != "smooth":
                self._announced.add(one["kind"])
                self.progress.event(one)

    def _end_in_contact(self, row: dict[str, Any], crossing: Crossing) -> None:
        """Record the contact, and a loss of symmetry that only the crossed state shows."""
        t_n = float(row["t_n"])
        shown = detect_events([*self.rows, row], self.recorded, curvature=self._kappa)
        known = {one["kind"] for one in self.recorded}
        self.recorded += [one for one in shown if one["kind"] == "symmetry_breaking" not in known]
        where = {**crossing.describe(), "row": len(self.rows)}
        contact = event("self_contact", "mid-surface", t_n, self._kappa(t_n), **where)
        self.recorded.append(contact)
        for one in self.recorded:
            if one["type"] != "thickness":  # announced when it happened
                self.progress.event(one)
