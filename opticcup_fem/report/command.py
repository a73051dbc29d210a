"""`opticcup reproduce`: the report, or some of its figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from opticcup_fem.errors import CaseError, OpticCupError
from opticcup_fem.plots import style
from opticcup_fem.report.html import write_report
from opticcup_fem.report.registry import FIGURES
from opticcup_fem.report.results import Results, compute
from opticcup_fem.studies.sweep.cache import ResultCache
from opticcup_fem.studies.sweep.engine import engine_of
from opticcup_fem.studies.sweep.table import write_csv

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Reproduction:
    """What was made.

    Attributes:
        message: Counts, where the page is, and why figures are missing; empty on ranks that only
            helped.
        missing: Number of figures that could not be drawn.
    """

    message: str
    missing: int = 0


def checked_names(names: Sequence[str]) -> list[str]:
    """Return the figures asked for in the report's order, all of them by default.

    Raises:
        CaseError: One is not a figure.
    """
    for name in names:
        if name not in FIGURES:
            raise CaseError(
                f"{name} is not a figure of the report; give some of {', '.join(FIGURES)}"
            )
    return [name for name in FIGURES if not names or name in names]


def read_experiment(path: Path) -> pd.DataFrame:
    """Return measured points: columns t_n and one or both of D_over_r, lambda_iov.

    Raises:
        CaseError: The file cannot be read or lacks them.
    """
    import pandas as pd

    try:
        table = pd.read_csv(path, comment="#")
    except (OSError, ValueError) as error:
        raise CaseError(f"{path}: cannot be read as a CSV file ({error})") from None
    wanted = {"D_over_r", "lambda_iov"}
    if "t_n" not in table or not wanted & set(table):
        raise CaseError(
            f"{path}: measured points need a column t_n and D_over_r or lambda_iov; it has "
            f"{', '.join(map(str, table))}"
        )
    for name in {"t_n", *wanted} & set(table):
        if not pd.api.types.is_numeric_dtype(table[name]):
            raise CaseError(f"{path}: the column {name} holds something else than numbers")
    return table


def run(
    names: Sequence[str],
    out_dir: Path,
    *,
    experiment: pd.DataFrame | None = None,
    processes: int | None = None,
    quiet: bool = False,
) -> Reproduction:
    """Compute what the figures need and write the report (collective under MPI).

    Args:
        names: Figures, as ``checked_names`` gives them.
        out_dir: The report's folder; it exists.
        experiment: Measured points, as ``read_experiment`` gives them.
        processes: Size of the pool, one a core by default.
        quiet: No progress bar.
    """
    with engine_of(ResultCache(), processes, shown=not quiet) as engine:
        if engine is None:
            return Reproduction("")
        results = compute(engine, {need for name in names for need in FIGURES[name].needs})
        computed = engine.computed
    total = sum(map(len, results.sets.values())) + sum(map(len, results.asked.values()))
    counts = f"It stands on {total} computations."
    page, missing = _write(names, results, experiment, out_dir, counts)
    lines = [f"{total} computations, {computed} of them new: {page}", *missing]
    return Reproduction("\n".join(lines), len(missing))


@style.styled
def _write(
    names: Sequence[str],
    results: Results,
    experiment: pd.DataFrame | None,
    out_dir: Path,
    counts: str,
) -> tuple[Path, list[str]]:
    """Draw what can be drawn; return the page, and a sentence for each figure that cannot."""
    import matplotlib as mpl

    from opticcup_fem.versions import versions

    # the same picture is the same file
    mpl.rcParams["svg.hashsalt"] = "opticcup_fem"
    drawn, missing = [], []
    for name in names:
        try:
            one = FIGURES[name].draw(results, experiment)
        except OpticCupError as error:
            missing.append(f"{name} is not drawn: {error}")
            continue
        one.figure.savefig(out_dir / f"{name}.png")
        one.figure.savefig(out_dir / f"{name}.svg", metadata={"Date": None})
        for table_name, table in one.tables.items():
            write_csv(table, out_dir / f"{table_name}.csv")
        drawn.append(one)
    return write_report(drawn, out_dir, versions(), " ".join([counts, *missing])), missing
