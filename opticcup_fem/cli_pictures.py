"""The commands that show runs: `movie`, `view`, `pair`.  Under mpirun rank 0 draws."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from opticcup_fem.cli_tools import abort_all_ranks_on_a_bug, errors_as_one_line, rank, say
from opticcup_fem.errors import CaseError

RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.", show_default=False)]
RunPaths = Annotated[
    list[Path], typer.Argument(metavar="RUN [RUN]", help="Run folders.", show_default=False)
]
Stretch = Annotated[bool, typer.Option("--lambda3", help="Colour by thickness stretch.")]
Stress = Annotated[bool, typer.Option("--stress", help="Colour by mean in-plane Cauchy stress.")]
Contact = Annotated[bool, typer.Option("--contact", help="Colour by the force of contact.")]
Density = Annotated[bool, typer.Option("--density", help="Colour by density (mass balance).")]
Layers = Annotated[bool, typer.Option("--layers", help="Colour by layer: the default.")]
Cut = Annotated[
    bool | None,
    typer.Option("--cut/--whole", help="Cut a quarter out; default for one run, not for two."),
]


def movie(
    runs: RunPaths,
    output: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help=".mp4, .webm or .gif; default movie.mp4 in the run."),
    ] = None,
    layers: Layers = False,
    lambda3: Stretch = False,
    stress: Stress = False,
    contact: Contact = False,
    density: Density = False,
    cut: Cut = None,
    turntable: Annotated[bool, typer.Option("--turntable", help="Go once round the cup.")] = False,
    fps: Annotated[int, typer.Option(metavar="N", help="Frames a second.")] = 25,
    seconds: Annotated[
        float, typer.Option(metavar="S", help="Length, without the slow motion of jumps.")
    ] = 12.0,
    size: Annotated[str, typer.Option(metavar="WxH", help="Pixels.")] = "1280x720",
) -> None:
    """Draw a movie of a run, or of two side by side.

    Needs the states that a run keeps (output.states). Time goes on at a
    constant rate in t_n; jumps are shown slowly, and marked: their shapes are no equilibria.
    """
    quantity = _quantity(layers, lambda3=lambda3, stress=stress, contact=contact, density=density)

    def draw() -> Path:
        from opticcup_fem.plots.movie import Look
        from opticcup_fem.plots.movie import movie as make
        from opticcup_fem.records import MOVIE

        look = Look(
            quantity=quantity,
            cut=len(runs) == 1 if cut is None else cut,
            turntable=turntable,
            fps=fps,
            seconds=seconds,
            size=_pixels(size),
        )
        return make(runs, runs[0] / MOVIE if output is None else output, look)

    _made(draw)


def view(
    run: RunPath,
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="The page; default view.html in the run."),
    ] = None,
    layers: Layers = False,
    lambda3: Stretch = False,
    stress: Stress = False,
    contact: Contact = False,
    density: Density = False,
    whole: Annotated[bool, typer.Option("--whole", help="Cut nothing out.")] = False,
) -> None:
    """Write an interactive page of a run.

    One file for any browser, without a server or a network: turn the cup, scrub through t_n.
    Needs the states that a run keeps (output.states).
    """
    quantity = _quantity(layers, lambda3=lambda3, stress=stress, contact=contact, density=density)

    def draw() -> Path:
        from opticcup_fem.plots.view import view as make

        return make(run, html, quantity=quantity, cut=not whole)

    _made(draw)


def pair(
    first: RunPath,
    second: RunPath,
    output: Annotated[Path, typer.Option(metavar="FILE.png", help="The picture.")] = Path(
        "pair.png"
    ),
) -> None:
    """Draw two runs side by side, whole and cut open.

    For a movie of both: opticcup movie RUN RUN.
    """

    def draw() -> Path:
        from opticcup_fem.plots.pair import pair as make

        return make([first, second], output)

    _made(draw)


def _made(draw: Callable[[], Path]) -> None:
    """Draw on rank 0 and say where."""
    with errors_as_one_line(), abort_all_ranks_on_a_bug():
        if rank() == 0:
            say(str(draw()))


def _quantity(layers: bool, **quantities: bool) -> str | None:
    """Return what to colour by; the options exclude each other."""
    chosen = [name for name, asked in quantities.items() if asked]
    with errors_as_one_line():
        if layers + len(chosen) > 1:
            options = ", ".join(f"--{name}" for name in ("layers", *quantities))
            raise CaseError(f"{options} exclude each other: give one")
    return chosen[0] if chosen else None


def _pixels(size: str) -> tuple[int, int]:
    """Return the pixels that "1280x720" means."""
    wide, separator, high = size.partition("x")
    if not (separator and wide.isdecimal() and high.isdecimal()):
        raise CaseError(f"--size {size}: give it as pixels across and down, for example 1280x720")
    return int(wide), int(high)
