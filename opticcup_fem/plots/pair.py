"""Two cups side by side: what the normal one and the buckled one look like at the same times."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from opticcup_fem.errors import CaseError
from opticcup_fem.plots import style
from opticcup_fem.plots.display import draw_apart
from opticcup_fem.plots.playback import Playback, load_playbacks

PAIR = "pair.png"
_PIXELS = (700, 560)


def pair(run_dirs: Sequence[str | Path], out: str | Path = PAIR) -> Path:
    """Draw two runs side by side, to one scale.

    Whole at t_n = 0, half-way through what both have reached, and at the end of each; and the end
    once more, cut open.  Every picture shows an accepted state, the nearest.

    Args:
        run_dirs: The two run folders, with states.
        out: The picture, a .png.

    Raises:
        CaseError: A folder holds no states, or the picture cannot be written there.
        OpticCupError: It could not be drawn.
    """
    out = Path(out)
    if out.suffix != ".png":
        raise CaseError(f"{out}: the side-by-side picture is a PNG; its name must end in .png")
    if len(run_dirs) != 2:
        raise CaseError(f"a pair is two run folders, not {len(run_dirs)}")
    load_playbacks(run_dirs, None)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CaseError(f"{out}: cannot write there ({error.strerror})") from None
    draw_apart(__name__, [json.dumps([*map(str, run_dirs), str(out)])])
    return out


def chosen_states(playbacks: Sequence[Playback]) -> list[list[int]]:
    """Return for each run the numbers of its states at the start, half-way and at its end."""
    common = min(float(p.course.t_n.max()) for p in playbacks)
    times = [0.0, common / 2]
    return [
        [*(int(np.argmin(np.abs(p.course.t_n - t))) for t in times), len(p.course.t_n) - 1]
        for p in playbacks
    ]


@style.styled
def draw(run_dirs: Sequence[str | Path], out: Path) -> None:
    """Draw the picture in this process; VTK must find a display or draw off-screen."""
    from opticcup_fem.plots.scene import Scene, radius_of

    playbacks = load_playbacks(run_dirs, None)
    chosen = chosen_states(playbacks)
    figure = Figure(figsize=(13.0, 6.2), layout="constrained")
    panels = figure.subplots(2, len(chosen[0]) + 1)
    for cut in (False, True):
        for p in playbacks:
            p.prepare(cut=cut, quantity=None)
        radius = radius_of(
            [p.shapes[k] for p, row in zip(playbacks, chosen, strict=True) for k in row]
        )
        for p, numbers, row in zip(playbacks, chosen, panels, strict=True):
            scene = Scene(p.grid, radius, _PIXELS, azimuth=p.camera, elevation=p.elevation)
            columns = slice(-1, None) if cut else slice(0, -1)
            states = numbers[-1:] if cut else numbers
            for axes, k in zip(row[columns], states, strict=True):
                axes.imshow(scene.draw(p.shapes[k]))
                axes.axis("off")
                depth = float(p.path["D_over_r"].iloc[k])
                axes.set_title(rf"$t_n$ = {p.course.t_n[k]:.4f}, $D/r$ = {depth:.3f}")
            scene.close()
    for p, axes in zip(playbacks, panels[:, 0], strict=True):
        axes.text(
            -0.03, 0.5, p.title, transform=axes.transAxes, rotation=90, va="center", ha="right"
        )
    layers = tuple(reversed(playbacks[0].grid.layers))
    figure.legend(
        handles=style.layer_handles(layers), loc="outside lower center", ncols=len(layers)
    )
    style.save(figure, out)


if __name__ == "__main__":
    *folders, picture = json.loads(sys.argv[1])
    draw(folders, Path(picture))
