"""What the documents promise exists: commands, links, numbers of decisions, the Python example.

Worth reading: every line of the README that begins with docker/run is parsed as a shell would.
"""

import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

import opticcup_fem
from opticcup_fem.cli import app

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
DOCUMENTS = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "benchmarks/*.md", "meshes/*.md", "docker/*.md")
    for path in ROOT.glob(pattern)
)
LINK = re.compile(r"\]\(([^)\s]+)\)")
SUBCOMMANDS = tuple(str(command.callback.__name__) for command in app.registered_commands)
LAUNCHER = ("OMPI_COMM_WORLD", "PMIX_", "PMI_")


def anchors(document: Path) -> set[str]:
    """Return the anchors that GitHub gives to a document's headings."""
    headings = re.findall(r"^#+ (.+)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings]
    return {heading.replace(" ", "-") for heading in plain}


def code_lines(text: str) -> list[str]:
    """Return the lines of indented code blocks, without their comments."""
    lines = [line[4:] for line in text.splitlines() if line.startswith("    ")]
    return [line.split("#")[0].strip() for line in lines]


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
    assert used == {"demo", "test"}
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
            if word.endswith((".py", ".toml")) and "/" in word:
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
