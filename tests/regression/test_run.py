"""Whole runs of coarse cups: what the run folder holds, how runs end, and that ranks agree.

Numbers are those of a coarse mesh; accuracy is tested in tests/verification.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from opticcup_fem.case import load_case
from opticcup_fem.records import read_events, read_path, read_sections
from opticcup_fem.studies import cup
from tests.support.cups import coarse_arguments, coarse_case

CHICK = Path(__file__).parents[2] / "demos" / "chick.toml"


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    summary = cup.run(coarse_case(output={"picture": True}), folder, quiet=True)
    assert summary.ok, summary.message
    return folder


def test_run_folder_is_complete(run_dir: Path) -> None:
    """Every promised file and column; the resolved case reads back as the same case."""
    assert load_case(run_dir / "case.toml") == coarse_case(output={"picture": True})
    path = read_path(run_dir)
    promised = "t_n D_over_r lambda_iov apex_height_over_R max_radius_over_R kappa_cap_R".split()
    assert {*promised, "asymmetry", "jump", "newton_iterations"} <= set(path.columns)
    assert path.t_n.iloc[0] == 0 and path.t_n.iloc[-1] == 0.1
    assert (np.diff(path.t_n) > 0).all()
    assert (run_dir / "summary.png").stat().st_size > 10_000
    assert [s.t_n for s in read_sections(run_dir)] == pytest.approx([0.0, 0.1])
    collection = (run_dir / "fields.pvd").read_text()
    assert collection.count("<DataSet") == 2


def test_chick_invaginates_once_by_t_01(run_dir: Path) -> None:
    """The primary invagination is smooth, near t_n = .064; the cup stays axisymmetric."""
    path = read_path(run_dir)
    assert path.D_over_r.iloc[-1] == pytest.approx(0.376, rel=0.02)
    assert path.lambda_iov.iloc[-1] == pytest.approx(1.284, rel=0.01)
    assert path.asymmetry.max() < 1e-5
    (event,) = read_events(run_dir)
    assert (event["kind"], event["type"]) == ("primary_invagination", "smooth")
    assert event["t_n"] == pytest.approx(0.064, rel=0.03)


def test_field_file_opens_with_layers(run_dir: Path) -> None:
    """A VTK reader finds positions, lambda_3 and stresses of every layer in the last state."""
    pyvista = pytest.importorskip("pyvista")
    grid = pyvista.read(run_dir / "fields" / "0001.vtu")
    names = " ".join(grid.point_data.keys())
    for layer in ("iov", "ecm", "oov"):
        assert f"lambda_3_{layer}" in names and f"stress_{layer}" in names
    assert grid.n_cells > 100


def test_breakdown_is_reported(tmp_path: Path) -> None:
    """The paper's closure with points near the faces loses its root in the inner OOV."""
    case = coarse_case(material={"closure": "paper", "thickness_points": [3, 6, 8]}, t_end=0.2)
    summary = cup.run(case, tmp_path, quiet=True)
    assert not summary.ok
    assert "breaks down" in summary.message and "oov" in summary.message
    (event,) = (e for e in read_events(tmp_path) if e["kind"] == "closure_breakdown")
    assert event["layer"] == "oov" and event["height"] < 0
    assert 0.05 < event["t_n"] < 0.1
    path = read_path(tmp_path)
    assert len(path) > 4 and path.t_n.iloc[-1] < event["t_n"]


def test_evagination_has_no_events(tmp_path: Path) -> None:
    """A soft ECM (n = 10) cannot hold the cap back: no depth, no invagination."""
    case = coarse_case(material={"modulus_ratio": 10.0})
    summary = cup.run(case, tmp_path, quiet=True)
    assert summary.ok and summary.events == []
    assert (read_path(tmp_path).D_over_r == 0).all()


def test_killed_run_keeps_its_rows(tmp_path: Path) -> None:
    """Kill -9 in the middle: every file that is there can be read."""
    command = [sys.executable, "-m", "opticcup_fem", "run", str(CHICK), "--out", str(tmp_path)]
    process = subprocess.Popen(
        [*command, *coarse_arguments()], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    deadline = time.monotonic() + 240
    path = tmp_path / "path.csv"
    while time.monotonic() < deadline:
        if path.exists() and path.read_text().count("\n") >= 4:
            break
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    table = read_path(tmp_path)
    assert len(table) >= 3 and table.D_over_r.notna().all()
    assert isinstance(json.loads((tmp_path / "events.json").read_text()), list)
    assert load_case(tmp_path / "case.toml").shape.radius_over_thickness == 5
