"""Files that are there wholly or not at all, whatever ends their writing."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import h5py


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield the name under which to write a file, which then takes its place.

    Raises:
        OSError: It cannot be written; the file before, if any, is still there.
    """
    unfinished = path.with_name(f".{path.name}")
    try:
        yield unfinished
        os.replace(unfinished, path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise


def replace_text(path: Path, text: str) -> None:
    """Write a text file, see ``replacing``."""
    with replacing(path) as unfinished:
        unfinished.write_text(text, encoding="utf-8")


@contextmanager
def new_hdf5(path: Path) -> Iterator[h5py.File]:
    """Yield an HDF5 file that is written once it is complete, see ``replacing``.

    It is made in memory: plain system calls write it, which tell why they cannot.

    Raises:
        OSError: It cannot be written; the file before, if any, is still there.
    """
    import h5py

    memory = io.BytesIO()
    with h5py.File(memory, "w") as file:
        yield file
    with replacing(path) as unfinished:
        unfinished.write_bytes(memory.getvalue())
