"""A display for 3D pictures where there is none.

Some builds of VTK draw through an X server only, and end the whole process where they find none.
So 3D pictures are drawn by a process of their own, under a virtual X server where one is installed.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from opticcup_fem.errors import OpticCupError

_START_SECONDS = 20.0


@contextmanager
def virtual_display() -> Iterator[dict[str, str]]:
    """Yield an environment whose DISPLAY is a virtual X server, ended afterwards.

    Without Xvfb the present environment is yielded: VTK may draw off-screen by itself.
    """
    server = shutil.which("Xvfb")
    if server is None:
        yield dict(os.environ)
        return
    reading, writing = os.pipe()
    command = [server, "-displayfd", str(writing), "-screen", "0", "1600x1200x24"]
    process = subprocess.Popen(
        [*command, "-nolisten", "tcp"],
        pass_fds=[writing],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(writing)
    try:
        with os.fdopen(reading) as answer:
            # the server chooses a free display and writes its number once it is ready
            number = answer.readline().strip()
        yield dict(os.environ) | ({"DISPLAY": f":{number}"} if number else {})
    finally:
        process.terminate()
        process.wait(timeout=_START_SECONDS)


def draw_apart(module: str, arguments: Sequence[str], *, seconds: float = 300.0) -> None:
    """Run ``python -m module arguments`` under a virtual display.

    Raises:
        OpticCupError: It failed or took too long; the sentence holds the last line of what it
            said.
    """
    with virtual_display() as environment:
        try:
            done = subprocess.run(
                [sys.executable, "-m", module, *arguments],
                env=environment | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
                capture_output=True,
                text=True,
                timeout=seconds,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise OpticCupError(f"the 3D picture was not drawn within {seconds:g} s") from error
    if done.returncode:
        said = [line for line in (done.stderr + done.stdout).splitlines() if line.strip()]
        reason = said[-1] if said else f"exit status {done.returncode}"
        raise OpticCupError(
            f"the 3D picture could not be drawn ({reason}): VTK needs Xvfb or a build that draws "
            "off-screen"
        )
