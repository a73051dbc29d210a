"""The file from which an interrupted run goes on: ``checkpoint.h5`` in its folder.

A folder has one from the first thing that its run writes there until the run is finished.  It is
written whole under another name and then takes the place of the one before, so that whatever
ends a run leaves a checkpoint that can be read.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from opticcup_fem.errors import CaseError
from opticcup_fem.whole_files import new_hdf5

CHECKPOINT = "checkpoint.h5"
FORMAT = 4
"""Number of this layout of the file; readers refuse others."""


@dataclass(frozen=True)
class Checkpoint:
    """What a run depends on beyond a state.

    Attributes:
        case: The case, as JSON.
        numbers: Numbers and records, as JSON knows them.
        states: Arrays of each state; none for a run that goes on from its beginning.
        corners: Vertices of the mesh's cells, shape (n, 3, 3), to which the arrays belong.
        balance: Arrays of the mass balance, none where there is none.
    """

    case: str
    numbers: Mapping[str, Any] = field(default_factory=dict)
    states: tuple[Mapping[str, NDArray[np.float64]], ...] = ()
    corners: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3, 3)))
    balance: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)


def write_checkpoint(folder: Path, checkpoint: Checkpoint) -> None:
    """Replace a folder's checkpoint.

    Raises:
        OSError: The file cannot be written; the one before is still there.
    """
    with new_hdf5(folder / CHECKPOINT) as file:
        file.attrs["format"] = FORMAT
        file["case"] = checkpoint.case
        file["numbers"] = json.dumps(checkpoint.numbers, default=plain)
        file["corners"] = checkpoint.corners
        for k, arrays in enumerate(checkpoint.states):
            for name, values in arrays.items():
                file[f"states/{k}/{name}"] = values
        file.create_group("balance")
        for name, values in checkpoint.balance.items():
            file[f"balance/{name}"] = values


def read_checkpoint(folder: Path) -> Checkpoint:
    """Return a folder's checkpoint.

    Raises:
        CaseError: There is none, or it cannot be used.
    """
    path = folder / CHECKPOINT
    if not path.exists():
        raise CaseError(
            f"{folder} has no {CHECKPOINT}, so there is nothing to resume: its run is finished, or "
            "never began"
        )
    try:
        with h5py.File(path, "r") as file:
            found = file.attrs.get("format")
            if found != FORMAT:
                raise CaseError(
                    f"{path} is of layout {found}, and this version resumes layout {FORMAT} only: "
                    "resume it with the version named in case.toml, or run the case again"
                )
            states = file.get("states", {})
            return Checkpoint(
                case=file["case"].asstr()[()],
                numbers=json.loads(file["numbers"].asstr()[()]),
                states=tuple(
                    {name: values[()] for name, values in states[str(k)].items()}
                    for k in range(len(states))
                ),
                corners=file["corners"][()],
                balance={name: values[()] for name, values in file["balance"].items()},
            )
    except (OSError, KeyError) as error:
        raise CaseError(f"{path} is no checkpoint of a run ({error}): run its case again") from None


def delete_checkpoint(folder: Path) -> None:
    """Delete a folder's checkpoint, and an unfinished one."""
    for name in (CHECKPOINT, f".{CHECKPOINT}"):
        (folder / name).unlink(missing_ok=True)


def plain(value: Any) -> Any:
    """Return a NumPy value as JSON knows it."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"JSON cannot hold {value!r}")
