"""Where the buckled cup and the round one are both stable, and where their energies are equal.

Growth goes on from t_n = 0 to run.t_end, and the slit that the cup has become is followed back in
t_n until it opens, contact resisted all the way; then, at one t_n, to thicker shells until it is
lost.  The round cup stands beside it on the same mesh, so that most of the mesh's error leaves the
difference of their energies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pandas as pd

from opticcup_fem.case import Case, parse_case
from opticcup_fem.case.checks import require_cup, require_perfect
from opticcup_fem.contact.report import contact_report
from opticcup_fem.crossing import surface_check
from opticcup_fem.equilibrium.path import LoadStepping, PathPoint
from opticcup_fem.errors import CaseError
from opticcup_fem.mesh import SurfaceMesh
from opticcup_fem.observables import Observer
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.recovery import capture
from opticcup_fem.studies.model import (
    growth_of,
    mesh_of,
    sections_of,
    stepping_of,
    with_slenderness,
)
from opticcup_fem.studies.progress import Progress
from opticcup_fem.whole_files import replacing

TABLE, PICTURE = "hysteresis.csv", "hysteresis.png"

SLIT = 0.1
"""Amplitude of the interface's m = 2, in R, above which a cup is a slit."""

FINE = 6
"""Parts of a cell's edge in the test for crossings: twice as many as in the collision mesh."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Hysteresis:
    """What was found.

    Attributes:
        ok: Whether the cup buckled, and the slit was followed until it opened.
        rows: One per state: ``branch`` ("on", "back", "round", "thicker", "thicker round"),
            ``radius_over_thickness``, ``t_n``, ``stable``, ``slit``, ``energy`` and what
            ``Observer`` and ``ContactReport`` measure.
        opens: t_n between which the slit opens on the way back, None if it does not.
        equal: t_n at which both have the same energy, None where the signs never change.
        lost: R/h between which the slit is lost on the way to thicker shells, None if it is not.
        equal_ratio: R/h at which both have the same energy at the t_n of that way, or None.
    """

    ok: bool
    rows: list[Row]
    opens: tuple[float, float] | None
    equal: float | None
    lost: tuple[float, float] | None
    equal_ratio: float | None

    @property
    def message(self) -> str:
        """Return the outcome in words."""
        lines = []
        if self.opens is not None:
            lines.append(f"followed back, the slit opens between t_n = {_range(self.opens)}")
        if self.equal is not None:
            lines.append(f"slit and round cup have equal energies at t_n = {self.equal:.4f}")
        if self.lost is not None:
            lines.append(f"in thicker shells the slit is lost between R/h = {_range(self.lost)}")
        if self.equal_ratio is not None:
            lines.append(f"energies are equal at R/h = {self.equal_ratio:.3f}")
        if not self.ok:
            lines.append("the cup did not become a slit that could be followed until it opened")
        return "\n".join(lines)


def _range(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.4g} and {ends[1]:.4g}"


class _Ledger:
    """The rows, in the table on rank 0 as soon as they are known, and the bar that shows them."""

    def __init__(self, path: Path | None, progress: Progress) -> None:
        self.rows: list[Row] = []
        self._path, self._progress = path, progress

    def add(self, row: Row) -> None:
        self.rows.append(row)
        self._progress.step(row["t_n"])
        if self._path is not None:
            with replacing(self._path) as unfinished:
                pd.DataFrame(self.rows).to_csv(unfinished, index=False)

    def phase(self, name: str) -> AbstractContextManager[None]:
        return self._progress.phase(name)

    def of(self, branch: str) -> list[Row]:
        return [row for row in self.rows if row["branch"] == branch]


class _Cup:
    """One shell with what follows its states and measures them (collective throughout)."""

    def __init__(self, case: Case, mesh: SurfaceMesh) -> None:
        self.case = case
        self.shell = Shell(mesh, sections_of(case), growth_of(case), case.material.closure)
        stepping = stepping_of(case, self.shell)
        assert isinstance(stepping, LoadStepping)  # branches do not resist contact
        self.stepping = stepping
        self._observer: Observer | None = None

    def row(self, branch: str, point: PathPoint) -> Row:
        """Return the numbers of a state at the shell's time, the same on all ranks."""
        contact = self.stepping.problem.contact
        snapshot = capture(self.shell, point.state, point.t_n)
        report = None if contact is None else contact_report(contact, point.state)
        row: Row = {
            "branch": branch,
            "radius_over_thickness": self.case.shape.radius_over_thickness,
            "t_n": point.t_n,
            "stable": point.stable,
            "jump": point.jump,
            "energy": point.energy,
        }
        if snapshot is not None:
            self._observer = self._observer or Observer(snapshot)
            check, cut = surface_check(snapshot, FINE)
            row |= self._observer(snapshot)
            row |= {} if report is None else report.columns(snapshot)
            row["slit"] = row["interface_m2"] > SLIT
            row["crosses_itself"] = check(cut.matrix @ snapshot.position) is not None
        found: Row = self.shell.comm.bcast(row)
        return found

    def path(
        self, branch: str, state: ShellState, t_start: float, t_end: float
    ) -> Iterator[tuple[Row, PathPoint]]:
        """Yield the states from one time to another, those at the output times among them."""
        for point in self.stepping.follow(state, t_end, self.case.output.times, t_start):
            yield self.row(branch, point), point

    def at_rest(self, branch: str, state: ShellState, t_n: float) -> tuple[Row, ShellState] | None:
        """Return the stable state that descent finds from another one, None if it finds none."""
        self.shell.set_time(t_n)
        relaxed = self.stepping.relaxation.relax(state)
        if not relaxed.converged:
            return None
        point = PathPoint(
            t_n, relaxed.state, False, 0, relaxed.iterations, relaxed.residual, relaxed.energy
        )
        return self.row(branch, point), relaxed.state


def run(
    case: Case,
    out_dir: Path,
    *,
    ratios: Sequence[float] = (),
    at: float | None = None,
    comm: MPI.Comm | None = None,
    quiet: bool = True,
) -> Hysteresis:
    """Follow the slit of a case back in t_n, and to thicker shells (collective).

    Writes ``hysteresis.csv``, a row as soon as its state is known, and ``hysteresis.png``.

    Args:
        case: A case with ``contact.mode = "resist"`` that buckles before ``run.t_end``.
        out_dir: Folder of the results.
        ratios: Values of R/h, the most slender first, to which the slit is carried.
        at: t_n at which it is, one of ``output.times``; the last one by default.
        comm: MPI communicator, all ranks by default.
        quiet: Whether no progress is shown.

    Raises:
        CaseError: The case has no slit to follow, or ``at`` is not one of its output times.
    """
    _require(case, at)
    comm = comm or MPI.COMM_WORLD
    root = comm.rank == 0
    progress = Progress(case.run.t_end, shown=root and not quiet)
    ledger = _Ledger(out_dir / TABLE if root else None, progress)
    with progress.running():
        cup = _Cup(case, mesh_of(case, comm))
        slits = _there_and_back(cup, ledger)
        rounds = _round(cup, ledger)
        where = case.output.times[-1] if at is None else at
        if ratios and where in slits and where in rounds:
            _thicker(cup, ledger, slits[where], rounds[where], ratios, where)
    if root:
        from opticcup_fem.plots.hysteresis import hysteresis

        hysteresis(out_dir / TABLE, out_dir / PICTURE)
    return _found(ledger)


def _require(case: Case, at: float | None) -> None:
    require_cup(case, "a slit is followed")
    require_perfect(case, "slit and round cup are compared")
    if case.contact.mode != "resist" or case.contact.obstacles or case.run.model != "surface":
        raise CaseError(
            f'contact.mode = "{case.contact.mode}" is not possible: a slit is followed on the '
            'surface model with contact resisted and no obstacle; take "resist"'
        )
    if at is not None and at not in case.output.times:
        raise CaseError(f"--at {at:g} is not possible: take one of output.times")


States = dict[float, ShellState]


def _there_and_back(cup: _Cup, ledger: _Ledger) -> States:
    """Follow growth on, and back as long as there is a slit; return the slits at output times."""
    last: PathPoint | None = None
    with ledger.phase("growing"):
        for row, point in cup.path("on", cup.shell.reference_state(), 0.0, cup.case.run.t_end):
            ledger.add(row)
            last = point
    slits: States = {}
    if last is None or not ledger.rows[-1]["slit"]:
        return slits
    with ledger.phase("shrinking"):
        for row, point in cup.path("back", last.state, last.t_n, 0.0):
            ledger.add(row)
            if not row["slit"]:
                break
            slits[point.t_n] = point.state
    return slits


def _round(cup: _Cup, ledger: _Ledger) -> States:
    """Follow the axisymmetric states, stable or not, on the same shell."""
    tables = cup.case.model_dump(mode="json")
    tables["run"] |= {"follow": "axisymmetric", "keep_mirrors": False}
    tables["contact"] = {"mode": "off"}
    other = _Cup(parse_case(tables), cup.shell.surface_mesh)
    states: States = {}
    with ledger.phase("round cup"):
        start, t_end = other.shell.reference_state(), cup.case.run.t_end
        for row, point in other.path("round", start, 0.0, t_end):
            ledger.add(row)
            states[point.t_n] = point.state
    return states


def _thicker(
    cup: _Cup,
    ledger: _Ledger,
    slit: ShellState,
    round_: ShellState,
    ratios: Sequence[float],
    t_n: float,
) -> None:
    """Carry slit and round cup from one R/h to the next, until there is no slit."""
    starts = {"thicker": slit, "thicker round": round_}
    for ratio in ratios:
        other = _Cup(with_slenderness(cup.case, ratio), cup.shell.surface_mesh)
        slits = 0
        with ledger.phase(f"R/h = {ratio:g}"):
            for branch, start in starts.items():
                found = other.at_rest(branch, start, t_n)
                if found is None:
                    continue
                ledger.add(found[0])
                slits += found[0]["slit"]
                if found[0]["slit"] == (branch == "thicker"):
                    starts[branch] = found[1]
        if not slits:
            break


def _found(ledger: _Ledger) -> Hysteresis:
    """Read the ends of the region, and the equality of energies, off the rows."""
    back = ledger.of("back")
    opens = None
    if len(back) > 1 and not back[-1]["slit"]:
        opens = (back[-1]["t_n"], back[-2]["t_n"])
    slit = {row["t_n"]: row["energy"] for row in back if row["slit"]}
    beside = {row["t_n"]: row["energy"] for row in ledger.of("round")}
    equal = _crossing({t: slit[t] - beside[t] for t in slit.keys() & beside.keys()})
    slits = {row["radius_over_thickness"]: row for row in ledger.of("thicker")}
    rounds = {row["radius_over_thickness"]: row for row in ledger.of("thicker round")}
    kept = [ratio for ratio, row in slits.items() if row["slit"]]
    gone = [ratio for ratio, row in slits.items() if not row["slit"]]
    both = [ratio for ratio in kept if ratio in rounds and not rounds[ratio]["slit"]]
    excess = {ratio: slits[ratio]["energy"] - rounds[ratio]["energy"] for ratio in both}
    lost = (max(gone), min(kept)) if kept and gone else None
    return Hysteresis(opens is not None, ledger.rows, opens, equal, lost, _crossing(excess))


def _crossing(values: dict[float, float]) -> float | None:
    """Return where values over an abscissa change sign last, on straight lines; None if nowhere.

    >>> _crossing({1.0: -1.0, 0.5: 1.0, 0.25: 2.0})
    0.75
    """
    x = np.array(sorted(values))
    y = np.array([values[one] for one in x])
    changes = np.flatnonzero(y[:-1] * y[1:] < 0)
    if len(changes) == 0:
        return None
    k = int(changes[-1])
    return float(x[k] - y[k] * (x[k + 1] - x[k]) / (y[k + 1] - y[k]))
