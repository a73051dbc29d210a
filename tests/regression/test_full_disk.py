"""A disk that is full, or cannot be written: one sentence, nothing lost, and the run goes on.

The file systems are real ones of a few hundred kilobytes, mounted for one process.
"""

import subprocess
import sys
from pathlib import Path

import pytest

from opticcup_fem.checkpoint import CHECKPOINT, read_checkpoint
from opticcup_fem.records import read_events, read_path
from opticcup_fem.states import States
from opticcup_fem.studies import cup
from tests.support.cups import coarse_case
from tests.support.interrupted import require_same_run

ROOT = Path(__file__).parents[2]
NAMESPACE = ["unshare", "--user", "--map-root-user", "--mount"]
CASE = coarse_case(t_end=0.04, output={"times": [0.0, 0.02, 0.04], "picture": True})


def can_mount() -> bool:
    """Tell whether this process may mount a file system in a namespace of its own."""
    program = (
        "from tests.support.small_disk import mount\n"
        "from pathlib import Path\n"
        "mount(Path('/mnt'), 1 << 20)"
    )
    try:
        done = subprocess.run(
            [*NAMESPACE, sys.executable, "-c", program], cwd=ROOT, capture_output=True, check=False
        )
    except OSError:
        return False
    return done.returncode == 0


pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not can_mount(), reason="no file system can be mounted here"),
]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("undisturbed")
    assert cup.run(CASE, folder, quiet=True).ok
    return folder


def on_disk(
    tmp_path: Path, size: int, *arguments: str
) -> tuple[subprocess.CompletedProcess[str], Path]:
    """Run ``opticcup`` with ``disk`` in a folder on a small disk; return what is there then."""
    disk, copy = tmp_path / "disk", tmp_path / "copy"
    disk.mkdir()
    line = [*NAMESPACE, sys.executable, "-m", "tests.support.small_disk"]
    done = subprocess.run(
        [*line, str(disk), str(size), str(copy), *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    return done, copy


def require_sentence(done: subprocess.CompletedProcess[str], *parts: str) -> None:
    """Check for one line of error and an exit code other than zero."""
    assert done.returncode in (1, 2), done.stderr
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1, done.stderr
    for part in parts:
        assert part in done.stderr


def size_of(folder: Path) -> int:
    """Return the bytes in a folder."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


@pytest.mark.parametrize("share", [0.002, 0.1, 0.3, 0.5, 0.7, 0.9, 1.05])
def test_run_on_a_disk_that_fills_up(tmp_path: Path, undisturbed: Path, share: float) -> None:
    """Of each size, the share of what the whole run needs, to the last picture."""
    size = int(share * size_of(undisturbed))
    case_file = str(undisturbed / "case.toml")
    run = tmp_path / "disk" / "run"
    done, copy = on_disk(tmp_path, size, "run", case_file, "--out", str(run))
    require_sentence(done, "No space left on device")
    folder = copy / "run"
    print(share, done.stderr.strip(), sorted(p.name for p in folder.iterdir()))
    if not (folder / CHECKPOINT).exists():
        assert share < 0.01
        return
    kept = len(
        read_checkpoint(folder).numbers.get("records", {"written": {"rows": []}})["written"]["rows"]
    )
    if kept:
        assert kept <= len(read_path(folder)) <= kept + 1
        assert len(States(folder)) >= kept
        assert isinstance(read_events(folder), list)
    assert cup.run(CASE, folder, quiet=True, resume=True).ok
    require_same_run(folder, undisturbed)


def test_folder_that_cannot_be_written(tmp_path: Path, undisturbed: Path) -> None:
    case_file = str(undisturbed / "case.toml")
    run = str(tmp_path / "disk" / "run")
    done, copy = on_disk(tmp_path, 0, "run", case_file, "--out", run)
    require_sentence(done, "Read-only file system", "--out")
    assert list(copy.iterdir()) == []


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95])
def test_meridian_run_on_a_disk_that_fills_up(tmp_path: Path, share: float) -> None:
    case_file = tmp_path / "case.toml"
    case_file.write_text(
        '[run]\nmodel = "meridian"\nt_end = 0.05\nmax_wavenumber = 2\n[output]\ntimes = [0, 0.05]\n'
    )
    run = tmp_path / "disk" / "run"
    arguments = ["run", str(case_file), "--out"]
    done = subprocess.run(
        [sys.executable, "-m", "opticcup_fem", *arguments, str(tmp_path / "whole")], check=False
    )
    assert done.returncode == 0
    size = int(share * size_of(tmp_path / "whole"))
    done, copy = on_disk(tmp_path, size, *arguments, str(run))
    require_sentence(done, "No space left on device", "--resume")
    again = subprocess.run(
        [sys.executable, "-m", "opticcup_fem", "run", "--resume", str(copy / "run")], check=False
    )
    assert again.returncode == 0
    assert (copy / "run" / "path.csv").read_text() == (tmp_path / "whole/path.csv").read_text()


@pytest.mark.parametrize("command", ["movie", "view"])
def test_pictures_of_a_run_on_a_full_disk(tmp_path: Path, undisturbed: Path, command: str) -> None:
    place = {"movie": ("--output", "a.mp4"), "view": ("--html", "a.html")}[command]
    extra = ("--seconds", "0.4") if command == "movie" else ()
    out = (place[0], str(tmp_path / "disk" / place[1]))
    done, copy = on_disk(tmp_path, 20_000, command, str(undisturbed), *out, *extra)
    require_sentence(done)
    assert list(copy.iterdir()) == []


def test_study_on_a_full_disk(tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    study.write_text(
        "[base.run]\nt_end = 0.01\nmax_wavenumber = 2\n[base.output]\ntimes = [0.01]\n"
        "[[axis]]\nkey = 'shape.radius_over_thickness'\nvalues = [5]\n"
    )
    done, _ = on_disk(tmp_path, 4096, "sweep", str(study), "--out", str(tmp_path / "disk/a/b"))
    require_sentence(done, "No space left on device")
