"""A run folder belongs to one process at a time."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from opticcup_fem.errors import CaseError

LOCK = ".lock"


class FolderLock:
    """Holds a folder until it is released or the process ends, however it ends."""

    def __init__(self, folder: Path) -> None:
        """Take the folder.

        Raises:
            CaseError: Another run is writing there.
            OSError: The folder cannot be written.
        """
        self._path = folder / LOCK
        self._file: int | None = None
        while self._file is None:
            self._file = self._locked(folder)

    def _locked(self, folder: Path) -> int | None:
        """Return the locked file, None if its last holder removed it in the meantime."""
        file = os.open(self._path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            raise CaseError(
                f"{folder} is in use by another run: wait for it, or choose another folder"
            ) from None
        except OSError:  # file systems without locks
            return file
        if _same_file(self._path, file):
            return file
        os.close(file)
        return None

    def release(self) -> None:
        """Give the folder back, without the file."""
        if self._file is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._file)
            self._file = None


def _same_file(path: Path, file: int) -> bool:
    try:
        return os.path.samestat(path.stat(), os.fstat(file))
    except FileNotFoundError:
        return False
