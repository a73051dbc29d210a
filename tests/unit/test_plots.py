"""Pictures of a run.

What matters: they are made from the records alone, jumps are not drawn as smooth lines, sections
show the layers at their true size, and 3D pictures need no display.
"""

import os
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
import pyvista as pv
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread

from opticcup_fem.errors import OpticCupError
from opticcup_fem.events import detect_events
from opticcup_fem.plots import style
from opticcup_fem.plots.compare import compare
from opticcup_fem.plots.curves import branches, draw_path, mark_events, place_of
from opticcup_fem.plots.display import draw_apart, virtual_display
from opticcup_fem.plots.sections import across, bounds, draw_section, key_states
from opticcup_fem.plots.solid import cut_open, layer_solids, solid
from opticcup_fem.plots.summary import summary
from opticcup_fem.records import RunFolder, SectionedState, read_path, read_sections
from opticcup_fem.sections import Meridians
from opticcup_fem.snapshot import Snapshot
from tests.support.paths import recorded_path, stable_branches
from tests.support.shapes import cup, deformed, sphere_mesh, sphere_points


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    """Return the unit sphere, thickness 0.2, ECM 0.02."""
    return sphere_mesh(0.3)


@pytest.fixture(scope="module")
def run_dir(sphere: Snapshot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run: the rows of R/h = 10, two shapes."""
    path = tmp_path_factory.mktemp("run")
    rows = recorded_path(stable_branches(10), max_move=0.15, max_step=0.07, bracket=6e-4, seed=0)
    with RunFolder(path, "") as folder:
        for row in rows:
            folder.append(row | {"lambda_iov": 1 + 0.6 * np.tanh(5 * float(row["t_n"]))})
        for t_n in (0.0, 0.04, 0.0412, 0.5, 1.0):
            state = deformed(sphere, cup if t_n > 0.041 else sphere_points, t_n=t_n)
            folder.write_sections(state)
        folder.write_fields(sphere)
        folder.write_fields(state)
        folder.write_events(detect_events(rows))
    return path


def colour_share(picture: Path, colour: str) -> float:
    """Return the share of pixels of a colour's hue, whatever the light on it."""
    pixels = imread(picture)[..., :3].reshape(-1, 3)
    bright = pixels[pixels.max(axis=1) - pixels.min(axis=1) > 0.1]
    hues = mpl.colors.rgb_to_hsv(bright)[:, 0]
    return float((np.abs(hues - mpl.colors.rgb_to_hsv(to_rgb(colour))[0]) < 0.03).sum()) / len(
        pixels
    )


def test_path_is_cut_at_jumps() -> None:
    """A jump starts a branch with its own row; without the column there is one branch."""
    table = pd.DataFrame({"t_n": [0.0, 0.1, 0.2, 0.3], "jump": [False, False, True, False]})
    assert [list(b["t_n"]) for b in branches(table)] == [[0.0, 0.1], [0.2, 0.3]]
    assert len(branches(table[["t_n"]])) == 1


def test_jumps_are_dashed_and_branches_are_not(run_dir: Path) -> None:
    """One solid line a branch, one dashed line from end to start."""
    table = read_path(run_dir)
    axes = Figure().subplots()
    draw_path(axes, table, "D_over_r", "k")
    solid_lines = [line for line in axes.lines if not line.is_dashed()]
    dashed = [line for line in axes.lines if line.is_dashed()]
    at = int(np.flatnonzero(table["jump"])[0])
    assert [len(line.get_xdata()) for line in solid_lines] == [at, len(table) - at]
    (jump,) = dashed
    np.testing.assert_array_equal(jump.get_ydata(), table["D_over_r"][at - 1 : at + 1])


def test_events_sit_on_the_branch_that_they_end(run_dir: Path) -> None:
    """A fold's marker is at the state before the jump, a smooth event's on the curve."""
    table = read_path(run_dir)
    events = detect_events(table.to_dict(orient="records"))
    at = int(np.flatnonzero(table["jump"])[0])
    c = table["apex_height_over_R"]
    before_jump = (table["t_n"][at - 1], c[at - 1])
    assert place_of(table, "apex_height_over_R", events[0]) == before_jump
    smooth = (events[1]["t_n"], np.interp(events[1]["t_n"], table["t_n"][at:], c[at:]))
    assert place_of(table, "apex_height_over_R", events[1]) == pytest.approx(smooth)
    axes = Figure().subplots()
    mark_events(axes, table, "D_over_r", events, "k")
    assert [line.get_marker() for line in axes.lines] == ["D", "^"]
    at_events = [float(line.get_xdata()[0]) for line in axes.lines]
    assert at_events == pytest.approx([e["t_n"] for e in events], abs=6e-4)


def test_unstable_states_are_drawn_apart_and_events_know_their_part() -> None:
    """On a branch that goes back in t_n a time is passed twice: the event's row tells which."""
    table = pd.DataFrame(
        {
            "t_n": [0.0, 0.2, 0.3, 0.2, 0.1, 0.15],
            "D_over_r": [0.0, 0.2, 0.3, 0.5, 0.6, 0.7],
            "jump": False,
            "stable": [True, True, False, False, True, True],
        }
    )
    axes = Figure().subplots()
    draw_path(axes, table, "D_over_r", "k")
    drawn = [(line.is_dashed(), list(line.get_ydata())) for line in axes.lines]
    assert drawn == [(False, [0.0, 0.2, 0.3]), (True, [0.3, 0.5, 0.6]), (False, [0.6, 0.7])]
    event = {"kind": "symmetry_breaking", "type": "bifurcation", "t_n": 0.25, "row": 2}
    assert place_of(table, "D_over_r", event) == pytest.approx((0.25, 0.25))
    assert place_of(table, "D_over_r", event | {"row": 3}) == pytest.approx((0.25, 0.4))
    assert place_of(table, "D_over_r", event | {"row": 6}) == pytest.approx((0.15, 0.7))
    table.loc[3, "jump"] = True
    assert place_of(table, "D_over_r", event | {"row": 3}) == pytest.approx((0.3, 0.3))


def test_key_states_of_a_path_that_goes_back_are_in_its_order() -> None:
    chosen = key_states(states(0.0, 0.1, 0.2, 0.3, 0.2, 0.1, 0.05, 0.1), [], most=4)
    assert [(key.state.t_n, key.why) for key in chosen] == [
        (0.0, "start"),
        (0.2, ""),
        (0.1, ""),
        (0.1, "end"),
    ]


def states(*times: float) -> list[SectionedState]:
    """Return states that have times only."""
    return [SectionedState(t, ()) for t in times]


@pytest.mark.parametrize(
    ("times", "ranges", "expected"),
    [
        ([0, 0.3, 1], [], {0: "start", 0.3: "", 1: "end"}),
        ([0], [], {0: "start"}),
        (
            [0, 0.1, 0.2, 0.21, 0.3, 0.6, 1],
            [(0.2, 0.21)],
            {
                0: "start",
                0.1: "",
                0.2: "before primary invagination",
                0.21: "after primary invagination",
                0.6: "",
                1: "end",
            },
        ),
        # an event before the first further state: the start stays the start
        ([0, 0.5, 1], [(0.1, 0.1)], {0: "start", 0.5: "after primary invagination", 1: "end"}),
    ],
)
def test_key_states(
    times: list[float], ranges: list[tuple[float, float]], expected: dict[float, str]
) -> None:
    """Start, end, the states around events, and others between them where there is room."""
    events = [{"kind": "primary_invagination", "t_n": r[0], "t_n_range": r} for r in ranges]
    chosen = key_states(states(*times), events)
    assert {key.state.t_n: key.why for key in chosen} == expected


def test_key_states_are_at_most_as_many_as_asked_for() -> None:
    """Many states and events still give six, the end among them."""
    kinds = ("primary_invagination", "secondary_invagination", "symmetry_breaking")
    events = [{"kind": kind, "t_n": 0.2 + 0.2 * k} for k, kind in enumerate(kinds)]
    chosen = key_states(states(*np.linspace(0, 1, 30)), events)
    assert len(chosen) == 6
    assert (chosen[0].why, chosen[-1].why) == ("start", "end")
    assert chosen[1].why == "before primary invagination"


def test_section_shows_layers_at_their_true_size(sphere: Snapshot) -> None:
    """Half the section's area of each layer is that of its part of the annulus."""
    state = SectionedState(0.0, Meridians(sphere, np.arange(8) * np.pi / 4, 200)(sphere))
    axes = Figure().subplots()
    draw_section(axes, state)
    found: dict[tuple[float, ...], float] = {}
    for patch in axes.patches:
        x, y = patch.get_path().vertices[:-1].T
        area = abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2
        colour = patch.get_facecolor()[:3]
        found[colour] = found.get(colour, 0.0) + area
    alpha = np.deg2rad(40)
    expected = {
        to_rgb(style.LAYER_COLOURS["iov"]): alpha * (1.08**2 - 0.9**2),
        to_rgb(style.LAYER_COLOURS["ecm"]): alpha * (1.1**2 - 1.08**2),
        to_rgb(style.LAYER_COLOURS["oov"]): (np.pi - alpha) * (1.1**2 - 0.9**2),
    }
    assert found == pytest.approx(expected, rel=2e-3)
    assert bounds(state) == pytest.approx((1.1, -1.1, 1.1), abs=2e-3)


@pytest.mark.parametrize(
    ("scale", "phi"), [((1.0, 1.0, 1.0), 0.0), ((2.0, 0.5, 1.0), np.pi / 2), ((0.5, 2, 1), 0.0)]
)
def test_sections_go_across_a_slit(
    sphere: Snapshot, scale: tuple[float, float, float], phi: float
) -> None:
    """A round mouth is cut at azimuth 0, a slit across its narrow side."""
    slit = deformed(sphere, lambda t, p: sphere_points(t, p) * scale)
    state = SectionedState(0.0, Meridians(slit, np.arange(8) * np.pi / 4)(slit))
    assert across(state)[0].phi == pytest.approx(phi)


def test_summary_needs_records_only(run_dir: Path) -> None:
    """The picture holds curves and all layers; matplotlib's settings stay the user's."""
    before = dict(mpl.rcParams)
    picture = summary(run_dir)
    assert picture == run_dir / "summary.png"
    assert dict(mpl.rcParams) == before
    assert imread(picture).shape[1] == 1800
    for colour in style.LAYER_COLOURS.values():
        assert colour_share(picture, colour) > 1e-3


def test_summary_of_a_run_that_has_just_begun(tmp_path: Path) -> None:
    """One row, no sections, no events."""
    with RunFolder(tmp_path, "") as folder:
        folder.append({"t_n": 0.0, "D_over_r": 0.0, "lambda_iov": 1.0, "jump": False})
    assert summary(tmp_path).exists()


def test_comparison_with_a_reference(run_dir: Path, tmp_path: Path) -> None:
    """The reference lies grey under the run."""
    table = read_path(run_dir)
    table.assign(D_over_r=table["D_over_r"] + 0.1).to_csv(tmp_path / "reference.csv")
    picture = compare(run_dir, tmp_path / "reference.csv", tmp_path / "picture.png")
    pixels = imread(picture)[..., :3].reshape(-1, 3)
    grey = np.abs(pixels - to_rgb(style.REFERENCE)).max(axis=1) < 0.02
    assert grey.mean() > 1e-3


def test_solids_have_the_layers_volumes(run_dir: Path, sphere: Snapshot) -> None:
    """Shells of the sphere: 2 pi (1 - cos alpha) (b^3 - a^3)/3 in the cap."""
    solids = layer_solids(pv.read(run_dir / "fields" / "0000.vtu"))
    cap = 2 * np.pi * (1 - np.cos(np.deg2rad(40))) / 3
    expected = {
        "iov": cap * (1.08**3 - 0.9**3),
        "ecm": cap * (1.1**3 - 1.08**3),
        "oov": (4 * np.pi / 3 - cap) * (1.1**3 - 0.9**3),
    }
    assert {name: whole.volume for name, whole in solids.items()} == pytest.approx(
        expected, rel=0.01
    )
    assert len(layer_solids(pv.read(run_dir / "fields" / "0001.vtu"))) == 3


def test_a_quarter_is_cut_out(run_dir: Path) -> None:
    """No point of the cut shell has x > 0 and y < 0, and the rest is there."""
    whole = layer_solids(pv.read(run_dir / "fields" / "0000.vtu"))["oov"]
    for proud in (0.0, 0.05):
        points = cut_open(whole, proud).points
        assert not ((points[:, 0] > proud + 1e-6) & (points[:, 1] < -proud - 1e-6)).any()
        assert points[:, 0].max() > 1
        assert points[:, 1].min() < -1
    assert points[points[:, 1] < -0.06, 0].max() == pytest.approx(0.05, abs=1e-6)


def test_solid_picture_without_a_display(
    run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The 3D picture shows all three layers, also where DISPLAY is unset."""
    monkeypatch.delenv("DISPLAY", raising=False)
    picture = solid(run_dir, out=tmp_path / "cup.png")
    for colour in style.LAYER_COLOURS.values():
        assert colour_share(picture, colour) > 2e-3


def test_virtual_display_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """The server is gone afterwards, also after an error; without one nothing changes."""
    with pytest.raises(KeyError), virtual_display() as environment:
        socket = Path(f"/tmp/.X11-unix/X{environment['DISPLAY'].removeprefix(':')}")
        assert socket.exists()
        raise KeyError
    assert not socket.exists()
    monkeypatch.setenv("PATH", "/nowhere")
    with virtual_display() as environment:
        assert environment == dict(os.environ)


def test_failure_of_the_drawing_process_is_one_sentence() -> None:
    """What the process said last is in the message."""
    with pytest.raises(OpticCupError, match="No module named no_such_module"):
        draw_apart("no_such_module", [])


@pytest.mark.parametrize("name", ["iov", "gel"])
def test_layers_of_any_name_have_colours(name: str) -> None:
    """Known layers keep theirs, others get distinct spare ones."""
    known = ("iov", "gel", "sol")
    colours = {layer: style.layer_colour(layer, known) for layer in known}
    assert len(set(colours.values())) == 3
    assert colours["iov"] == style.LAYER_COLOURS["iov"]
    assert colours[name] in (*style.LAYER_COLOURS.values(), *style.SPARE_COLOURS)


def test_sections_of_the_run_are_read_for_the_picture(run_dir: Path) -> None:
    """The states around the first event are among those shown."""
    events: list[dict[str, Any]] = [
        {"kind": "primary_invagination", "t_n": 0.0409, "t_n_range": [0.0405, 0.0411]}
    ]
    shown = key_states(read_sections(run_dir), events)
    assert [key.why for key in shown] == [
        "start",
        "before primary invagination",
        "after primary invagination",
        "",
        "end",
    ]
