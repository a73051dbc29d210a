"""Every demo runs, coarse, and ends at the number that it promises; a few also under mpirun.

Worth reading: what each demo is measured against is a theory or an independent solver, not a record
of what it once gave.
"""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

DEMOS = Path(__file__).parents[2] / "demos"
LAUNCHER = ("OMPI_COMM_WORLD", "PMIX_", "PMI_")
NAMES = sorted(path.stem.removeprefix("demo_") for path in DEMOS.glob("demo_*.py"))

# name in the demo, value, relative tolerance
EXPECTED = {
    "natural_curvature": ("ratio", 1.0, 3e-4),  # (S18)
    "own_tissue": ("kappa", 3.867387e-4, 1e-3),  # a laminate, solved by hand
    "scaling_law": ("a_1", 1.619, 3e-2),  # the independent solver's, over sixteen cups
    "loss_of_symmetry": ("t_b", 0.2829, 2e-3),  # the same
    "chick_cup": ("t_1", 0.0640, 2e-3),  # the same
    "own_geometry": ("round_height", 1.3366, 1e-2),  # the axisymmetric model
}


def test_every_demo_is_expected_to_give_something():
    assert sorted(EXPECTED) == NAMES


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name == "natural_curvature" else pytest.mark.slow)
        for name in NAMES
    ],
)
def test_a_demo_ends_at_its_number(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [f"demo_{name}.py", "--coarse"])
    found = runpy.run_path(str(DEMOS / f"demo_{name}.py"))
    what, value, tolerance = EXPECTED[name]
    assert found[what] == pytest.approx(value, rel=tolerance)
    capsys.readouterr()


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_demo_prints_the_same_on_two_processes(name, tmp_path):
    """Numbers agree in the digits printed, up to the last one."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHER)}
    environment["PYTHONPATH"] = str(DEMOS.parent)
    printed = []
    for launcher in ([], ["mpirun", "-n", "2"]):
        command = [*launcher, sys.executable, str(DEMOS / f"demo_{name}.py"), "--coarse"]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        printed.append([float(n) for n in re.findall(r"(?<![\w.])-?\d+\.\d+", done.stdout)])
    assert len(printed[0]) > 2
    assert printed[1] == pytest.approx(printed[0], rel=2e-3, abs=2e-3)


def test_demos_are_percent_scripts_with_title_and_learning_points():
    for path in DEMOS.glob("demo_*.py"):
        text = path.read_text(encoding="utf-8")
        assert text.startswith("# %% [markdown]\n# # "), path.name
        head = text.split("# %%\n")[0]
        assert "You will learn how" in head.replace("\n# ", " "), path.name
        assert 3 <= len(re.findall(r"^# - ", head, re.MULTILINE)) <= 5, path.name
        assert f"docker/run python3 demos/{path.name} [--coarse]" in head, path.name
