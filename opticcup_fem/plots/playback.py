"""A run as a movie or a page needs it: its states on a grid, its course, curve and events."""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from opticcup_fem.case import load_case
from opticcup_fem.errors import CaseError
from opticcup_fem.plots.body import QUANTITIES, BodyGrid, Shape, narrow_azimuth
from opticcup_fem.plots.timeline import Course, Moment
from opticcup_fem.records import CASE, read_events, read_path
from opticcup_fem.snapshot import Floats
from opticcup_fem.states import States

if TYPE_CHECKING:
    import pandas as pd

ROUND = 1.02
"""A mouth whose extents differ by less is round: where it is narrowest is chance."""

CUT_ELEVATION, WHOLE_ELEVATION = np.deg2rad(35.0), np.deg2rad(52.0)
"""How high the camera stands: to see into a cut cup; to see the outline of its mouth."""


class Playback:
    """One run to be shown.

    Attributes:
        title: The case in a few words.
        states: Its states.
        path: Their rows.
        stable: Whether each of them is stable, as far as its row says.
        events: Its events, those of what a cup follows.
        course: Its states on the movie's clock.
        grid: Its grid, once prepared.
        shapes: Its states on the grid, once prepared.
        camera: Where the camera stands (rad), once prepared.
        elevation: How high it stands (rad), once prepared.
    """

    grid: BodyGrid
    shapes: list[Shape]
    camera: float
    elevation: float

    def __init__(self, run_dir: str | Path) -> None:
        """Read a run.

        Raises:
            CaseError: The folder holds no states, no rows, or another shape than a cup.
        """
        self.states = States(run_dir)
        if not {"cap", "oov"} <= set(self.states[0].layers):
            raise CaseError(
                f"{run_dir}: movies, pages and pairs show closed cups, shape.kind = cup"
            )
        path = read_path(run_dir)
        # of a whole path, with its unstable parts, only what a cup follows has states
        followed = path[path["followed"].astype(bool)] if "followed" in path else path
        self.path: pd.DataFrame = followed.iloc[: len(self.states)]
        if len(self.path) == 0:
            raise CaseError(f"{run_dir} holds no rows: the run has not come to its first state")
        stable = self.path["stable"] if "stable" in self.path else np.ones(len(self.path))
        self.stable = np.asarray(stable, dtype=bool)
        self.events: list[dict[str, Any]] = [
            event for event in read_events(run_dir) if event.get("followed", True)
        ]
        count = len(self.path)
        positions = [self.states[k].position for k in range(count)]
        gaps = [
            float(np.sqrt(((after - before) ** 2).sum(axis=1).mean()))
            for before, after in pairwise(positions)
        ]
        self.course = Course(self.states.t_n[:count], self.states.jump[:count], gaps)
        self.title = _title(Path(run_dir))

    def prepare(self, *, cut: bool, quantity: str | None, **sizes: int) -> None:
        """Put all states on a grid and choose where the camera stands.

        A mouth that has become a slit is seen across: cut, one of the two walls goes across it;
        whole, it lies from left to right.

        Args:
            cut: Whether a quarter is left out.
            quantity: What to colour by, a key of `QUANTITIES`, or None.
            sizes: Numbers of points of the grid, see `BodyGrid`.
        """
        narrow, ratio = narrow_azimuth(self.states[len(self.path) - 1])
        across = narrow if ratio > ROUND else 0.0
        opening = across - np.pi / 4 if cut else None
        self.camera = across if opening is None else opening
        self.elevation = CUT_ELEVATION if cut else WHOLE_ELEVATION
        self.grid = BodyGrid(self.states[0], opening=opening, quantity=quantity, **sizes)
        self.shapes = [self.grid(self.states[k]) for k in range(len(self.path))]

    def shape(self, moment: Moment) -> Shape:
        """Return the shape at a moment."""
        value, shapes = self.course.value, self.shapes

        def face(region: str) -> Floats:
            return value(moment, lambda k: shapes[k].faces[region])

        def colour(layer: str) -> Floats:
            first = shapes[0].values[layer]
            if not np.isfinite(first).all():  # a layer of which the quantity is not known
                return first
            return value(moment, lambda k: shapes[k].values[layer])

        faces = {region: face(region) for region in shapes[0].faces}
        values = {layer: colour(layer) for layer in shapes[0].values}
        return Shape(faces, values)

    def place(self, moment: Moment) -> tuple[float, float]:
        """Return t_n and D/r at a moment."""
        depth = self.path["D_over_r"].to_numpy()
        return moment.t_n, float(self.course.value(moment, lambda k: depth[k]))


def load_playbacks(run_dirs: Sequence[str | Path], quantity: str | None) -> list[Playback]:
    """Read the runs of a movie or page.

    Raises:
        CaseError: A folder cannot be shown, or the quantity is not known, or not in a run.
    """
    if quantity is not None and quantity not in QUANTITIES:
        raise CaseError(f"{quantity}: layers can be coloured by {', '.join(QUANTITIES)}")
    playbacks = [Playback(run_dir) for run_dir in run_dirs]
    for run_dir, playback in zip(run_dirs, playbacks, strict=True):
        if quantity == "density" and not playback.states[0].growth:
            raise CaseError(
                f"{run_dir} has no density to colour by: no layer of it grows by a mass balance "
                "([mass] in its case)"
            )
    return playbacks


def _title(run_dir: Path) -> str:
    """Return the case in a few words."""
    shape = load_case(run_dir / CASE).shape
    return rf"$R/h$ = {shape.radius_over_thickness:g}, $\alpha$ = {shape.opening_angle_deg:g}°"
