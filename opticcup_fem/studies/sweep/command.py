"""`opticcup sweep`: a study file in, its tables out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from opticcup_fem.errors import CaseError
from opticcup_fem.studies.sweep.cache import Record, ResultCache, Task
from opticcup_fem.studies.sweep.engine import Engine, engine_of
from opticcup_fem.studies.sweep.study_file import Point, Study
from opticcup_fem.studies.sweep.table import study_table, write_csv, write_hdf5
from opticcup_fem.studies.sweep.tasks import task_of

if TYPE_CHECKING:
    import pandas as pd

CSV, HDF5 = "sweep.csv", "sweep.h5"


@dataclass(frozen=True)
class Part:
    """Every ``count``-th point of a study, from the ``number``-th on (counted from 1)."""

    number: int
    count: int

    @classmethod
    def parsed(cls, text: str) -> Part:
        """Return the part that "2/8" names.

        Raises:
            CaseError: It names none.
        """
        number, slash, count = text.partition("/")
        if not (slash and number.isdecimal() and count.isdecimal()):
            raise CaseError(f"part {text!r}: write it as 2/8, the second of eight parts")
        part = cls(int(number), int(count))
        if not 1 <= part.number <= part.count:
            raise CaseError(
                f"part {text!r}: the parts are 1/{part.count} to {part.count}/{part.count}"
            )
        return part


@dataclass(frozen=True)
class SweepOutcome:
    """What a study gave.

    Attributes:
        message: Counts, and where the tables are; empty on ranks that only helped.
        failed: How many points have no result.
    """

    message: str
    failed: int


def run(
    study: Study,
    out_dir: Path,
    *,
    processes: int | None = None,
    quiet: bool = False,
    part: Part | None = None,
) -> SweepOutcome:
    """Compute a study and write its tables (collective under MPI).

    Args:
        study: The study.
        out_dir: Folder of the tables; it exists.
        processes: Size of the pool, one a core by default.
        quiet: No progress bar.
        part: Compute that part only, into the cache, and write no table.
    """
    cache = ResultCache()
    tasks = [None if point.case is None else task_of(point.case) for point in study.points]
    with engine_of(cache, processes, shown=not quiet) as engine:
        if engine is None:
            return SweepOutcome("", 0)
        if part is not None:
            return _compute_part(tasks[part.number - 1 :: part.count], part, engine)
        try:
            found = iter(engine.run([task for task in tasks if task is not None], "sweep"))
            records = [_impossible(p) if p.case is None else next(found) for p in study.points]
        except BaseException:
            # interrupted: what is known is written, the rest is pending
            _write(study, [None if t is None else cache.load(t) for t in tasks], out_dir)
            raise
        table = _write(study, records, out_dir)
        computed = engine.computed
    failed = int((table["status"] == "failed").sum())
    message = (
        f"{len(table)} points, {computed} computed, {failed} without a result: "
        f"{out_dir / CSV}, {out_dir / HDF5}"
    )
    return SweepOutcome(message, failed)


def _compute_part(tasks: Sequence[Task | None], part: Part, engine: Engine) -> SweepOutcome:
    records = engine.run([task for task in tasks if task is not None], "sweep")
    failed = sum(record["status"] == "failed" for record in records) + tasks.count(None)
    message = (
        f"part {part.number} of {part.count}: {len(tasks)} points, {engine.computed} computed, "
        f"{failed} without a result; the sweep without --part writes the tables"
    )
    return SweepOutcome(message, failed)


def _impossible(point: Point) -> Record:
    return {"status": "failed", "reason": point.reason, "row": {}}


def _write(study: Study, records: Sequence[Record | None], out_dir: Path) -> pd.DataFrame:
    table = study_table([point.settings for point in study.points], records)
    write_csv(table, out_dir / CSV)
    write_hdf5(table, out_dir / HDF5)
    return table
