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
        self._file: int | None = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.release()
            raise CaseError(
                f"{folder} is in use by another run: wait for it, or choose another folder"
            ) from None
        except OSError:  # file systems without locks
            pass

    def release(self) -> None:
        """Give the folder back."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
