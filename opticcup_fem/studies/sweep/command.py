"""`opticcup sweep`: a study file in, its tables out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from opticcup_fem.studies.sweep.cache import Record, ResultCache
from opticcup_fem.studies.sweep.engine import engine_of
from opticcup_fem.studies.sweep.study_file import Point, Study
from opticcup_fem.studies.sweep.table import study_table, write_csv, write_hdf5
from opticcup_fem.studies.sweep.tasks import task_of

if TYPE_CHECKING:
    import pandas as pd

CSV, HDF5 = "sweep.csv", "sweep.h5"


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
    study: Study, out_dir: Path, *, processes: int | None = None, quiet: bool = False
) -> SweepOutcome:
    """Compute a study and write its tables (collective under MPI).

    Args:
        study: The study.
        out_dir: Folder of the tables; it exists.
        processes: Size of the pool, one a core by default.
        quiet: No progress bar.
    """
    cache = ResultCache()
    tasks = [None if point.case is None else task_of(point.case) for point in study.points]
    with engine_of(cache, processes, shown=not quiet) as engine:
        if engine is None:
            return SweepOutcome("", 0)
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


def _impossible(point: Point) -> Record:
    return {"status": "failed", "reason": point.reason, "row": {}}


def _write(study: Study, records: Sequence[Record | None], out_dir: Path) -> pd.DataFrame:
    table = study_table([point.settings for point in study.points], records)
    write_csv(table, out_dir / CSV)
    write_hdf5(table, out_dir / HDF5)
    return table
