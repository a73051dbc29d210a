"""HDF5 files that are there wholly or not at all."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py


@contextmanager
def new_file(path: Path) -> Iterator[h5py.File]:
    """Yield a file that takes its place, or that of the one before, once it is complete.

    It is made in memory: plain system calls write it, which tell why they cannot.

    Raises:
        OSError: It cannot be written; the one before is still there.
    """
    memory = io.BytesIO()
    with h5py.File(memory, "w") as file:
        yield file
    unfinished = path.with_name(f".{path.name}")
    try:
        unfinished.write_bytes(memory.getbuffer())
        os.replace(unfinished, path)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise
