"""A run on the meridian model leaves the run folder of a run on the surface, and more."""

from __future__ import annotations

import re
from pathlib import Path

import meshio
import numpy as np
import pandas as pd
import pytest

from opticcup_fem.case import Case, parse_case
from opticcup_fem.errors import CaseError, InterruptedRun
from opticcup_fem.meridian.contact import crossing_of, self_crossing
from opticcup_fem.records import read_events, read_path, read_sections
from opticcup_fem.states import States
from opticcup_fem.studies import cup, meridian, verify
from tests.support.interrupted import stop_after
from tests.support.meridians import PROFILES, shell_on


@pytest.fixture(scope="module")
def case() -> Case:
    """R/h = 15 past its snap-through, in which m = 1 is lost and regained."""
    return parse_case(
        {
            "shape": {"radius_over_thickness": 15.0},
            "run": {"model": "meridian", "t_end": 0.05, "max_wavenumber": 2},
            "output": {"times": [0.0, 0.02, 0.05]},
        }
    )


@pytest.fixture(scope="module")
def folder(case: Case, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run")
    summary = meridian.run(case, path, quiet=True)
    assert summary.ok, summary.message
    assert "primary invagination (fold) at t_n = 0.0365" in summary.message
    return path


@pytest.fixture(scope="module")
def rows(folder: Path) -> pd.DataFrame:
    return read_path(folder)


def test_all_branches_are_rows_in_their_order(rows: pd.DataFrame) -> None:
    assert np.all(np.diff(rows.arc_length) > 0)
    assert rows.t_n.iloc[-1] == 0.05
    assert rows.t_n[rows.limit_point].tolist() == pytest.approx(
        [0.03652, 0.02384, 0.02587, 0.01084], rel=2e-3
    )
    # up to the snap, back and forth, and up again
    assert np.sum(rows.t_n == 0.02) == 3


def test_stability_and_counts(rows: pd.DataFrame) -> None:
    counts = rows[["negative_m0", "negative_m1", "negative_m2"]].to_numpy()
    plain = ~rows.limit_point.to_numpy()
    np.testing.assert_array_equal(rows.stable[plain], ~counts[plain].any(axis=1))
    np.testing.assert_array_equal(
        rows.negative_eigenvalues, counts[:, 0] + 2 * counts[:, 1:].sum(axis=1)
    )
    assert set(rows.negative_m0) == {0, 1, 2}
    assert rows.negative_m1.max() == 1


def test_followed_part_snaps_once(rows: pd.DataFrame) -> None:
    followed = rows[rows.followed]
    assert np.all(np.diff(followed.t_n) >= 0)
    assert followed.jump.sum() == 1
    after = followed[followed.jump].iloc[0]
    assert after.t_n >= 0.03652 - 1e-5
    assert after.D_over_r > 0.3
    assert followed.stable.all()


def test_events_sections_modes_and_pictures(folder: Path) -> None:
    events = read_events(folder)
    kinds = [one["kind"] for one in events]
    assert kinds.count("limit_point") == 3
    assert kinds.count("primary_invagination") == 1
    m_1 = [one for one in events if one.get("wavenumber") == 1]
    assert {one["kind"] for one in m_1} == {"symmetry_breaking", "symmetry_regained"}
    assert not any(one["followed"] for one in m_1)
    sections = read_sections(folder)
    assert sections[0].t_n == 0.0
    parts = sections[-1].sections[0].parts
    assert parts["cap"].faces.shape[1:] == (3, 3)
    # the two regions meet, and the shell is about h thick
    np.testing.assert_allclose(parts["cap"].midsurface[-1], parts["oov"].midsurface[0], atol=1e-12)
    thickness = np.linalg.norm(np.ptp(parts["oov"].faces, axis=1), axis=-1)
    assert np.all((thickness > 0.5 / 15) & (thickness < 2 / 15))
    with np.load(folder / "modes.npz") as modes:
        assert modes["amplitude"].shape == (2, *modes["theta"].shape, 3)
        np.testing.assert_allclose(np.abs(modes["amplitude"]).max(axis=(1, 2)), 1.0)
    for picture in ("summary.png", "bifurcation.png"):
        assert (folder / picture).stat().st_size > 10_000


def test_fields_of_every_output_time_and_of_the_critical_modes(folder: Path) -> None:
    for collection, count in (("fields.pvd", 3), ("modes.pvd", 2)):
        files = re.findall(r'timestep="([^"]+)".*file="([^"]+)"', (folder / collection).read_text())
        assert len(files) == count
        for t_n, name in files:
            grid = meshio.read(folder / name)
            assert ("mode" in grid.point_data) == (collection == "modes.pvd")
            if collection == "fields.pvd":
                (row,) = read_path(folder).query(f"followed and t_n == {t_n}").itertuples()
                z = grid.points[:, 2]
                assert np.ptp(z[np.hypot(*grid.points[:, :2].T) < 1e-12]) == pytest.approx(
                    row.apex_height_over_R, rel=1e-9
                )


def test_every_state_that_a_cup_takes_is_kept(folder: Path, rows: pd.DataFrame) -> None:
    """One a followed row, in their order, for movies and pages."""
    states, followed = States(folder), rows[rows["followed"]]
    np.testing.assert_array_equal(states.t_n, followed["t_n"])
    np.testing.assert_array_equal(states.jump, followed["jump"])
    assert 0 < states.jump.sum() < len(states) < len(rows)


def test_eigenvalues_have_the_sign_of_the_counts(rows: pd.DataFrame) -> None:
    """The one nearest to zero is positive where none is negative."""
    for m in range(3):
        nearest, stable = rows[f"eigenvalue_m{m}"], rows[f"negative_m{m}"] == 0
        assert np.all(nearest[stable & ~rows.limit_point] > 0)
        assert (nearest < 0).any() == (~stable & ~rows.limit_point).any()


@pytest.mark.parametrize(("kind", "t_end"), [("cap", 0.01), ("disk", 0.005)])
def test_open_shapes_run_on_the_meridian_alone(kind: str, t_end: float, tmp_path: Path) -> None:
    """R/h = 10: the disk leaves axisymmetry at t_n = 0.0046, the cap at 0.039."""
    case = parse_case(
        {
            "shape": {"kind": kind, "radius_over_thickness": 10.0},
            "run": {"model": "meridian", "t_end": t_end, "max_wavenumber": 2},
            "output": {"times": [t_end], "picture": False},
        }
    )
    summary = meridian.run(case, tmp_path, quiet=True)
    assert summary.ok
    last = read_path(tmp_path).iloc[-1]
    assert last.t_n == t_end
    assert last.stable == (kind == "cap")
    # the cap loses depth, the disk's rim rises
    assert last.depth_over_R == 0.0 if kind == "cap" else last.depth_over_R > 0.1
    assert not [one for one in summary.events if "invagination" in one["kind"]]
    for study in (cup.run, verify.run):
        with pytest.raises(CaseError, match=rf'shape.kind = "{kind}" is not possible'):
            study(case, tmp_path / "other", quiet=True)


def test_a_curve_that_crosses_itself_is_seen() -> None:
    loop = np.array([[0.0, 0], [2, 0], [2, 1], [1, 1], [1, -1]])
    np.testing.assert_allclose(crossing_of(loop), [1.0, 0.0])
    assert crossing_of(loop[:-1]) is None
    shell = shell_on(PROFILES["closed"])
    state = shell.reference_state()
    assert self_crossing(shell, state) is None
    z = state.r[:, 1]
    # the apex pushed down through the bottom
    state.r[:, 1] = np.where(z > 0.5, 0.5 - 6 * (z - 0.5), z)
    assert self_crossing(shell, state) is not None


def test_interrupted_run_starts_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its folder is not lost, can be gone on with, and then holds what a run without a stop has."""
    case = parse_case(
        {
            "run": {"model": "meridian", "t_end": 0.01, "max_wavenumber": 2},
            "output": {"picture": False},
        }
    )
    with monkeypatch.context() as patch:
        stop_after(3, patch)
        with pytest.raises(InterruptedRun, match="--resume"):
            meridian.run(case, tmp_path / "one", quiet=True)
    assert len(read_path(tmp_path / "one")) == 3
    assert meridian.run(case, tmp_path / "one", quiet=True, resume=True).ok
    assert meridian.run(case, tmp_path / "other", quiet=True).ok
    pd.testing.assert_frame_equal(read_path(tmp_path / "one"), read_path(tmp_path / "other"))
    with pytest.raises(CaseError, match="its run is finished"):
        meridian.run(case, tmp_path / "one", quiet=True, resume=True)
