"""The run folder.

What matters: rows are on disk the moment they are appended, and to the last digit; nothing of a
user's is overwritten without being asked for; what is read is what was written.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from opticcup_fem.errors import CaseError
from opticcup_fem.records import RunFolder, read_events, read_path, read_sections
from opticcup_fem.sections import meridian
from opticcup_fem.snapshot import Snapshot
from tests.support.shapes import cup, deformed, sphere_mesh

ROW = {"t_n": 0.1 + 0.2, "D_over_r": 1 / 3, "jump": False, "newton_iterations": 4}


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    """Return the unit sphere on coarse cells."""
    return sphere_mesh(0.4)


def test_rows_are_flushed_as_they_come(tmp_path: Path) -> None:
    """Another reader sees each row before the next one is written."""
    with RunFolder(tmp_path / "run", "a = 1\n") as folder:
        for count in (1, 2, 3):
            folder.append(ROW | {"t_n": count / 7})
            table = read_path(tmp_path / "run")
            assert list(table["t_n"]) == [k / 7 for k in range(1, count + 1)]


def test_numbers_survive_to_the_last_digit(tmp_path: Path) -> None:
    """Floats, integers and truth values come back exactly, NumPy's too."""
    row = ROW | {"value": np.float64(2) / 3, "flag": np.bool_(True), "count": np.int64(3)}
    with RunFolder(tmp_path, "") as folder:
        folder.append(row)
    back = read_path(tmp_path).iloc[0].to_dict()
    assert back == row
    assert (tmp_path / "path.csv").read_text().splitlines()[1].split(",")[2] == "false"


def test_columns_keep_the_first_rows_order(tmp_path: Path) -> None:
    """A later row in another order lands in the right columns."""
    with RunFolder(tmp_path, "") as folder:
        folder.append(ROW)
        folder.append(dict(reversed(ROW.items())))
    table = read_path(tmp_path)
    assert list(table.columns) == list(ROW)
    assert table.iloc[0].equals(table.iloc[1])


@pytest.mark.parametrize("row", [ROW | {"new": 1}, {"t_n": 0.0}])
def test_rows_with_other_columns_are_refused(tmp_path: Path, row: dict[str, float]) -> None:
    """A column too many or too few is an error, and writes nothing."""
    with RunFolder(tmp_path, "") as folder:
        folder.append(ROW)
        with pytest.raises(ValueError, match="other columns"):
            folder.append(row)
    assert len(read_path(tmp_path)) == 1


def test_case_text_is_kept(tmp_path: Path) -> None:
    """case.toml says what it was given."""
    RunFolder(tmp_path / "deep" / "run", "# µm\nx = 1\n").close()
    text = (tmp_path / "deep" / "run" / "case.toml").read_text(encoding="utf-8")
    assert text == "# µm\nx = 1\n"


def test_earlier_runs_are_not_overwritten(tmp_path: Path) -> None:
    """A folder that holds a run is refused and stays as it is."""
    with RunFolder(tmp_path, "first") as folder:
        folder.append(ROW)
    with pytest.raises(CaseError, match="already holds a run"):
        RunFolder(tmp_path, "second")
    assert (tmp_path / "case.toml").read_text() == "first"
    assert len(read_path(tmp_path)) == 1


def test_overwriting_deletes_the_runs_records_only(tmp_path: Path, sphere: Snapshot) -> None:
    """Fields, sections and rows of the earlier run go; a user's file stays."""
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "figure.png").write_text("mine")
    with RunFolder(tmp_path, "first") as folder:
        folder.append(ROW)
        folder.write_fields(sphere)
        folder.write_sections(sphere)
    RunFolder(tmp_path, "second", overwrite=True).close()
    left = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    assert left == {"notes.txt", "figure.png", "case.toml", "path.csv", "events.json"}
    assert (tmp_path / "path.csv").read_text() == ""


def test_folders_that_cannot_be_written_are_one_sentence(tmp_path: Path) -> None:
    """A file in the folder's place is named, with the reason."""
    (tmp_path / "taken").write_text("")
    for path in (tmp_path / "taken", tmp_path / "taken" / "run", Path("/proc/run")):
        with pytest.raises(CaseError, match="cannot be written") as caught:
            RunFolder(path, "")
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_events_are_replaced_whole(tmp_path: Path) -> None:
    """The list is there from the start, NumPy numbers are plain, and no part files stay."""
    with RunFolder(tmp_path, "") as folder:
        assert read_events(tmp_path) == []
        folder.write_events([{"kind": "self_contact", "t_n": np.float64(0.5), "m": np.int64(2)}])
        folder.write_events([{"kind": "self_contact", "t_n": 0.5, "range": np.array([0.1, 0.2])}])
    assert read_events(tmp_path) == [{"kind": "self_contact", "t_n": 0.5, "range": [0.1, 0.2]}]
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("wrong", [float("nan"), object()])
def test_events_that_json_cannot_hold_leave_the_file_alone(tmp_path: Path, wrong: object) -> None:
    """NaN is no JSON."""
    with RunFolder(tmp_path, "") as folder:
        with pytest.raises((ValueError, TypeError)):
            folder.write_events([{"t_n": wrong}])
    assert json.loads((tmp_path / "events.json").read_text()) == []


def test_collection_follows_the_field_files(tmp_path: Path, sphere: Snapshot) -> None:
    """PyVista finds every state under its time, also two at one time."""
    import pyvista

    states = [sphere, deformed(sphere, cup, t_n=0.25), deformed(sphere, cup, t_n=0.25)]
    with RunFolder(tmp_path, "") as folder:
        for count, state in enumerate(states, start=1):
            written = folder.write_fields(state)
            assert written.exists()
            assert pyvista.get_reader(str(tmp_path / "fields.pvd")).number_time_points == min(
                count, 2
            )
    reader = pyvista.get_reader(str(tmp_path / "fields.pvd"))
    reader.set_active_time_value(0.25)
    position = reader.read()[0].point_data["position"]
    assert position[:, 2].min() == pytest.approx(-1, abs=1e-2)
    assert len(list((tmp_path / "fields").glob("*.vtu"))) == 3


def test_sections_come_back(tmp_path: Path, sphere: Snapshot) -> None:
    """Sections are those of the states, in order, with layers and azimuths."""
    states = [sphere, deformed(sphere, cup, t_n=0.3)]
    with RunFolder(tmp_path, "") as folder:
        for count, state in enumerate(states, start=1):
            folder.write_sections(state)
            assert len(read_sections(tmp_path)) == count
    for state, back in zip(states, read_sections(tmp_path), strict=True):
        assert back.t_n == state.t_n
        assert len(back.sections) == 8
        section = back.sections[3]
        assert section.phi == pytest.approx(3 * np.pi / 4)
        expected = meridian(state, section.phi)
        for region, part in section.parts.items():
            assert part.layers == state.layers[region]
            np.testing.assert_allclose(part.faces, expected.parts[region].faces, atol=1e-12)
            np.testing.assert_allclose(part.midsurface, expected.parts[region].midsurface)
            np.testing.assert_allclose(part.theta, expected.parts[region].theta)
