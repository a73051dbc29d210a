"""Whatever a case file or a study file holds: one sentence or a result, no traceback, no hang."""

import json
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from opticcup_fem.case import case_to_toml, load_case
from opticcup_fem.errors import CaseError
from opticcup_fem.studies.sweep.study_file import load_study
from opticcup_fem.theory import prediction_report
from tests.support import case_texts

ROOT = Path(__file__).parents[2]
CASE = (ROOT / "demos" / "chick.toml").read_text(encoding="utf-8")
STUDY = (ROOT / "demos" / "study.toml").read_text(encoding="utf-8")

HANGS = 60
"""Seconds after which reading a file is a hang and not a slow machine."""

PLAIN = {
    "deadline": None,
    "suppress_health_check": [HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
    "database": None,
}
QUICK = settings(max_examples=60, derandomize=True, **PLAIN)
MANY = settings(max_examples=2000, derandomize=True, **PLAIN)

CASE_FILES = st.tuples(case_texts.files(CASE), st.lists(case_texts.overrides(), max_size=2))
STUDY_FILES = case_texts.study_files(STUDY)


@contextmanager
def no_hang() -> Iterator[None]:
    """Raise where the context takes too long."""

    def hangs(number: int, frame: FrameType | None) -> None:
        raise TimeoutError("a hang")

    before = signal.signal(signal.SIGALRM, hangs)
    signal.alarm(HANGS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def require_sentence(error: CaseError) -> None:
    """Check that an error is one line that a terminal can show."""
    text = str(error)
    assert 10 < len(text) < 2000 and text.isprintable(), text


def read_case(folder: Path, content: bytes, overrides: list[str]) -> None:
    """Read a case; a right one is predicted and comes back from its resolved text."""
    path = folder / "case.toml"
    path.write_bytes(content)
    with no_hang():
        try:
            case = load_case(path, overrides)
        except CaseError as error:
            require_sentence(error)
            return
        path.write_text(case_to_toml(case, {"opticcup_fem": "1"}), encoding="utf-8")
        assert load_case(path) == case
        assert json.loads(case.model_dump_json())
        if case.shape.kind != "cup":
            return
        try:
            assert "nan" not in prediction_report(case)
        except CaseError as error:  # growth or layers that are not uniform
            require_sentence(error)


def read_study(folder: Path, content: bytes) -> None:
    """Read a study: each of its points is a case or has a reason."""
    path = folder / "study.toml"
    path.write_bytes(content)
    (folder / "case.toml").write_text(CASE, encoding="utf-8")
    (folder / "bad.toml").write_text("run = 3\nshape = [1]\n", encoding="utf-8")
    with no_hang():
        try:
            study = load_study(path)
        except CaseError as error:
            require_sentence(error)
            return
    assert all((point.case is None) == bool(point.reason) for point in study.points)


@QUICK
@given(CASE_FILES)
def test_case_files(tmp_path: Path, made_up: tuple[bytes, list[str]]) -> None:
    read_case(tmp_path, *made_up)


@QUICK
@given(STUDY_FILES)
def test_study_files(tmp_path: Path, content: bytes) -> None:
    read_study(tmp_path, content)


@pytest.mark.slow
@MANY
@given(CASE_FILES)
def test_two_thousand_case_files(tmp_path: Path, made_up: tuple[bytes, list[str]]) -> None:
    read_case(tmp_path, *made_up)


@pytest.mark.slow
@MANY
@given(STUDY_FILES)
def test_two_thousand_study_files(tmp_path: Path, content: bytes) -> None:
    read_study(tmp_path, content)
