"""What an import loads: the theory needs NumPy only, and help next to nothing."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import opticcup_fem

ROOT = Path(__file__).parents[2]
HEAVY = ("dolfinx", "petsc4py", "mpi4py", "gmsh", "pyvista", "matplotlib")


def loaded_after(code):
    """Return the top-level modules that a fresh interpreter holds after running `code`."""
    # Not as a rank of the MPI job in which the tests may run.
    launcher = ("OMPI_COMM_WORLD", "PMIX_", "PMI_")
    clean = {k: v for k, v in os.environ.items() if not k.startswith(launcher)}
    report = "; import sys; print(' '.join({name.split('.')[0] for name in sys.modules}))"
    result = subprocess.run(
        [sys.executable, "-c", code + report],
        env=clean | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    return set(result.stdout.splitlines()[-1].split())


def test_theory_loads_numpy_only():
    loaded = loaded_after("import opticcup_fem.theory")
    assert "numpy" in loaded
    assert not loaded & {*HEAVY, "scipy", "pydantic", "tomlkit", "typer"}


def test_package_itself_loads_nothing_heavy():
    loaded = loaded_after("import opticcup_fem; opticcup_fem.CaseError; opticcup_fem.theory")
    assert not loaded & {*HEAVY, "pydantic"}


def test_cases_load_no_solver():
    assert not loaded_after("from opticcup_fem import load_case") & {*HEAVY, "numpy"}


@pytest.mark.parametrize("command", ["", "run", "theory", "mesh", "sweep", "reproduce", "predict"])
def test_help_is_light(command):
    arguments = [*([command] if command else []), "--help"]
    code = (
        "import opticcup_fem.cli as cli\n"
        f"try: cli.main({arguments})\n"
        "except SystemExit as ended: assert ended.code == 0\n"
        "pass"
    )
    loaded = loaded_after(code)
    assert not loaded & {*HEAVY, "numpy", "pydantic"}


def test_public_names_load_lazily_and_exist():
    for name in opticcup_fem.__all__:
        assert getattr(opticcup_fem, name) is not None
        assert name in dir(opticcup_fem)
    with pytest.raises(AttributeError, match="no attribute 'absent'"):
        _ = opticcup_fem.absent


def test_citation_has_the_same_version():
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {opticcup_fem.__version__}\n" in citation
