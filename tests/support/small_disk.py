"""A small disk: runs ``opticcup`` with a folder on a file system of a given size.

    unshare --user --map-root-user --mount python3 -m tests.support.small_disk FOLDER BYTES COPY ...

The arguments that follow are those of ``opticcup``.  What is in the folder at the end is copied to
COPY: the file system is gone with the process.  BYTES = 0 mounts one that cannot be written.
"""

import ctypes
import os
import shutil
import subprocess
import sys
from pathlib import Path

READ_ONLY = 1
"""MS_RDONLY of mount(2)."""


def mount(folder: Path, size: int) -> None:
    """Mount an empty file system of ``size`` bytes."""
    flags, options = (0, f"size={size}") if size else (READ_ONLY, "size=1m")
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mount(b"tmpfs", bytes(folder), b"tmpfs", flags, options.encode()):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


if __name__ == "__main__":
    folder, size, copy = Path(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
    mount(folder, size)
    code = subprocess.call([sys.executable, "-m", "opticcup_fem", *sys.argv[4:]])
    shutil.copytree(folder, copy, dirs_exist_ok=True)
    sys.exit(code)
