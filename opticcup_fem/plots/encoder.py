"""Movies from frames, by FFmpeg."""

import shutil
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.errors import CaseError, OpticCupError

CODECS: dict[str, list[str]] = {
    # every player knows 4:2:0; the index first lets a browser start before it has all
    ".mp4": ["-c:v", "libx264", "-crf", "18", "-pix_fmt", "yuv420p", "-movflags", "+faststart"],
    ".webm": [
        "-c:v",
        "libvpx-vp9",
        "-crf",
        "28",
        "-b:v",
        "0",
        "-row-mt",
        "1",
        "-pix_fmt",
        "yuv420p",
    ],
    ".gif": ["-vf", "split[a][b];[a]palettegen=stats_mode=diff[p];[b][p]paletteuse=dither=bayer"],
}
"""What FFmpeg is told for each kind of file."""


def check_output(path: Path) -> None:
    """Make sure that a movie can be written before an hour is spent on its frames.

    Raises:
        CaseError: Its kind is unknown, its folder cannot be had, or FFmpeg is not there.
    """
    if path.suffix not in CODECS:
        kinds = ", ".join(CODECS)
        raise CaseError(f"{path}: the kind of movie is told by the name; it must end in {kinds}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CaseError(f"{path}: cannot write there ({error.strerror})") from None
    if shutil.which("ffmpeg") is None:
        raise CaseError(f"{path}: movies are encoded by FFmpeg, which is not installed here")


class Encoder:
    """Takes frames and writes a movie that gets its name once it is complete."""

    def __init__(self, path: Path, width: int, height: int, fps: int) -> None:
        """Start FFmpeg.

        Args:
            path: The movie; its ending is a key of `CODECS`.
            width: Pixels across, even.
            height: Pixels down, even.
            fps: Frames a second.
        """
        self.path, self._unfinished = path, path.with_name(f".{path.name}")
        quiet = ["-hide_banner", "-loglevel", "error", "-y"]
        source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps)]
        self._process = subprocess.Popen(
            ["ffmpeg", *quiet, *source, "-i", "-", *CODECS[path.suffix], str(self._unfinished)],
            stdin=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self._shape = (height, width, 3)

    def __enter__(self) -> Self:
        """Return the encoder."""
        return self

    def add(self, frame: NDArray[np.uint8]) -> None:
        """Add a frame, shape (height, width, 3)."""
        if frame.shape != self._shape:
            raise ValueError(f"a frame has shape {frame.shape}, not {self._shape}")
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(np.ascontiguousarray(frame).tobytes())
        except BrokenPipeError:
            self._finish()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Complete the movie, or leave none after an error."""
        if error is None:
            self._finish()
            self._unfinished.replace(self.path)
        else:
            self._process.kill()
            self._process.communicate()
            self._unfinished.unlink(missing_ok=True)

    def _finish(self) -> None:
        """Wait for FFmpeg; raise its complaint as one sentence."""
        _, said = self._process.communicate()
        if self._process.returncode:
            self._unfinished.unlink(missing_ok=True)
            reason = (said.decode(errors="replace").strip().splitlines() or ["no reason given"])[-1]
            raise OpticCupError(f"{self.path} could not be encoded by FFmpeg: {reason}")
