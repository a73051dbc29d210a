"""Interrupted runs: whatever stops one, it goes on to the path of an undisturbed run."""

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from opticcup_fem.checkpoint import CHECKPOINT, Checkpoint, read_checkpoint, write_checkpoint
from opticcup_fem.errors import CaseError, InterruptedRun, RecordError
from opticcup_fem.records import read_events, read_path
from opticcup_fem.studies import cup, interruption
from tests.support.cups import BETWEEN_PLATES, coarse_case
from tests.support.interrupted import require_same_run, stop_after

CASE = coarse_case(t_end=0.06, output={"times": [0.02, 0.06]})

ACROSS_A_BIFURCATION = coarse_case(
    15.0, 0.32, output={"times": [0.0, 0.1]}, contact={"mode": "stop"}
)
"""Leaves the axisymmetric states along a critical mode near t_n = 0.28."""


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("undisturbed")
    assert cup.run(CASE, folder, quiet=True).ok
    return folder


@pytest.fixture
def interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of a run of CASE that was stopped after its third state."""
    with monkeypatch.context() as patch:
        stop_after(3, patch)
        with pytest.raises(InterruptedRun, match="--resume") as stopped:
            cup.run(CASE, tmp_path, quiet=True)
    assert stopped.value.signal == signal.SIGINT
    return tmp_path


def test_resumed_run_is_the_undisturbed_one(interrupted: Path, undisturbed: Path) -> None:
    """Rows, states, sections and fields; the checkpoint goes when the run is finished."""
    assert len(read_path(interrupted)) == 3
    assert cup.run(CASE, interrupted, quiet=True, resume=True).ok
    require_same_run(interrupted, undisturbed)
    assert not (interrupted / CHECKPOINT).exists()
    with pytest.raises(CaseError, match="nothing to resume: its run is finished"):
        cup.run(CASE, interrupted, quiet=True, resume=True)


def test_contact_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Faces and obstacles as they were kept fixed, not as they would be found again."""
    assert cup.run(BETWEEN_PLATES, tmp_path / "undisturbed", quiet=True).ok
    forces = read_path(tmp_path / "undisturbed").contact_force
    before = int(np.argmax(forces > 0)) + 1
    assert 1 < before < len(forces) - 1
    for states in (before - 1, before):
        folder = tmp_path / str(states)
        with monkeypatch.context() as patch:
            stop_after(states, patch)
            with pytest.raises(InterruptedRun, match="--resume"):
                cup.run(BETWEEN_PLATES, folder, quiet=True)
        assert cup.run(BETWEEN_PLATES, folder, quiet=True, resume=True).ok
        require_same_run(folder, tmp_path / "undisturbed")


def test_records_behind_the_checkpoint_are_cut_off(interrupted: Path, undisturbed: Path) -> None:
    """A run killed after it wrote a state and before its checkpoint, even within a row."""
    with (interrupted / "path.csv").open("a") as file:
        file.write("0.5,1.0,2.")
    for name in ("states/00003.h5", "fields/0007.vtu", "states/.00004.h5", f".{CHECKPOINT}"):
        (interrupted / name).write_bytes(b"half")
    assert cup.run(CASE, interrupted, quiet=True, resume=True).ok
    require_same_run(interrupted, undisturbed)


def test_what_cannot_be_resumed_is_refused(interrupted: Path) -> None:
    """Another case, another layout, no checkpoint at all."""
    with pytest.raises(CaseError, match="another case"):
        cup.run(coarse_case(t_end=0.07), interrupted, quiet=True, resume=True)
    with h5py.File(interrupted / CHECKPOINT, "a") as file:
        file.attrs["format"] = 99
    with pytest.raises(CaseError, match="layout 99"):
        cup.run(CASE, interrupted, quiet=True, resume=True)
    (interrupted / CHECKPOINT).write_bytes(b"not HDF5")
    with pytest.raises(CaseError, match="no checkpoint"):
        cup.run(CASE, interrupted, quiet=True, resume=True)


def test_run_stopped_before_its_first_state_begins_again(tmp_path: Path, undisturbed: Path) -> None:
    """Its folder holds a checkpoint without states, and perhaps nothing else yet."""
    write_checkpoint(tmp_path, Checkpoint(CASE.model_dump_json()))
    with pytest.raises(CaseError, match="another case"):
        cup.run(coarse_case(t_end=0.07), tmp_path, quiet=True, resume=True)
    assert cup.run(CASE, tmp_path, quiet=True, resume=True).ok
    require_same_run(tmp_path, undisturbed)


def test_another_mesh_is_refused(interrupted: Path) -> None:
    """The vertices of the mesh are in the checkpoint."""
    with h5py.File(interrupted / CHECKPOINT, "a") as file:
        file["corners"][0, 0, 0] += 1e-3
    with pytest.raises(CaseError, match="meshed differently"):
        cup.run(CASE, interrupted, quiet=True, resume=True)
    assert len(read_path(interrupted)) == 3


def test_full_disk_keeps_what_was_written(tmp_path: Path, undisturbed: Path) -> None:
    """No file may grow beyond 1 MB: the checkpoint of the third state does not fit any more."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (700_000, before[1]))
    try:
        with pytest.raises(RecordError, match=r"cannot be written .*--resume"):
            cup.run(CASE, tmp_path, quiet=True)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    kept = len(read_checkpoint(tmp_path).numbers["records"]["written"]["rows"])
    assert 1 <= kept <= len(read_path(tmp_path)) <= kept + 1
    assert cup.run(CASE, tmp_path, quiet=True, resume=True).ok
    require_same_run(tmp_path, undisturbed)


def command(folder: Path, *arguments: str) -> subprocess.Popen[str]:
    """Start ``opticcup run`` with the given arguments."""
    line = [sys.executable, "-m", "opticcup_fem", "run", *arguments]
    return subprocess.Popen(line, cwd=folder, stderr=subprocess.PIPE, text=True)


def wait_for_rows(folder: Path, count: int) -> None:
    """Return when path.csv has so many rows."""
    path, deadline = folder / "path.csv", time.monotonic() + 240
    while time.monotonic() < deadline:
        if path.exists() and path.read_text().count("\n") > count:
            return
        time.sleep(0.02)
    raise TimeoutError(f"no {count} rows in {path}")


@pytest.fixture(scope="module")
def case_file(undisturbed: Path) -> str:
    """Return the case file of CASE."""
    return str(undisturbed / "case.toml")


def test_ctrl_c_stops_after_the_step_and_the_folder_is_locked(
    tmp_path: Path, undisturbed: Path, case_file: str
) -> None:
    """Exit code 130, one sentence that names --resume; meanwhile no other run may write there."""
    process = command(tmp_path, case_file, "--out", "run")
    wait_for_rows(tmp_path / "run", 1)
    with pytest.raises(CaseError, match="in use by another run"):
        cup.run(CASE, tmp_path / "run", quiet=True)
    process.send_signal(signal.SIGINT)
    assert "opticcup run --resume run" in process.communicate()[1]
    assert process.returncode == 130
    again = command(tmp_path, "--resume", "run")
    again.communicate()
    assert again.returncode == 0
    require_same_run(tmp_path / "run", undisturbed)


def kill_and_resume(folder: Path, case_file: str, moments: list[float], reference: Path) -> None:
    """Kill a run and what resumes it, each some time after its first row; then let it finish."""
    run = folder / "run"
    for moment in moments:
        resumable = (run / CHECKPOINT).exists()
        process = command(
            folder, *(["--resume", "run"] if resumable else [case_file, "--out", "run"])
        )
        wait_for_rows(run, 0)
        time.sleep(moment)
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
        assert read_path(run).notna().all().t_n
        assert isinstance(read_events(run), list)
        if (run / CHECKPOINT).exists():
            read_checkpoint(run)
    last = command(folder, "--resume", "run")
    message = last.communicate()[1]
    assert last.returncode == 0 or "finished" in message, message
    require_same_run(run, reference)


def test_killed_at_two_random_moments(tmp_path: Path, undisturbed: Path, case_file: str) -> None:
    """Kill -9, then resume, then kill -9 that, then resume."""
    chance = random.Random(9)
    moments = [chance.uniform(0.05, 0.6) for _ in range(2)]
    kill_and_resume(tmp_path, case_file, moments, undisturbed)


@pytest.mark.slow
def test_interrupted_before_and_behind_a_bifurcation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Critical modes, the jump and the events come out as in an undisturbed run."""
    case = ACROSS_A_BIFURCATION
    assert cup.run(case, tmp_path / "undisturbed", quiet=True).ok
    rows = len(read_path(tmp_path / "undisturbed"))
    jump = int(read_path(tmp_path / "undisturbed").jump.argmax())
    assert 0 < jump < rows - 1
    for stop in (jump, jump + 1):
        folder = tmp_path / f"stopped{stop}"
        with monkeypatch.context() as patch:
            stop_after(stop, patch)
            with pytest.raises(InterruptedRun):
                cup.run(case, folder, quiet=True)
        assert cup.run(case, folder, quiet=True, resume=True).ok
        require_same_run(folder, tmp_path / "undisturbed")
        with (
            np.load(folder / "critical.npz") as one,
            np.load(tmp_path / "undisturbed" / "critical.npz") as other,
        ):
            for name in one.files:
                assert one[name].shape == other[name].shape


FOLLOWED = {"axisymmetric": 2, "branch": 14}
"""How many states behind the bifurcation a run is stopped; a chart of a branch has 12."""


@pytest.mark.slow
@pytest.mark.parametrize("follow", FOLLOWED)
def test_other_paths_resume_too(
    follow: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Copies of an unfinished run, made before and behind the loss of symmetry, end like it."""
    case = coarse_case(
        15.0,
        0.36,
        run={"follow": follow},
        solver={"max_step": 0.05},
        output={"times": [0.1], "fields": False},
    )
    folder, behind = tmp_path / "run", FOLLOWED[follow]
    copies: list[Path] = []

    def received(self: object) -> int:
        kinds = [one["kind"] for one in read_events(folder)]
        rows = len(read_path(folder))
        if "symmetry_breaking" not in kinds:
            if read_path(folder).t_n.iloc[-1] > 0.2:
                copies[:] = [Path(shutil.copytree(folder, tmp_path / f"stopped{rows}"))]
        else:
            copies.append(Path(shutil.copytree(folder, tmp_path / f"stopped{rows}")))
        return signal.SIGINT if len(copies) > behind else 0

    monkeypatch.setattr(interruption.StopSignals, "received", received)
    with pytest.raises(InterruptedRun):
        cup.run(case, folder, quiet=True)
    rows = len(read_path(folder))
    for copy in {copies[0], copies[len(copies) // 2], copies[-2]}:
        (copy / ".lock").unlink()
        monkeypatch.setattr(
            interruption.StopSignals,
            "received",
            lambda self, copy=copy: signal.SIGINT if len(read_path(copy)) >= rows else 0,
        )
        with pytest.raises(InterruptedRun):
            cup.run(case, copy, quiet=True, resume=True)
        require_same_run(copy, folder)
