"""Tables of a study: CSV for reading, HDF5 for programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from opticcup_fem.diagram.regimes import regime
from opticcup_fem.studies.sweep.cache import Record
from opticcup_fem.whole_files import new_hdf5, replacing

if TYPE_CHECKING:
    import pandas as pd


def study_table(
    settings: Sequence[Mapping[str, Any]], records: Sequence[Record | None]
) -> pd.DataFrame:
    """Return one row a point: its settings, its regime, its numbers, status and reason.

    Args:
        settings: The keys that vary and their values, for each point.
        records: What was computed; None where nothing is yet.
    """
    import pandas as pd

    rows = []
    for setting, record in zip(settings, records, strict=True):
        shown = {
            key: " ".join(map(str, value)) if isinstance(value, list) else value
            for key, value in setting.items()
        }
        if record is None:
            rows.append({**shown, "status": "pending", "reason": ""})
            continue
        ending = {"status": record["status"], "reason": record.get("reason") or ""}
        rows.append(
            {**shown, "regime": regime({**record["row"], **ending}), **record["row"], **ending}
        )
    table = pd.DataFrame(rows)
    last = [name for name in ("status", "reason") if name in table]
    return table[[name for name in table if name not in last] + last]


def write_csv(table: pd.DataFrame, path: Path) -> Path:
    """Write a table as CSV, floats to the last digit; the file appears whole."""
    with replacing(path) as unfinished:
        table.to_csv(unfinished, index=False, lineterminator="\n")
    return path


def write_hdf5(table: pd.DataFrame, path: Path) -> Path:
    """Write a table as HDF5, one dataset a column; the file appears whole.

    Numbers that are missing are NaN, texts that are missing are empty.
    """
    import h5py
    import pandas as pd

    with new_hdf5(path) as file:
        for name in table:
            column = table[name]
            numbers = pd.to_numeric(column, errors="coerce")
            if bool((numbers.notna() | column.isna()).all()):
                file[str(name)] = numbers.to_numpy(dtype=float)
            else:
                texts = ["" if value is None or value != value else str(value) for value in column]
                file.create_dataset(str(name), data=texts, dtype=h5py.string_dtype())
    return path
