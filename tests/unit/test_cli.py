"""The command line: one line for every error, a telling exit code, one rank that prints.

Worth reading: the table of wrong command lines.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from opticcup_fem import __version__
from opticcup_fem.cli import main
from opticcup_fem.errors import ClosureBreakdown, ConvergenceError

ROOT = Path(__file__).parents[2]
CHICK = str(ROOT / "demos" / "chick.toml")
LAUNCHER = ("OMPI_COMM_WORLD", "PMIX_", "PMI_")


@pytest.fixture(autouse=True)
def no_launcher(monkeypatch, tmp_path):
    """Run in a folder of its own, and as a single process even where pytest runs under mpirun."""
    for name in os.environ:
        if name.startswith(LAUNCHER):
            monkeypatch.delenv(name)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def study(monkeypatch):
    """Stand in for the study: no dolfinx, and every outcome on demand."""
    calls = SimpleNamespace(arguments=None, outcome=SimpleNamespace(ok=True, message="all rows"))

    def run(case, out_dir, *, quiet=False, resume=False):
        calls.arguments = (case, out_dir, quiet)
        if isinstance(calls.outcome, Exception):
            raise calls.outcome
        return calls.outcome

    package, module = ModuleType("opticcup_fem.studies"), ModuleType("opticcup_fem.studies.run")
    module.run, package.run = run, module
    monkeypatch.setitem(sys.modules, package.__name__, package)
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return calls


@pytest.fixture
def invoke(capsys):
    """Run the command line in this process; gives its exit code, output and error output."""

    def call(*arguments):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        captured = capsys.readouterr()
        return SimpleNamespace(
            exit_code=ended.value.code or 0, stdout=captured.out, stderr=captured.err
        )

    return call


# what is typed after `opticcup`, then what the one line must hold
WRONG = {
    "no case": (["run"], ["CASE.toml", "--resume DIR"]),
    "no such file": (["run", "absent.toml"], ["absent.toml", "no such case file"]),
    "a folder": (["theory", "."], ["cannot be read"]),
    "not TOML": (["theory", "broken.toml"], ["broken.toml", "not valid TOML", "line 1"]),
    "unknown key": (["run", CHICK, "--set", "shape.radius=3"], ["did you mean shape.radius_um?"]),
    "unknown table": (["mesh", CHICK, "--set", "mash.seed=3"], ["did you mean mesh?"]),
    "override form": (["run", CHICK, "--set", "seed"], ["table.key=value"]),
    "negative thickness": (["run", CHICK, "--set", "material.thickness_ratio=-1"], ["at least"]),
    "alpha": (["theory", CHICK, "--set", "shape.opening_angle_deg=200"], ["at most 90"]),
    "beyond incompressible": (
        ["run", CHICK, "--set", "material.poisson_ratio=.51"],
        ["at most 0.5"],
    ),
    "no incompressible limit": (
        ["run", CHICK, "--set", "material.poisson_ratio=.5", "--set", "material.closure=paper"],
        ["material.poisson_ratio = 0.5", "layer-stretch"],
    ),
    "closure": (["run", CHICK, "--set", "material.closure=stationary"], ['"layer-stretch"']),
    "unit": (["run", CHICK, "--set", "shape.radius_um=0.05 mm"], ['"0.05 mm"', "micrometres"]),
    "type": (["run", CHICK, "--set", "growth.iov=true"], ["growth.iov = true", "a number"]),
    "model": (["run", CHICK, "--model", "solid"], ['run.model = "solid"', '"surface"']),
    "coarse mesh": (["mesh", CHICK, "--set", "mesh.cell_size_cap=1"], ["too coarse", "0.349"]),
    "times": (["run", CHICK, "--set", "output.times=[2.0]"], ["run.t_end = 1"]),
    "file for a folder": (["run", CHICK, "--out", "broken.toml"], ["cannot write there", "--out"]),
    "below a file": (["run", CHICK, "--out", "broken.toml/x"], ["cannot write there", "--out"]),
    "mesh format": (["mesh", CHICK, "--out", "cup.obj"], ["cup.obj", ".msh"]),
    "mesh below a file": (["mesh", CHICK, "--out", "broken.toml/a.msh"], ["cannot write there"]),
}


WRONG_STUDIES = {
    "no such study": (["sweep", "absent.toml"], ["absent.toml", "no such file"]),
    "study not TOML": (["sweep", "broken.toml"], ["broken.toml", "not valid TOML"]),
    "not a figure": (["reproduce", "fig7"], ["fig7 is not a figure", "fig4"]),
    "no measurements": (
        ["reproduce", "--experiment", "absent.csv"],
        ["absent.csv", "cannot be read"],
    ),
    "thickness": (["predict", "--h", "0"], ["--h = 0", "above 0"]),
    "thicker than wide": (["predict", "--h", "40"], ["radius_over_thickness", "at least 2"]),
}


@pytest.mark.parametrize(("arguments", "parts"), WRONG.values(), ids=WRONG.keys())
def test_wrong_input_gets_one_line_and_code_2(invoke, tmp_path, study, arguments, parts):
    (tmp_path / "broken.toml").write_text("[shape\n", encoding="utf-8")
    result = invoke(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert study.arguments is None
    for part in parts:
        assert part in result.stderr


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write in every folder")
def test_a_read_only_folder_is_refused(invoke, tmp_path, study):
    tmp_path.chmod(0o500)
    result = invoke("run", CHICK, "--out", str(tmp_path / "results"))
    tmp_path.chmod(0o700)
    assert (result.exit_code, study.arguments) == (2, None)
    assert "cannot write there (Permission denied)" in result.stderr


@pytest.mark.parametrize("arguments", [["run", CHICK, "--fast"], ["grow", CHICK], ["theory"]])
def test_wrong_usage_prints_the_usage_and_code_2(invoke, arguments):
    result = invoke(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("Usage: ")


def test_run_hands_over_the_case_and_the_folder(invoke, study, tmp_path):
    result = invoke("run", CHICK, "--set", "run.t_end=0.1", "--model", "surface", "--out", "here")
    assert (result.exit_code, result.stdout) == (0, "all rows\n")
    case, folder, quiet = study.arguments
    assert case.run.t_end == 0.1
    assert folder == Path("here")
    assert (tmp_path / "here").is_dir()
    assert quiet  # not on a terminal
    invoke("run", CHICK)
    assert study.arguments[1] == Path("results/chick")


@pytest.mark.parametrize(("arguments", "parts"), WRONG_STUDIES.values(), ids=WRONG_STUDIES.keys())
def test_wrong_studies_get_one_line_and_code_2(invoke, tmp_path, arguments, parts):
    (tmp_path / "broken.toml").write_text("[shape\n", encoding="utf-8")
    result = invoke(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    for part in parts:
        assert part in result.stderr


@pytest.mark.parametrize(
    "outcome",
    [
        SimpleNamespace(ok=False, message="the surface crosses itself at t_n = 0.284"),
        ConvergenceError("DIVERGED_MAX_IT", 0.4, 17, 12, 3.1e-5),
        ClosureBreakdown("paper", "oov", -0.09, (0.6, 0.0, 0.75), 0.742),
    ],
)
def test_failed_runs_get_one_line_and_code_1(invoke, study, outcome):
    study.outcome = outcome
    result = invoke("run", CHICK)
    assert result.exit_code == 1
    assert (result.stdout, result.stderr.count("\n")) == ("", 1)
    assert getattr(outcome, "message", str(outcome)) in result.stderr


def test_theory_prints_the_prediction(invoke):
    result = invoke("theory", CHICK)
    assert result.exit_code == 0
    assert "normal cup" in result.stdout
    slender = invoke("theory", CHICK, "--set", "shape.radius_over_thickness=15")
    assert "abnormal cup" in slender.stdout


def test_mesh_writes_a_gmsh_file(invoke, tmp_path):
    pytest.importorskip("dolfinx", reason="meshing needs dolfinx and Gmsh")
    coarse = ["cell_size_cap=0.3", "cell_size_oov=0.5", "cell_size_interface=0.3"]
    overrides = [word for size in coarse for word in ("--set", f"mesh.{size}")]
    result = invoke("mesh", CHICK, *overrides, "--out", "folder/cup.msh")
    assert result.exit_code == 0
    assert "folder/cup.msh" in result.stdout and "cap" in result.stdout
    from mpi4py import MPI

    if MPI.COMM_WORLD.rank == 0:  # which alone writes, into its own folder
        assert "$PhysicalNames" in (tmp_path / "folder" / "cup.msh").read_text(encoding="utf-8")


def test_shapes_without_an_oov_have_meshes_but_no_scaling_laws(invoke):
    pytest.importorskip("dolfinx", reason="meshing needs dolfinx and Gmsh")
    disk = ["--set", "shape.kind=disk", "--set", "mesh.cell_size_interface=0.3"]
    assert "rim" in invoke("mesh", CHICK, *disk, "--out", "disk.msh").stdout
    result = invoke("theory", CHICK, *disk)
    assert (result.exit_code, result.stdout) == (2, "")
    assert 'shape.kind = "disk" is not possible: the scaling laws are for' in result.stderr


def test_version_and_help(invoke):
    assert invoke("--version").stdout == f"opticcup_fem {__version__}\n"
    for arguments in (["--help"], ["run", "--help"], ["theory", "--help"], ["mesh", "--help"]):
        result = invoke(*arguments)
        assert result.exit_code == 0
        assert result.stdout.startswith("Usage: opticcup")


@pytest.mark.skipif(shutil.which("mpirun") is None, reason="no mpirun here")
@pytest.mark.skipif(
    any(name.startswith(LAUNCHER) for name in os.environ), reason="mpirun cannot start in itself"
)
def test_under_mpi_one_rank_prints_and_all_exit_alike():
    command = ["mpirun", "-n", "2", sys.executable, "-m", "opticcup_fem"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    wrong = subprocess.run(
        [*command, "run", "absent.toml"], env=environment, capture_output=True, text=True
    )
    assert wrong.returncode == 2
    assert wrong.stderr.count("error: absent.toml: there is no such case file") == 1
    right = subprocess.run(
        [*command, "theory", CHICK], env=environment, capture_output=True, text=True
    )
    assert right.returncode == 0
    assert right.stdout.count("normal cup") == 1
