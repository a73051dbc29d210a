"""Movies of one run, or of two side by side: true thickness, curve, captions, jumps marked.

A movie is drawn in a process of its own, which has a display whatever the machine has.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from opticcup_fem.errors import CaseError
from opticcup_fem.plots.display import draw_apart
from opticcup_fem.plots.encoder import Encoder, check_output
from opticcup_fem.plots.playback import Playback, load_playbacks
from opticcup_fem.plots.timeline import Frame, frames

EVENT_SECONDS = 2.5
"""How long an event's caption stays."""

_SECONDS_A_FRAME = 20.0
"""Drawing takes far less, unless something hangs."""


@dataclass(frozen=True)
class Look:
    """What a movie looks like.

    Attributes:
        quantity: What colours mean: None for layers, or a key of
            `opticcup_fem.plots.body.QUANTITIES`.
        cut: Whether a quarter is cut out.
        turntable: Whether the camera goes once round the cup.
        fps: Frames a second.
        seconds: Length without the jumps.
        size: Width and height in pixels.
    """

    quantity: str | None = None
    cut: bool = True
    turntable: bool = False
    fps: int = 25
    seconds: float = 12.0
    size: tuple[int, int] = (1280, 720)

    def __post_init__(self) -> None:
        """Raise CaseError where a value cannot be used."""
        if not 1 <= self.fps <= 100:
            raise CaseError(f"{self.fps} frames a second: give --fps a number from 1 to 100")
        if not 0 < self.seconds <= 3600:
            raise CaseError(f"{self.seconds:g} seconds: give --seconds a number up to 3600")
        if not all(200 <= pixels <= 8000 for pixels in self.size):
            wide, high = self.size
            raise CaseError(f"{wide}x{high} pixels: give --size both from 200 to 8000")


def movie(run_dirs: Sequence[str | Path], out: str | Path, look: Look | None = None) -> Path:
    """Draw the movie of a run, or of two on one clock.

    Args:
        run_dirs: One or two run folders that hold states.
        out: The movie; its ending, .mp4, .webm or .gif, tells its kind.
        look: What it looks like; by default layers, cut open if it is one run.

    Returns:
        The movie's path.

    Raises:
        CaseError: A folder holds no states, or the movie cannot be written there.
        OpticCupError: It could not be drawn or encoded.
    """
    look = look or Look(cut=len(run_dirs) == 1)
    out = Path(out)
    if len(run_dirs) not in (1, 2):
        raise CaseError(f"a movie shows one run or two side by side, not {len(run_dirs)}")
    playbacks = load_playbacks(run_dirs, look.quantity)
    check_output(out)
    count = len(frames([p.course for p in playbacks], look.seconds, look.fps))
    request = {"runs": [str(p) for p in run_dirs], "out": str(out), "look": asdict(look)}
    draw_apart(__name__, [json.dumps(request)], seconds=600 + _SECONDS_A_FRAME * count)
    return out


def captions(
    playback: Playback, shown: Sequence[Frame], run: int, fps: int
) -> list[dict[str, str]]:
    """Return what is said of a run in each frame.

    Args:
        playback: The run.
        shown: The frames.
        run: Which of the frames' moments is the run's.
        fps: Frames a second.

    Returns:
        For each frame "text", and "alarm" where the shape is no stable equilibrium.
    """
    from opticcup_fem.plots.page import TRANSITION, UNSTABLE
    from opticcup_fem.plots.style import event_label

    moments = [frame.moments[run] for frame in shown]
    times = np.array([moment.t_n for moment in moments])
    said = [""] * len(moments)
    beyond: list[str] = []
    for event in playback.events:
        t_n, label = float(event["t_n"]), event_label(event)
        passed = np.flatnonzero((times[:-1] - t_n) * (times[1:] - t_n) <= 0)
        if len(passed):
            stays = slice(passed[0], passed[0] + max(1, round(EVENT_SECONDS * fps)))
            said[stays] = [label] * len(said[stays])
        elif t_n >= times.max():
            beyond.append(label)
    texts = []
    for label, moment in zip(said, moments, strict=True):
        lines = ["the run has ended", *beyond] if moment.ended else [label]
        between = moment.jump and 0 < moment.along < 1
        at = moment.before + (moment.along == 1)
        unstable = not between and not bool(playback.stable[at])
        lines += [TRANSITION] * between + [UNSTABLE] * unstable
        alarm = {"alarm": "yes"} if between or unstable else {}
        texts.append({"text": "\n".join(line for line in lines if line)} | alarm)
    return texts


def draw(run_dirs: Sequence[str | Path], out: Path, look: Look) -> None:
    """Draw the movie in this process; VTK must find a display or draw off-screen."""
    from opticcup_fem.plots.page import Curve, Page, layout
    from opticcup_fem.plots.style import CURVES

    playbacks = load_playbacks(run_dirs, look.quantity)
    shown = frames([p.course for p in playbacks], look.seconds, look.fps)
    where = layout(look.size, len(playbacks))
    curves = [
        Curve(p.title, p.path, p.events, colour)
        for p, colour in zip(playbacks, CURVES, strict=False)
    ]
    stage = Stage(playbacks, look, [pane[2:] for pane in where.panes])
    page = Page(where, curves, stage.legend)
    texts = [captions(p, shown, k, look.fps) for k, p in enumerate(playbacks)]
    with Encoder(out, *where.size, look.fps) as encoder:
        for number, frame in enumerate(shown):
            if look.turntable:
                stage.turn(2 * np.pi * number / len(shown))
            encoder.add(
                page.frame(
                    stage.images(frame),
                    frame.clock,
                    [p.place(m) for p, m in zip(playbacks, frame.moments, strict=True)],
                    [text[number] for text in texts],
                )
            )
    stage.close()


class Stage:
    """The scenes of the runs, to one scale."""

    def __init__(
        self, playbacks: Sequence[Playback], look: Look, sizes: Sequence[tuple[int, int]]
    ) -> None:
        """Put runs on grids and cameras up.

        Args:
            playbacks: The runs.
            look: What they look like.
            sizes: Width and height of each run's images.
        """
        from opticcup_fem.plots.page import Legend
        from opticcup_fem.plots.scene import Scene, radius_of
        from opticcup_fem.plots.scene_colours import COLOUR_LABELS, COLOUR_MAPS, colour_scale

        self._playbacks, self._last = playbacks, [None] * len(playbacks)
        for playback in playbacks:
            playback.prepare(cut=look.cut, quantity=look.quantity)
        shapes = [shape for p in playbacks for shape in p.shapes]
        scale = None
        if look.quantity is not None:
            scale = colour_scale(look.quantity, [shape.values for shape in shapes])
        radius = radius_of(shapes)
        self._scenes = [
            Scene(p.grid, radius, size, azimuth=p.camera, elevation=p.elevation, scale=scale)
            for p, size in zip(playbacks, sizes, strict=True)
        ]
        layers = tuple(dict.fromkeys(name for p in playbacks for name in reversed(p.grid.layers)))
        quantity = look.quantity or ""
        self.legend = Legend(
            layers, scale, COLOUR_LABELS.get(quantity, ""), COLOUR_MAPS.get(quantity, "")
        )

    def turn(self, angle: float) -> None:
        """Turn the cameras by an angle (rad) from where they began."""
        for scene, playback in zip(self._scenes, self._playbacks, strict=True):
            scene.turn(playback.camera + angle)

    def images(self, frame: Frame) -> list[Any]:
        """Return the image of each run in a frame."""
        return [
            scene.draw(playback.shape(moment), faded=moment.jump and 0 < moment.along < 1)
            for scene, playback, moment in zip(
                self._scenes, self._playbacks, frame.moments, strict=True
            )
        ]

    def close(self) -> None:
        """Take the cameras down."""
        for scene in self._scenes:
            scene.close()


if __name__ == "__main__":
    request = json.loads(sys.argv[1])
    wanted = request["look"] | {"size": tuple(request["look"]["size"])}
    draw(request["runs"], Path(request["out"]), Look(**wanted))
