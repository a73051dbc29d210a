"""The folder of a run: what is written as it goes, and how it is read again.

``case.toml`` the resolved case; ``path.csv`` one row a state; ``events.json``; ``fields.pvd`` and
``fields/`` for ParaView; ``states/`` every state that a cup takes (`opticcup_fem.states`);
``sections.npz`` meridian sections; pictures made from these.  Critical modes: ``modes.pvd``, and as
arrays ``modes.npz`` of the meridian model, ``critical.npz`` of the surface model.  Whenever a run
is cut short, the files in its folder are complete up to there.
"""

import csv
import errno
import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.checkpoint import Checkpoint, delete_checkpoint, plain, write_checkpoint
from opticcup_fem.errors import CaseError
from opticcup_fem.fields import write_collection, write_fields
from opticcup_fem.folder_lock import FolderLock
from opticcup_fem.sampling import azimuths
from opticcup_fem.sections import Meridians, Section, SectionPart
from opticcup_fem.snapshot import Snapshot
from opticcup_fem.states import STATES, StateWriter, clear_states
from opticcup_fem.whole_files import replace_text, replacing

if TYPE_CHECKING:
    import pandas as pd

CASE, PATH, EVENTS = "case.toml", "path.csv", "events.json"
SECTIONS, COLLECTION, FIELDS = "sections.npz", "fields.pvd", "fields"
SUMMARY, COMPARISON, SOLID = "summary.png", "comparison.png", "cup.png"
BIFURCATION, MODES, MODE_COLLECTION = "bifurcation.png", "modes.npz", "modes.pvd"
CRITICAL, CRITICAL_PICTURE = "critical.npz", "critical.png"
MOVIE, VIEW = "movie.mp4", "view.html"

AZIMUTHS = 8
"""Meridian sections of each state: four planes through the axis."""


@dataclass(frozen=True)
class Written:
    """What a run had written when it could last be resumed.

    Attributes:
        rows: The rows of path.csv.
        states: Number of states in the folder of states.
        fields: t_n and name of the field files.
        mode_fields: The same of the modes'.
        sections: Number of states in sections.npz.
        critical: Number of modes in critical.npz.
    """

    rows: Sequence[Mapping[str, Any]]
    states: int = 0
    fields: Sequence[tuple[float, str]] = ()
    mode_fields: Sequence[tuple[float, str]] = ()
    sections: int = 0
    critical: int = 0


class RunFolder:
    """Writes the records of one run.  To be used as a context manager, by one process only."""

    def __init__(
        self,
        path: str | Path,
        case_text: str,
        *,
        overwrite: bool = False,
        resumed: Written | None = None,
        beginning: Checkpoint | None = None,
    ) -> None:
        """Make the folder and write the case into it.

        Args:
            path: The folder; made with its parents.
            case_text: What case.toml shall say.
            overwrite: Whether an earlier run's records in the folder are deleted first; other
                files in it are never touched.
            resumed: Keep that much of the run in the folder, and go on from there.
            beginning: What a new run goes on from if it is ended early, written before all else.

        Raises:
            CaseError: The folder cannot be made or written, is in use, or holds a run already.
        """
        self.path = Path(path)
        if not (overwrite or resumed) and (
            (self.path / CASE).exists() or (self.path / PATH).exists()
        ):
            raise CaseError(
                f"{self.path} already holds a run: choose another folder, or allow overwriting it"
            )
        self._columns: tuple[str, ...] = ()
        self._fields: list[tuple[float, str]] = []
        self._mode_fields: list[tuple[float, str]] = []
        self._sections: list[tuple[float, tuple[Section, ...]]] = []
        self._critical: dict[str, NDArray[Any]] = {}
        self._meridians: Meridians | None = None
        self.write_state = StateWriter(self.path / STATES)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock = FolderLock(self.path)
        except OSError as error:
            raise self._unusable(error) from error
        try:
            (self.path / FIELDS).mkdir(exist_ok=True)
            if resumed is None:
                if beginning is None:
                    delete_checkpoint(self.path)
                else:
                    write_checkpoint(self.path, beginning)
                self._clear()
                replace_text(self.path / CASE, case_text)
                replace_text(self.path / PATH, "")
                self.write_events([])
            else:
                self._keep(resumed)
            # unbuffered: a row is in the file or, where there is no room for it, is not
            self._rows: BinaryIO = (self.path / PATH).open("ab", buffering=0)
        except OSError as error:
            self._lock.release()
            raise self._unusable(error) from error

    def _unusable(self, error: OSError) -> CaseError:
        return CaseError(
            f"the run folder {self.path} cannot be written ({error.strerror}): choose another"
        )

    def _keep(self, written: Written) -> None:
        """Cut the records off behind what a run had written."""
        if written.rows:
            self._columns = tuple(written.rows[0])
        lines = [self._columns, *(self._cells(row) for row in written.rows)]
        replace_text(self.path / PATH, "".join(map(_csv_line, lines)))
        self._fields = [(float(t_n), name) for t_n, name in written.fields]
        self._mode_fields = [(float(t_n), name) for t_n, name in written.mode_fields]
        kept = {name for _, name in [*self._fields, *self._mode_fields]}
        for file in (self.path / FIELDS).glob("*.vtu"):
            if f"{FIELDS}/{file.name}" not in kept:
                file.unlink()
        for name, files in ((COLLECTION, self._fields), (MODE_COLLECTION, self._mode_fields)):
            if files:
                write_collection(self.path / name, files)
            else:
                (self.path / name).unlink(missing_ok=True)
        self.write_state.keep(written.states)
        if written.sections:
            states = read_sections(self.path)[: written.sections]
            self._sections = [(state.t_n, state.sections) for state in states]
        if written.critical:
            with np.load(self.path / CRITICAL) as arrays:
                self._critical = {
                    name: values if name == "triangles" else values[: written.critical]
                    for name, values in arrays.items()
                }

    def written(self, rows: Sequence[Mapping[str, Any]]) -> Written:
        """Return how much there is, to resume from; ``rows`` are those that were appended."""
        return Written(
            rows,
            self.write_state.count,
            tuple(self._fields),
            tuple(self._mode_fields),
            len(self._sections),
            len(self._critical.get("t_n", ())),
        )

    def __enter__(self) -> Self:
        """Return the folder itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close path.csv, also after an error."""
        self.close()

    def close(self) -> None:
        """Close path.csv and give the folder back."""
        self._rows.close()
        self._lock.release()

    def finish(self) -> None:
        """Close the folder of a run that need not be gone on with."""
        delete_checkpoint(self.path)
        self.close()

    def _clear(self) -> None:
        """Delete an earlier run's records."""
        pictures = (SUMMARY, COMPARISON, SOLID, BIFURCATION, CRITICAL_PICTURE, MOVIE, VIEW)
        modes = (MODES, MODE_COLLECTION, CRITICAL)
        names = (CASE, PATH, EVENTS, SECTIONS, COLLECTION, *modes, *pictures)
        earlier = [self.path / name for name in names]
        for file in [*earlier, *(self.path / FIELDS).glob("*.vtu")]:
            file.unlink(missing_ok=True)
        clear_states(self.path / STATES)

    def append(self, row: Mapping[str, Any]) -> None:
        """Append one row to path.csv, wholly or not at all.

        Args:
            row: Column names and values; the first row decides the columns.

        Raises:
            ValueError: The row's columns are not those of the first row.
            OSError: There is no room for it.
        """
        text = ""
        if not self._columns:
            self._columns = tuple(row)
            text = _csv_line(self._columns)
        data = (text + _csv_line(self._cells(row))).encode()
        size = self._rows.seek(0, os.SEEK_END)
        try:
            if self._rows.write(data) < len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            self._rows.truncate(size)
            raise

    def _cells(self, row: Mapping[str, Any]) -> list[str]:
        """Return a row as path.csv spells it, in the order of the columns."""
        if set(row) != set(self._columns):
            different = sorted(set(row) ^ set(self._columns))
            raise ValueError(f"a row of path.csv has other columns than the first: {different}")
        return [_cell(row[name]) for name in self._columns]

    def write_events(self, events: Sequence[Mapping[str, Any]]) -> None:
        """Replace events.json."""
        text = json.dumps(list(events), indent=2, allow_nan=False, default=plain)
        replace_text(self.path / EVENTS, text + "\n")

    def write_fields(self, snapshot: Snapshot) -> Path:
        """Write a state's fields, add them to fields.pvd, and return the new file's path."""
        name = f"{FIELDS}/{len(self._fields):04d}.vtu"
        write_fields(self.path / name, snapshot)
        self._fields.append((float(snapshot.t_n), name))
        write_collection(self.path / COLLECTION, self._fields)
        return self.path / name

    def write_mode_fields(self, snapshot: Snapshot, mode: NDArray[np.float64]) -> Path:
        """Write a critical state's fields with its ``mode``, shape (n, 3), and add to modes.pvd."""
        name = f"{FIELDS}/mode{len(self._mode_fields):04d}.vtu"
        write_fields(self.path / name, snapshot, {"mode": mode})
        self._mode_fields.append((float(snapshot.t_n), name))
        write_collection(self.path / MODE_COLLECTION, self._mode_fields)
        return self.path / name

    def write_sections(self, snapshot: Snapshot) -> None:
        """Add a state's meridian sections to sections.npz."""
        if self._meridians is None:
            self._meridians = Meridians(snapshot, azimuths(AZIMUTHS))
        self.append_sections(snapshot.t_n, self._meridians(snapshot))

    def append_sections(self, t_n: float, sections: tuple[Section, ...]) -> None:
        """Add the meridian sections of the state at normalised time ``t_n`` to sections.npz."""
        self._sections.append((float(t_n), sections))
        self._write_arrays(SECTIONS, _stacked(self._sections))

    def write_modes(self, **arrays: NDArray[Any]) -> None:
        """Replace modes.npz, the critical modes of an axisymmetric path."""
        self._write_arrays(MODES, arrays)

    def append_critical(self, **arrays: NDArray[Any]) -> None:
        """Add a critical mode of a surface run to critical.npz; its triangles are all modes'."""
        earlier = self._critical
        self._critical = {
            name: values
            if name == "triangles" or not earlier
            else np.concatenate([earlier[name], values])
            for name, values in arrays.items()
        }
        self._write_arrays(CRITICAL, self._critical)

    def _write_arrays(self, name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
        with replacing(self.path / name) as unfinished, unfinished.open("wb") as file:
            np.savez(file, **arrays)  # type: ignore[arg-type]


def _cell(value: Any) -> str:
    """Return a value as path.csv spells it: floats to the last digit, booleans as true, false."""
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, float | np.floating):
        return repr(float(value))
    return "" if value is None else str(value)


def _csv_line(cells: Sequence[str]) -> str:
    """Return one line of path.csv, "" for no cells."""
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(cells)
    return line.getvalue() if cells else ""


def _stacked(states: Sequence[tuple[float, tuple[Section, ...]]]) -> dict[str, NDArray[Any]]:
    """Return the arrays of sections.npz: times, azimuths, and per region one array a quantity.

    ``<region>_midsurface`` has shape (n_times, n_azimuths, n_points, 3), ``<region>_faces``
    (n_times, n_azimuths, n_points, n_layers + 1, 3).
    """
    first = states[0][1]
    arrays: dict[str, NDArray[Any]] = {
        "t_n": np.array([t_n for t_n, _ in states]),
        "phi": np.array([section.phi for section in first]),
        "regions": np.array(list(first[0].parts)),
    }
    for region, part in first[0].parts.items():
        arrays[f"{region}_layers"] = np.array(part.layers)
        arrays[f"{region}_theta"] = part.theta
        for name in ("midsurface", "faces"):
            arrays[f"{region}_{name}"] = np.array(
                [[getattr(section.parts[region], name) for section in s] for _, s in states]
            )
    return arrays


@dataclass(frozen=True)
class SectionedState:
    """The meridian sections of one state, by azimuth."""

    t_n: float
    sections: tuple[Section, ...]


def read_sections(run_dir: str | Path) -> list[SectionedState]:
    """Return the states of sections.npz in the order in which they were written."""
    with np.load(Path(run_dir) / SECTIONS) as file:
        arrays = dict(file)
    regions = [str(region) for region in arrays["regions"]]
    layers = {r: tuple(str(layer) for layer in arrays[f"{r}_layers"]) for r in regions}

    def part(region: str, state: int, k: int) -> SectionPart:
        middle, faces = (arrays[f"{region}_{name}"][state, k] for name in ("midsurface", "faces"))
        return SectionPart(arrays[f"{region}_theta"], middle, faces, layers[region])

    return [
        SectionedState(
            float(t_n),
            tuple(
                Section(float(phi), {region: part(region, state, k) for region in regions})
                for k, phi in enumerate(arrays["phi"])
            ),
        )
        for state, t_n in enumerate(arrays["t_n"])
    ]


def read_path(run_dir: str | Path) -> "pd.DataFrame":
    """Return path.csv as a table, one row a state."""
    import pandas as pd

    return pd.read_csv(Path(run_dir) / PATH, float_precision="round_trip")


def read_events(run_dir: str | Path) -> list[dict[str, Any]]:
    """Return the list in events.json."""
    events: list[dict[str, Any]] = json.loads((Path(run_dir) / EVENTS).read_text(encoding="utf-8"))
    return events
