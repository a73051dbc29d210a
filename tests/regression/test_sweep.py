"""A study from the command line: computed once, the same in a pool and under mpirun.

Worth reading: the second run of the same study computes nothing and writes the same bytes.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from opticcup_fem.studies.sweep.meridian_tasks import layers
from opticcup_fem.studies.sweep.tasks import KINDS

ROOT = Path(__file__).parents[2]
LAUNCHER = ("OMPI_COMM_WORLD", "PMIX_", "PMI_")
STUDY = """
[base.run]
t_end = 0.06
max_wavenumber = 2
[base.output]
times = [0.06]
[base.material]
closure = "closed-form"
[[axis]]
key = "material.poisson_ratio"
values = [0.45, 0.49]
[[axis]]
key = "shape.radius_over_thickness"
values = [5, 8]
"""


def opticcup(folder, *arguments, ranks=0):
    launcher = ["mpirun", "-n", str(ranks)] if ranks else []
    environment = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHER)}
    environment |= {"PYTHONPATH": str(ROOT), "OPTICCUP_CACHE": str(folder / "cache")}
    command = [*launcher, sys.executable, "-m", "opticcup_fem", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep")
    (path / "study.toml").write_text(STUDY, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def first(folder):
    return opticcup(folder, "sweep", "study.toml", "--processes", "2", "--out", "first")


def test_points_that_cannot_be_are_rows_and_the_exit_code_says_so(first, folder):
    assert first.returncode == 1
    assert "4 points, 2 computed, 2 without a result" in first.stderr
    table = pd.read_csv(folder / "first" / "sweep.csv")
    assert list(table["status"]) == ["ok", "ok", "failed", "failed"]
    assert table["reason"].iloc[2].startswith("material.poisson_ratio = 0.49 is not possible")
    assert list(table["shape.radius_over_thickness"]) == [5, 8, 5, 8]
    assert table["D_over_r_at_0.06"].iloc[:2].notna().all()


def test_a_repeated_study_costs_nothing_and_writes_the_same(first, folder):
    again = opticcup(folder, "sweep", "study.toml", "--out", "again")
    assert "4 points, 0 computed" in again.stderr
    one, other = ((folder / name / "sweep.csv").read_bytes() for name in ("first", "again"))
    assert one == other


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="no mpirun here")
@pytest.mark.skipif(
    any(name.startswith(LAUNCHER) for name in os.environ), reason="mpirun cannot start in itself"
)
def test_ranks_share_the_work_and_write_the_same(first, folder):
    shutil.rmtree(folder / "cache")
    parallel = opticcup(folder, "sweep", "study.toml", "--out", "mpi", ranks=2)
    assert parallel.returncode == 1
    assert parallel.stderr.count("4 points, 2 computed, 2 without a result") == 1
    one, other = ((folder / name / "sweep.csv").read_bytes() for name in ("first", "mpi"))
    assert one == other


def test_layers_are_described_on_the_followed_part():
    case = {
        "run": {"model": "meridian", "t_end": 0.02},
        "output": {"times": [0.0, 0.02]},
    }
    states = layers(case)["states"]
    assert [state["t_n"] for state in states] == [0.0, 0.02]
    cap = states[1]["regions"]["cap"]
    assert set(cap["stress"]) == {"iov", "ecm"}
    # the IOV grows against the ECM: it is compressed, the ECM stretched, all over the cap
    assert max(cap["stress"]["iov"]) < 0 < min(cap["stress"]["ecm"])
    assert len(cap["stress"]["iov"]) == len(cap["stretch"]["ecm"]) == len(cap["theta"])


def test_kinds_can_be_imported():
    import importlib

    for place in KINDS.values():
        module, name = place.split(":")
        assert callable(getattr(importlib.import_module(module), name))


def test_parts_of_a_job_array_make_up_the_study(first, folder, tmp_path):
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    done = [opticcup(tmp_path, "sweep", "study.toml", "--part", part) for part in ("1/2", "2/2")]
    # closed-form at nu = 0.49 is refused: one point of each part
    for number, one in enumerate(done, 1):
        assert f"part {number} of 2: 2 points, 1 computed, 1 without a result" in one.stderr
    assert list((tmp_path / "results").rglob("sweep.*")) == []
    whole = opticcup(tmp_path, "sweep", "study.toml", "--out", "whole")
    assert "4 points, 0 computed" in whole.stderr
    written = [f / "sweep.csv" for f in (tmp_path / "whole", folder / "first")]
    assert written[0].read_bytes() == written[1].read_bytes()
