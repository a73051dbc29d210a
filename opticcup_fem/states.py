"""Every state that a run's cup takes, in small HDF5 files: enough to draw or measure any of them.

``states/mesh.h5`` holds what all states of a run share, ``states/00000.h5``, ``00001.h5``, ... one
state each, in the order of path.csv (of a whole path, of its followed rows).  A file appears whole
or not at all, so that whatever ends a run leaves every earlier state readable.

A state keeps positions to the last digit.  What only pictures need (faces, thickness stretches,
stresses, contact) is kept in single precision, the faces as heights over the middle surface.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, overload

import h5py
import numpy as np
from numpy.typing import NDArray

from opticcup_fem.errors import CaseError
from opticcup_fem.snapshot import Floats, Integers, Snapshot, cell_normals
from opticcup_fem.whole_files import new_hdf5

STATES, MESH = "states", "mesh.h5"
FORMAT = 1
"""Number of this layout of the files; readers refuse others."""

_SMALL: dict[str, Any] = {"dtype": "f4", "compression": "gzip", "compression_opts": 4}


class StateWriter:
    """Writes the states of one run, one after the other; lives on one process.

    Attributes:
        count: Number of states written.
    """

    def __init__(self, folder: Path) -> None:
        """Take the folder of the states; it is made with the first of them."""
        self.folder = folder
        self.count = 0

    def keep(self, count: int) -> None:
        """Go on behind the first ``count`` states in the folder; later ones are deleted."""
        self.count = count
        kept = {f"{k:05d}.h5" for k in range(count)} | {MESH}
        for file in self.folder.glob("*.h5"):
            if file.name not in kept:
                file.unlink()

    def __call__(self, snapshot: Snapshot, *, jump: bool = False) -> Path:
        """Write a state, and before the first one what all share; return the state's file.

        Args:
            snapshot: The state, on the mesh of the first.
            jump: Whether the shell jumped onto this state from the one before.
        """
        if self.count == 0:
            self.folder.mkdir(exist_ok=True)
            with new_hdf5(self.folder / MESH) as file:
                _put_mesh(file, snapshot)
        path = self.folder / f"{self.count:05d}.h5"
        with new_hdf5(path) as file:
            file.attrs.update({"format": FORMAT, "t_n": float(snapshot.t_n), "jump": jump})
            _put_state(file, snapshot)
        self.count += 1
        return path


def clear_states(folder: Path) -> None:
    """Delete the files of states in a folder, and the folder if it is empty then."""
    for file in folder.glob("*.h5"):  # unfinished ones, too
        file.unlink()
    if folder.is_dir() and not any(folder.iterdir()):
        folder.rmdir()


def _put_mesh(file: h5py.File, snapshot: Snapshot) -> None:
    file.attrs["format"] = FORMAT
    file["reference"] = snapshot.reference
    for name in ("cells", "region", "orientation"):
        file.create_dataset(name, data=getattr(snapshot, name), compression="gzip")
    for name, number in snapshot.region_ids.items():
        if name in snapshot.layers:
            group = file.create_group(f"regions/{name}")
            group.attrs.update({"id": int(number), "layers": list(snapshot.layers[name])})
    file["regions"].attrs["order"] = list(snapshot.layers)


def _put_state(file: h5py.File, snapshot: Snapshot) -> None:
    file["position"] = snapshot.position
    if snapshot.contact_traction is not None:
        file.create_dataset("contact_traction", data=snapshot.contact_traction, **_SMALL)
    for name, values in snapshot.growth.items():
        file.create_dataset(f"growth/{name}", data=values, **_SMALL)
    normal = cell_normals(snapshot)
    for region, layers in snapshot.layers.items():
        cells = snapshot.cells_of(region)
        offset = snapshot.faces[region] - snapshot.position[snapshot.cells[cells]][:, :, None]
        heights = np.einsum("cnfi,cni->cnf", offset, normal[cells])
        file.create_dataset(f"heights/{region}", data=heights, **_SMALL)
        for layer in layers:
            stretch, stress = snapshot.thickness_stretch[layer], snapshot.stress[layer]
            file.create_dataset(
                f"thickness_stretch/{region}/{layer}", data=stretch[cells], **_SMALL
            )
            file.create_dataset(f"stress/{region}/{layer}", data=stress[cells], **_SMALL)


class States(Sequence[Snapshot]):
    """The states of a run, read from its folder one by one as they are asked for.

    Attributes:
        t_n: Normalised times, shape (n,).
        jump: Whether the shell jumped onto the state from the one before, shape (n,).
    """

    t_n: Floats
    jump: NDArray[np.bool_]

    def __init__(self, run_dir: str | Path) -> None:
        """Find the states of a run, finished or not.

        Raises:
            CaseError: There are none, or their files are of another layout.
        """
        self.folder = Path(run_dir) / STATES
        if not Path(run_dir).is_dir():
            raise CaseError(f"{run_dir}: there is no such run folder")
        self._files: list[Path] = []
        while (file := self.folder / f"{len(self._files):05d}.h5").exists():
            self._files.append(file)
        if not self._files or not (self.folder / MESH).exists():
            raise CaseError(
                f"{run_dir} holds no states: run its case again with output.states = true"
            )
        self._mesh = _read_mesh(self.folder / MESH)
        times, jumps = [], []
        for file in self._files:
            with _opened(file) as opened:
                times.append(float(opened.attrs["t_n"]))
                jumps.append(bool(opened.attrs["jump"]))
        self.t_n, self.jump = np.array(times), np.array(jumps)
        self._read = lru_cache(maxsize=8)(self._read_state)

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self._files)

    @overload
    def __getitem__(self, index: int) -> Snapshot: ...

    @overload
    def __getitem__(self, index: slice) -> list[Snapshot]: ...

    def __getitem__(self, index: int | slice) -> Snapshot | list[Snapshot]:
        """Return a state by its number in the order of path.csv, or several."""
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        return self._read(range(len(self))[index])

    def _read_state(self, index: int) -> Snapshot:
        mesh, layers = self._mesh, self._mesh["layers"]
        with _opened(self._files[index]) as file:
            position = file["position"][:]
            traction = None
            if "contact_traction" in file:
                traction = file["contact_traction"][:].astype(float)
            growth = {name: part[:].astype(float) for name, part in file.get("growth", {}).items()}
            heights = {region: file[f"heights/{region}"][:].astype(float) for region in layers}
            fields = {
                name: {
                    (region, layer): file[f"{name}/{region}/{layer}"][:].astype(float)
                    for region, names in layers.items()
                    for layer in names
                }
                for name in ("thickness_stretch", "stress")
            }
        bare = Snapshot(
            t_n=float(self.t_n[index]),
            position=position,
            thickness_stretch={},
            stress={},
            faces={},
            **mesh,
        )
        normal, faces = cell_normals(bare), {}
        for region, height in heights.items():
            cells = bare.cells_of(region)
            middle = position[bare.cells[cells]]
            faces[region] = middle[:, :, None] + height[..., None] * normal[cells][:, :, None]
        spread = {name: _spread(values, bare) for name, values in fields.items()}
        return Snapshot(
            t_n=bare.t_n,
            position=position,
            thickness_stretch=spread["thickness_stretch"],
            stress=spread["stress"],
            faces=faces,
            contact_traction=traction,
            growth=growth,
            **mesh,
        )


def _spread(values: dict[tuple[str, str], Floats], bare: Snapshot) -> dict[str, Floats]:
    """Return values of a layer in each region's cells as arrays over all cells, NaN elsewhere."""
    spread: dict[str, Floats] = {}
    for (region, layer), part in values.items():
        whole = spread.setdefault(layer, np.full((len(bare.cells), *part.shape[1:]), np.nan))
        whole[bare.cells_of(region)] = part
    return spread


@contextmanager
def _opened(path: Path) -> Iterator[h5py.File]:
    """Open a file for reading, or say in one sentence why it cannot be read."""
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise CaseError(f"{path} cannot be read as HDF5 ({error}): copy the run again") from error
    with file:
        if file.attrs.get("format") != FORMAT:
            raise CaseError(
                f"{path} has layout {file.attrs.get('format')} and layout {FORMAT} is read: use "
                "the version that wrote it (case.toml names it)"
            )
        yield file


def _read_mesh(path: Path) -> dict[str, Any]:
    """Return what all states share, by the names of a snapshot's attributes."""
    with _opened(path) as file:
        regions = file["regions"]
        order = [str(name) for name in regions.attrs["order"]]
        cells: Integers = file["cells"][:]
        return {
            "reference": file["reference"][:],
            "cells": cells,
            "region": file["region"][:],
            "orientation": file["orientation"][:],
            "region_ids": {name: int(regions[name].attrs["id"]) for name in order},
            "layers": {name: tuple(map(str, regions[name].attrs["layers"])) for name in order},
        }
