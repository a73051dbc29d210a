"""Movies, pages and side-by-side pictures of small runs.

What matters: bodies have their true thickness, the frames move and show the layers, what is no
equilibrium is washed out, the file has the frames that were asked for, the page needs no network,
and every wrong request is one sentence.
"""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex

from opticcup_fem.case import case_to_toml, parse_case
from opticcup_fem.errors import CaseError
from opticcup_fem.plots import style
from opticcup_fem.plots.body import BodyGrid, Shape, layer_surfaces, narrow_azimuth
from opticcup_fem.plots.encoder import Encoder
from opticcup_fem.plots.movie import Look, captions, movie
from opticcup_fem.plots.pair import pair
from opticcup_fem.plots.playback import Playback
from opticcup_fem.plots.scene_colours import UNKNOWN, colour_map, colour_scale
from opticcup_fem.plots.timeline import frames
from opticcup_fem.plots.view import view
from opticcup_fem.records import RunFolder
from opticcup_fem.snapshot import Snapshot
from tests.support.shapes import cup, deformed, sphere_mesh, sphere_points
from tests.unit.test_plots import colour_share

SMALL = Look(fps=5, seconds=0.8, size=(401, 300))
EVENT = {"kind": "primary_invagination", "type": "fold", "t_n": 0.5}


def slit(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Return the cup pressed together along the azimuth of 30 degrees."""
    points, across = cup(theta, phi), np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0.0])
    return points - 0.5 * np.outer(points @ across, across)


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    """Return the unit sphere, thickness 0.2, ECM 0.02."""
    return sphere_mesh(0.4)


def made_run(path: Path, states: list[Snapshot]) -> Path:
    """Write a run that jumps onto its last state."""
    with RunFolder(path, case_to_toml(parse_case(""), {})) as folder:
        for k, state in enumerate(states):
            jump = k == len(states) - 1
            folder.write_state(state, jump=jump)
            folder.append({"t_n": state.t_n, "D_over_r": 0.3 * k, "jump": jump})
        folder.write_events([EVENT])
    return path


@pytest.fixture(scope="module")
def run_dir(sphere: Snapshot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a run of a sphere that grows and snaps into a slit."""
    grown = deformed(sphere, lambda t, p: 1.2 * sphere_points(t, p), t_n=0.5)
    buckled = deformed(sphere, slit, t_n=0.51)
    path = tmp_path_factory.mktemp("run")
    return made_run(path, [sphere, grown, buckled])


def video(path: Path) -> tuple[int, int, int]:
    """Return width, height and number of frames, as FFmpeg decodes them."""
    command = ["ffprobe", "-v", "error", "-count_frames", "-select_streams", "v:0"]
    entries = ["-show_entries", "stream=width,height,nb_read_frames", "-of", "json"]
    done = subprocess.run([*command, *entries, str(path)], capture_output=True, check=True)
    (stream,) = json.loads(done.stdout)["streams"]
    return stream["width"], stream["height"], int(stream["nb_read_frames"])


def volume(grid: BodyGrid, shape: Shape, layer: str) -> float:
    """Return the volume inside a layer's skin and walls, which are closed once they are welded."""
    import pyvista as pv

    points = grid.layer_points(shape, layer)
    parts = []
    for surface in layer_surfaces(grid, layer):
        parts.append(
            pv.PolyData.from_regular_faces(points[surface.source], surface.triangles, deep=True)
        )
    whole = parts[0].merge(parts[1]).clean(tolerance=1e-9).triangulate()
    return float(whole.compute_normals(consistent_normals=True, auto_orient_normals=True).volume)


@pytest.mark.parametrize("opening", [None, 0.3])
def test_bodies_have_the_layers_true_thickness(sphere: Snapshot, opening: float | None) -> None:
    """Faces at radii .9, 1.08 and 1.1; three quarters of the shells' volumes where cut open."""
    grid = BodyGrid(sphere, opening=opening)
    shape = grid(sphere)
    radii = np.linalg.norm(shape.faces["cap"], axis=-1)
    np.testing.assert_allclose(radii, np.broadcast_to([0.9, 1.08, 1.1], radii.shape), atol=4e-3)
    share = 1.0 if opening is None else 0.75
    cap = share * 2 * np.pi * (1 - np.cos(np.deg2rad(40))) / 3
    expected = {
        "iov": cap * (1.08**3 - 0.9**3),
        "ecm": cap * (1.1**3 - 1.08**3),
        "oov": (share * 4 * np.pi / 3 - cap) * (1.1**3 - 0.9**3),
    }
    found = {layer: volume(grid, shape, layer) for layer in grid.layers}
    assert found == pytest.approx(expected, rel=0.02)


def test_the_quarter_around_the_opening_is_left_out(sphere: Snapshot) -> None:
    """No point lies nearer to the opening's azimuth than 45 degrees."""
    faces = BodyGrid(sphere, opening=1.0)(sphere).faces["oov"][:, 3:-3]
    away = np.angle(np.exp(1j * (np.arctan2(faces[..., 1], faces[..., 0]) - 1.0)))
    assert np.abs(away).min() == pytest.approx(np.pi / 4, abs=0.01)


def test_values_of_layers_are_on_the_grid(sphere: Snapshot) -> None:
    """Half the trace of the stress, without the shear; the stretch; the size of contact's force."""
    stress = {name: np.array([3.0, -1.0, 9.0]) + 0 * s for name, s in sphere.stress.items()}
    state = replace(sphere, stress=stress)
    values = BodyGrid(sphere, quantity="stress")(state).values
    assert all(np.allclose(v, 1.0) for v in values.values())
    assert set(values) == {"iov", "ecm", "oov"}
    values = BodyGrid(sphere, quantity="lambda3")(state).values
    assert all(np.allclose(v, 1.0) for v in values.values())
    pushed = replace(sphere, contact_traction=np.array([3.0, 0.0, 4.0]) + 0 * sphere.position)
    grid = BodyGrid(sphere, quantity="contact")
    assert all(np.allclose(v, 5.0) for v in grid(pushed).values.values())
    assert all(not v.any() for v in grid(sphere).values.values())


def test_density_is_grey_where_it_is_not_known(sphere: Snapshot) -> None:
    """Of layers with a balance the values, of others none; the scale is that of what is known."""
    rho = np.linspace(0.5, 2.0, len(sphere.cells))[:, None] + 0 * sphere.cells
    rho[sphere.cells_of("oov")] = np.nan
    grid = BodyGrid(sphere, quantity="density")
    values = grid(replace(sphere, growth={"rho_iov": rho})).values
    assert np.isfinite(values["iov"]).all() and np.ptp(values["iov"]) > 0
    assert np.isnan(values["ecm"]).all() and np.isnan(values["oov"]).all()
    scale = colour_scale("density", [values])
    assert values["iov"].min() <= scale.vmin < scale.vmax <= values["iov"].max()
    painted = colour_map("density")(scale(values["oov"].ravel()[:1]))[0, :3]
    assert to_hex(painted) == UNKNOWN


def test_colours_of_stress_tell_its_sign() -> None:
    """No stress is in the middle of the scale, tension above, whatever the run has more of."""
    scale = colour_scale("stress", [{"iov": np.array([-0.5, 0.1]), "ecm": np.array([70.0, 90.0])}])
    assert scale(0.0) == pytest.approx(0.5)
    assert scale(-1.0) < 0.5 < scale(1.0) < scale(50.0) < 1.0


def test_a_slit_is_seen_across(sphere: Snapshot) -> None:
    """Where the mouth is narrowest, and how round it is; a rigid motion changes nothing."""
    state = deformed(sphere, slit)
    narrow, ratio = narrow_azimuth(state)
    assert narrow == pytest.approx(np.pi / 6, abs=0.05)
    assert ratio == pytest.approx(2.0, rel=0.03)
    c, s = np.cos(0.4), np.sin(0.4)
    turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    tilted = narrow_azimuth(replace(state, position=state.position @ turn.T + 3.0))
    assert tilted == pytest.approx((narrow, ratio), abs=1e-6)
    assert narrow_azimuth(sphere)[1] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("ending", [".mp4", ".gif", ".webm"])
def test_every_kind_of_movie_has_its_frames(tmp_path: Path, ending: str) -> None:
    """Seven of them, each of another grey."""
    with Encoder(tmp_path / f"movie{ending}", 64, 48, 5) as encoder:
        for k in range(7):
            encoder.add(np.full((48, 64, 3), 30 * k, dtype=np.uint8))
    assert video(tmp_path / f"movie{ending}") == (64, 48, 7)


def test_movies_have_their_frames(run_dir: Path, tmp_path: Path) -> None:
    """As many as the timeline has, in even size; nothing unfinished is left."""
    out = movie([run_dir], tmp_path / "new/movie.mp4", SMALL)
    expected = len(frames([Playback(run_dir).course], SMALL.seconds, SMALL.fps))
    assert video(out) == (400, 300, expected)
    assert [file.name for file in out.parent.iterdir()] == [out.name]


def test_frames_move_and_show_the_layers(run_dir: Path, tmp_path: Path) -> None:
    """The three layers are in the first and last frame, which differ; the jump's are paler."""
    look = replace(SMALL, size=(800, 600))
    out = movie([run_dir], tmp_path / "movie.mp4", look)
    pattern = tmp_path / "%03d.png"
    subprocess.run(["ffmpeg", "-v", "error", "-i", out, pattern], check=True)
    pictures = sorted(tmp_path.glob("*.png"))
    shown = frames([Playback(run_dir).course], look.seconds, look.fps)
    assert len(pictures) == len(shown)
    for picture in (pictures[0], pictures[-1]):
        for colour in style.LAYER_COLOURS.values():
            assert colour_share(picture, colour) > 2e-3
    between = [k for k, frame in enumerate(shown) if 0 < frame.moments[0].along < 1
               and frame.moments[0].jump]  # fmt: skip
    oov = [colourfulness(pictures[k]) for k in (0, between[len(between) // 2], -1)]
    assert oov[1] < 0.7 * min(oov[0], oov[2])


def colourfulness(picture: Path) -> float:
    """Return the greatest saturation that a hundredth of the image's left half has."""
    from matplotlib.image import imread

    pixels = imread(picture)[:, :400, :3].reshape(-1, 3)
    return float(np.quantile(np.ptp(pixels, axis=1), 0.99))


def test_captions_say_what_is_seen(run_dir: Path) -> None:
    """The event from its time on, the jump while it lasts, the end of a run that ends first."""
    playback = Playback(run_dir)
    shown = frames([playback.course], 2.0, 10)
    said = captions(playback, shown, 0, 10)
    first = next(k for k, text in enumerate(said) if "primary invagination" in text["text"])
    assert shown[first].moments[0].t_n == pytest.approx(0.5, abs=0.06)
    for frame, text in zip(shown, said, strict=True):
        moment = frame.moments[0]
        between = moment.jump and 0 < moment.along < 1
        assert ("no equilibria" in text["text"]) == between == ("alarm" in text)


def test_unstable_states_are_called_so(run_dir: Path) -> None:
    """In the captions of a run whose rows say so, from the unstable state on."""
    playback = Playback(run_dir)
    playback.stable = np.array([True, False, True])
    shown = frames([playback.course], 2.0, 10)
    for frame, text in zip(shown, captions(playback, shown, 0, 10), strict=True):
        moment = frame.moments[0]
        at_second = moment.before == 1 and (moment.along == 0 or not moment.jump)
        assert ("a tissue would not stay" in text["text"]) == at_second


def test_two_runs_in_one_movie_and_one_picture(run_dir: Path, tmp_path: Path) -> None:
    """Side by side, whole; the picture shows both cups' layers."""
    look = replace(SMALL, cut=False, turntable=True, quantity="lambda3")
    assert video(movie([run_dir, run_dir], tmp_path / "two.mp4", look))[:2] == (400, 300)
    picture = pair([run_dir, run_dir], tmp_path / "pair.png")
    for colour in style.LAYER_COLOURS.values():
        assert colour_share(picture, colour) > 1e-3


def test_the_page_is_whole(run_dir: Path, tmp_path: Path) -> None:
    """It loads nothing, and has a frame for each state with that state's points."""
    page = view(run_dir, tmp_path / "page.html").read_text(encoding="utf-8")
    assert not re.search(r"<(script|link|img)[^>]*(src|href)=", page)
    calls = page[page.index("Plotly.newPlot(") :]
    assert len(re.findall(r'"name":"\d+"', calls)) >= 3
    for t_n in ("0.0000", "0.5000", "0.5100"):
        assert f'"label":"{t_n}"' in calls
    assert "after a jump" in calls
    for layer, colour in style.LAYER_COLOURS.items():
        assert layer.upper() in calls and colour in calls


def test_pages_keep_both_ends_of_jumps(run_dir: Path, tmp_path: Path) -> None:
    """Thinned out to two states, the jump's are there."""
    page = view(run_dir, tmp_path / "page.html", most_states=2, quantity="stress")
    labels = re.findall(r'"label":"([\d.]+)"', page.read_text(encoding="utf-8"))
    assert labels == ["0.0000", "0.5000", "0.5100"]


@pytest.mark.parametrize(
    ("request_", "said"),
    [
        (lambda run: movie([run], "movie.avi"), "must end in .mp4, .webm, .gif"),
        (lambda run: movie([run.parent / "absent"], "movie.mp4"), "no such run folder"),
        (lambda run: movie(["absent"], "absent/movie.mp4"), "no such run folder"),
        (lambda run: pair(["absent", run], "absent/pair.png"), "no such run folder"),
        (lambda run: movie([run] * 3, "movie.mp4"), "one run or two"),
        (lambda run: movie([run], run / "path.csv" / "movie.mp4"), "cannot write there"),
        (lambda run: Look(fps=0), "--fps"),
        (lambda run: Look(seconds=-1), "--seconds"),
        (lambda run: Look(size=(10, 10)), "--size"),
        (lambda run: view(run, "page.pdf"), "must end in .html"),
        (lambda run: view(run, run / "path.csv" / "page.html"), "cannot write there"),
        (lambda run: view(run, quantity="strain"), "lambda3, stress"),
        (lambda run: view(run, quantity="density"), "has no density to colour by"),
        (lambda run: pair([run, run], "pair.jpg"), "must end in .png"),
        (lambda run: pair([run], "pair.png"), "not 1"),
    ],
)
def test_wrong_requests_are_one_sentence(
    run_dir: Path, request_: object, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(CaseError, match=re.escape(said)) as caught:
        request_(run_dir)  # type: ignore[operator]
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_other_shapes_than_cups_are_refused(sphere: Snapshot, tmp_path: Path) -> None:
    """A cap of its own has no OOV to draw."""
    cells = sphere.cells_of("cap")
    fields = {"thickness_stretch": sphere.thickness_stretch, "stress": sphere.stress}
    alone = replace(
        sphere,
        cells=sphere.cells[cells],
        region=sphere.region[cells],
        orientation=sphere.orientation[cells],
        layers={"cap": sphere.layers["cap"]},
        faces={"cap": sphere.faces["cap"]},
        **{name: {k: v[cells] for k, v in values.items()} for name, values in fields.items()},
    )
    with pytest.raises(CaseError, match="closed cups"):
        movie([made_run(tmp_path / "run", [alone])], tmp_path / "movie.mp4")


def test_a_missing_encoder_is_said_before_drawing(
    run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(CaseError, match="FFmpeg, which is not installed"):
        movie([run_dir], tmp_path / "movie.mp4")


def test_a_movie_that_fails_leaves_no_file(tmp_path: Path) -> None:
    """Neither a part of it, nor FFmpeg waiting."""
    with pytest.raises(KeyError), Encoder(tmp_path / "movie.mp4", 64, 64, 5) as encoder:
        encoder.add(np.zeros((64, 64, 3), dtype=np.uint8))
        raise KeyError
    with (
        pytest.raises(ValueError, match="frame has shape"),
        Encoder(tmp_path / "movie.mp4", 64, 64, 5) as encoder,
    ):
        encoder.add(np.zeros((64, 63, 3), dtype=np.uint8))
    assert not list(tmp_path.iterdir())
