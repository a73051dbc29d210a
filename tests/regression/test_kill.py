"""Kill -9 at thirty random moments, half of them in the middle of writing: nothing is lost."""

import random
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import pytest
import pyvista

from opticcup_fem.case import Case, load_case
from opticcup_fem.checkpoint import CHECKPOINT, read_checkpoint
from opticcup_fem.records import SECTIONS, SUMMARY, read_events, read_path, read_sections
from opticcup_fem.states import States
from opticcup_fem.studies import cup
from tests.support.cups import coarse_case
from tests.support.interrupted import require_same_run

ROOT = Path(__file__).parents[2]
SEED = 20
FOLDERS = 15
"""Each is killed twice: its run, and what resumes it."""

CASE = coarse_case(t_end=0.06, output={"times": [0.0, 0.02, 0.06], "picture": True})


def start(folder: Path, arguments: Sequence[str], at_write: int | None) -> subprocess.Popen[str]:
    """Start ``opticcup``, which is to kill itself at a change of ``folder`` or counts them."""
    module = ["opticcup_fem"]
    if at_write is not None:
        module = ["tests.support.kill_at_write", str(at_write), str(folder)]
    return subprocess.Popen(
        [sys.executable, "-m", *module, *arguments],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def killed(folder: Path, arguments: Sequence[str], moment: float | int) -> bool:
    """Kill ``opticcup`` after some seconds or at a change; return False if it ended before."""
    if isinstance(moment, int):
        process = start(folder, arguments, moment)
    else:
        process = start(folder, arguments, None)
        time.sleep(moment)
        process.kill()
    said = process.communicate()
    assert process.returncode in (0, -signal.SIGKILL), said
    return process.returncode != 0


def require_readable(folder: Path, case: Case) -> None:
    """Check that all there is in a folder can be read, by whatever reads it."""
    if (folder / CHECKPOINT).exists():
        saved = read_checkpoint(folder)
        assert saved.case == case.model_dump_json()
    if (folder / "case.toml").exists():
        assert load_case(folder / "case.toml") == case
    if (folder / "events.json").exists():
        assert isinstance(read_events(folder), list)
    path = folder / "path.csv"
    rows = 0
    if path.exists() and path.stat().st_size:
        table = read_path(folder)
        rows = len(table)
        assert path.read_text().endswith("\n") and table.t_n.notna().all()
    if rows:
        assert rows <= len(States(folder)) <= rows + 1
        assert all(state.position.size for state in States(folder))
    if (folder / SECTIONS).exists():
        assert len(read_sections(folder)) <= rows
    if (folder / "fields.pvd").exists():
        reader = pyvista.get_reader(folder / "fields.pvd")
        for t_n in reader.time_values:
            reader.set_active_time_value(t_n)
            assert reader.read()[0].n_cells
    if (folder / SUMMARY).exists():
        assert pyvista.read(folder / SUMMARY).n_points


@pytest.mark.slow
def test_killed_at_thirty_random_moments(tmp_path: Path) -> None:
    """Every folder can be read, its run is resumed, and is the undisturbed one, counts and all."""
    reference, case_file = tmp_path / "undisturbed", tmp_path / "case.toml"
    assert cup.run(CASE, reference, quiet=True).ok
    case_file.write_text((reference / "case.toml").read_text())
    began = time.monotonic()
    process = start(
        tmp_path / "counted", ["run", str(case_file), "--out", f"{tmp_path}/counted"], 0
    )
    writes = int(process.communicate()[0].splitlines()[-1])
    seconds = time.monotonic() - began
    assert process.returncode == 0 and writes > 50
    require_same_run(tmp_path / "counted", reference)
    chance, kills = random.Random(SEED), 0
    for number in range(FOLDERS):
        folder = tmp_path / f"run{number}"
        for _ in range(2):
            begun = (folder / CHECKPOINT).exists()
            arguments = (
                ["--resume", str(folder)] if begun else [str(case_file), "--out", f"{folder}"]
            )
            moment = (
                chance.uniform(0.1, 1.0) * seconds
                if chance.random() < 0.5
                else chance.randrange(1, writes)
            )
            kills += killed(folder, ["run", *arguments], moment)
            require_readable(folder, CASE)
        if (folder / CHECKPOINT).exists() or not (folder / "case.toml").exists():
            resume = (folder / CHECKPOINT).exists()
            assert cup.run(CASE, folder, quiet=True, resume=resume).ok
        require_same_run(folder, reference)
        assert {file.name for file in folder.iterdir()} == {f.name for f in reference.iterdir()}
    print(f"{kills} kills in {2 * FOLDERS} starts; {writes} writes a run")
    assert kills > FOLDERS
