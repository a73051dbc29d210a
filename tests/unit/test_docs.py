"""What the documents promise exists and runs: commands, links, decisions, every block of code.

Worth reading: `test_every_block_of_a_guide_runs` does, in a fresh folder, what a reader would copy.
"""

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from pathlib import Path

import pytest

import opticcup_fem
from opticcup_fem.cli import app
from opticcup_fem.studies.sweep.study_file import parse_study

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCUMENTS = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "benchmarks/*.md", "meshes/*.md", "docker/*.md")
    for path in ROOT.glob(pattern)
    if not {"_build", "_generated"} & set(path.parts)
)
GUIDES = [
    *(ROOT / "docs" / f"{name}.md" for name in ("tutorial", "python")),
    *sorted((ROOT / "docs" / "howto").glob("*.md")),
]
LINK = re.compile(r"\]\(([^)\s]+)\)")
SUBCOMMANDS = tuple(str(command.callback.__name__) for command in app.registered_commands)
LAUNCHER = ("OMPI_COMM_WORLD", "PMIX_", "PMI_")


def anchors(document: Path) -> set[str]:
    """Return the anchors that GitHub gives to a document's headings."""
    headings = re.findall(r"^#+ (.+)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {heading.replace(" ", "-") for heading in plain}


def code_lines(text: str) -> list[str]:
    """Return the lines of indented and of shell blocks, without their comments."""
    lines = [line[4:] for line in text.splitlines() if line.startswith("    ")]
    for kind, block in blocks(text):
        if kind == "sh":
            lines += block.replace("\\\n", " ").splitlines()
    return [line.split("#")[0].strip() for line in lines]


def blocks(text: str) -> list[tuple[str, str]]:
    """Return language and text of the fenced blocks of code, directives of the site excepted."""
    found = re.findall(r"^```(\w+)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    assert len(found) == len(re.findall(r"^```\w+", text, re.MULTILINE))
    return found


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_relative_links_lead_somewhere(document):
    for target in LINK.findall(document.read_text(encoding="utf-8")):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        linked = (document.parent / name).resolve() if name else document
        assert linked.exists(), f"{document.name} links to {target}"
        if anchor:
            assert anchor in anchors(linked), f"{document.name} links to {target}"


def test_make_targets_of_the_readme_are_in_the_makefile():
    used = {line.split()[1] for line in code_lines(README) if line.startswith("make ")}
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert {"demo", "test"} <= used
    assert used <= set(re.findall(r"^(\w[\w-]*):", makefile, re.MULTILINE))


def test_commands_of_the_documents_name_what_exists():
    commands = [
        shlex.split(line)
        for document in DOCUMENTS
        for line in code_lines(document.read_text(encoding="utf-8"))
        if line.startswith("docker/run ")
    ]
    assert len(commands) > 8
    for command in commands:
        if "opticcup" in command:
            assert command[command.index("opticcup") + 1] in SUBCOMMANDS, command
        for word in command[1:]:
            if word.endswith((".py", ".toml")) and "/" in word and "results/" not in word:
                assert (ROOT / word).exists(), command


def test_settings_of_the_readme_are_keys_of_a_case():
    from opticcup_fem.case import load_case

    settings = re.findall(r"--set (\S+=\S+)", README)
    assert settings
    load_case(ROOT / "demos" / "chick.toml", settings)


def test_decisions_have_unique_numbers_that_their_titles_repeat():
    decisions = sorted((ROOT / "docs" / "decisions").glob("*.md"))
    numbers = [int(path.name[:4]) for path in decisions]
    assert len(set(numbers)) == len(numbers)
    for path in decisions:
        text = path.read_text(encoding="utf-8")
        assert text.startswith(f"# {path.name[:4]} "), path.name
        for part in ("**Question.**", "**Choice.**", "**Evidence.**", "**What would reverse it.**"):
            assert part in text, f"{path.name} lacks {part}"


def test_the_version_is_written_in_one_place_and_its_copies_agree():
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert 'version = { attr = "opticcup_fem.__version__" }' in project
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    releases = re.findall(r"^## (\S+)", changes, re.MULTILINE)
    assert releases[0] == "Unreleased"
    assert releases[1:2] in ([], [opticcup_fem.__version__])
    assert max(Counter(releases).values()) == 1


def test_the_benchmarks_time_functions_that_exist():
    spec = importlib.util.spec_from_file_location("timers", ROOT / "benchmarks" / "timers.py")
    timers = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(timers)
    for places in timers.PLACES.values():
        for place in places:
            owner, name = timers.locate(place)
            assert name in vars(owner), place


@pytest.mark.parametrize("page", GUIDES, ids=lambda path: path.stem)
def test_blocks_of_a_guide_are_of_kinds_that_are_tested(page):
    found = blocks(page.read_text(encoding="utf-8"))
    assert {kind for kind, _ in found} <= {"sh", "python", "toml"}
    for kind, text in found:
        if kind == "python":
            compile(text, page.name, "exec")
        elif kind == "toml":
            assert re.match(r"# \w+\.toml\n", text)
            parse_study(tomllib.loads(text))
        else:
            for line in text.replace("\\\n", " ").splitlines():
                assert line.startswith("docker/run "), line


@pytest.fixture
def reader(tmp_path, monkeypatch):
    """A fresh folder with the demos in it, and the environment of a reader's shell."""
    shutil.copytree(ROOT / "demos", tmp_path / "demos")
    (tmp_path / "docker").symlink_to(ROOT / "docker")
    for name in os.environ:
        if name.startswith(LAUNCHER):
            monkeypatch.delenv(name)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("OPTICCUP_INSIDE", "1")
    monkeypatch.setenv("OPTICCUP_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_blocks(text: str, folder: Path) -> dict[str, object]:
    """Do what a page says, from top to bottom, and return the names of its Python."""
    names: dict[str, object] = {"__name__": "page"}
    for kind, block in blocks(text):
        if kind == "python":
            exec(compile(block, "page", "exec"), names)
        elif kind == "toml":
            (folder / block.split("\n")[0].removeprefix("# ")).write_text(block, encoding="utf-8")
        else:
            command = ["bash", "-euc", block]
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            assert done.returncode == 0, f"{block}\n{done.stdout}\n{done.stderr}"
    return names


@pytest.mark.slow
@pytest.mark.parametrize("page", GUIDES, ids=lambda path: path.stem)
def test_every_block_of_a_guide_runs(page, reader, capfd):
    names = run_blocks(page.read_text(encoding="utf-8"), reader)
    if check := CLAIMS.get(page.stem):
        check(names)


def check_tutorial(names):
    """The depth that it names; and where it says that the border between the fates lies."""
    last = names["path"].iloc[-1]
    assert last["t_n"] == 0.1 and last["D_over_r"] == pytest.approx(0.376, rel=1e-2)
    fates = dict(zip([row["theta_bar"] for row in names["rows"]], names["fates"], strict=True))
    assert max(t for t, fate in fates.items() if fate == "normal") == pytest.approx(2.4, abs=0.05)
    assert min(t for t, f in fates.items() if f == "abnormal") == pytest.approx(2.8, abs=0.05)
    assert Path("results/phase_diagram.png").stat().st_size > 5000


def check_growth(names):
    """Both laws invaginate differently."""
    saturating, patterned = names["depth"]
    assert saturating != patterned


def check_geometry(names):
    """A cap opens as its inner side grows: the rim becomes wider."""
    import numpy as np

    assert names["radius"].mean() > 1.01 * np.sin(np.radians(50))


CLAIMS = {"tutorial": check_tutorial, "growth": check_growth, "geometry": check_geometry}


@pytest.mark.slow
def test_the_python_example_of_the_readme_runs(tmp_path):
    (example,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    (tmp_path / "grow.py").write_text(example, encoding="utf-8")
    shutil.copytree(ROOT / "demos", tmp_path / "demos")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(LAUNCHER)}
    environment["PYTHONPATH"] = str(ROOT)
    command = [sys.executable, "grow.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    last = done.stdout.splitlines()[-1].split()
    # physics of R/h = 10 at t_n = 0.1: D/r = 0.4476, lambda_IOV = 1.3899, both to 0.4 %
    assert [float(value) for value in last[1:]] == pytest.approx([0.1, 0.4476, 1.3899], rel=4e-3)
