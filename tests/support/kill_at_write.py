"""``opticcup`` that kills itself at its n-th change of a folder: mid-write, as ``kill -9`` would.

    python -m tests.support.kill_at_write N FOLDER run CASE.toml --out FOLDER

N = 0 prints the number of changes instead.  Python's audit events tell of every file that is
opened to be written, renamed, removed, or cut off, before it happens.
"""

import os
import signal
import sys
from collections.abc import Sequence
from typing import Any

from opticcup_fem.cli import main

CHANGES = {"os.rename", "os.remove", "os.truncate", "os.mkdir", "os.rmdir"}


def watch(folder: str, fatal: int) -> list[int]:
    """Kill this process before its ``fatal``-th change of a folder; return the count so far."""
    count = [0]

    def see(event: str, arguments: Sequence[Any]) -> None:
        written = event == "open" and isinstance(arguments[2], int) and arguments[2] & 3
        if not (event in CHANGES or written) or not isinstance(arguments[0], str | os.PathLike):
            return
        if folder in os.path.abspath(arguments[0]):
            count[0] += 1
            if count[0] == fatal:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(see)
    return count


if __name__ == "__main__":
    count = watch(os.path.abspath(sys.argv[2]), int(sys.argv[1]))
    try:
        main(sys.argv[3:])
    finally:
        print(count[0])
