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
    "growth_factor": ("fall", 0.062200, 5e-3),  # solved by hand; extremes are at quadrature points
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


@pytest.mark.parametrize("script", sorted(DEMOS.glob("cluster/*")), ids=lambda path: path.name)
def test_cluster_scripts_are_shell(script):
    subprocess.run(["bash", "-n", script], check=True)


@pytest.mark.slow
def test_the_tasks_of_the_job_array_make_up_the_study(tmp_path):
    """Two tasks, each with the variables that SLURM gives it, and then the sweep that gathers."""
    (tmp_path / "docker").symlink_to(DEMOS.parent / "docker")
    (tmp_path / "study.toml").write_text(
        """
        [base.run]
        t_end = 0.02
        max_wavenumber = 2
        [base.output]
        times = [0.02]
        [[axis]]
        key = "shape.radius_over_thickness"
        values = [6, 9, 12]
        """,
        encoding="utf-8",
    )
    environment = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHER)}
    environment |= {
        "OPTICCUP_INSIDE": "1",
        "OPTICCUP_CACHE": str(tmp_path / "cache"),
        "PYTHONPATH": str(DEMOS.parent),
        "SLURM_SUBMIT_DIR": str(tmp_path),
        "SLURM_ARRAY_TASK_COUNT": "2",
        "SLURM_ARRAY_TASK_MIN": "5",
        "SLURM_CPUS_PER_TASK": "1",
        "SLURM_NTASKS": "1",
    }

    def done(*command, **variables):
        result = subprocess.run(
            command, cwd=tmp_path, env=environment | variables, capture_output=True, text=True
        )
        assert result.returncode == 0, result.stderr
        return result.stdout

    script = str(DEMOS / "cluster" / "sweep.slurm")
    points = [
        done("bash", script, "study.toml", SLURM_ARRAY_TASK_ID=task).split(": ")[1]
        for task in ("5", "6")
    ]
    assert [text.split(",")[0] for text in points] == ["2 points", "1 points"]
    gathered = done("docker/run", "opticcup", "sweep", "study.toml")
    assert "3 points, 0 computed, 0 without a result" in gathered


@pytest.mark.slow
def test_a_users_program_is_checked_against_our_types(tmp_path):
    """`py.typed` and the lazy names: a wrong call is found by mypy before it is run."""
    program = tmp_path / "program.py"
    text = """
from opticcup_fem import GrowthState, LinearGrowth, load_case, run, tissue_of
from opticcup_fem.shell.growth import SurfacePoints


def law(t_n: float, points: SurfacePoints) -> GrowthState:
    return GrowthState(1 + t_n, 1.0)


case = load_case("case.toml")
tissue = tissue_of(case).with_growth(iov=law, oov=LinearGrowth(1.5))
rows: int = run(case, "folder", tissue=tissue).rows
"""

    def checked(program_text):
        program.write_text(program_text, encoding="utf-8")
        command = [sys.executable, "-m", "mypy", "--strict", "--config-file", "", str(program)]
        environment = os.environ | {"MYPYPATH": str(DEMOS.parent)}
        return subprocess.run(
            [*command, "--follow-imports=silent", "--ignore-missing-imports"],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
        )

    assert checked(text).returncode == 0, checked(text).stdout
    wrong = checked(text.replace("oov=LinearGrowth(1.5)", "oov=1.5"))
    assert 'incompatible type "float"' in wrong.stdout
