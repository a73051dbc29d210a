"""Parameter studies: study files, identity of tasks, cache, engine, tables.

Worth reading: `test_a_dying_process_costs_only_its_own_task` and
`test_identity_of_a_task_follows_what_matters`.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest

from opticcup_fem.case import parse_case
from opticcup_fem.errors import CaseError
from opticcup_fem.events import event
from opticcup_fem.studies.sweep import cache as caching
from opticcup_fem.studies.sweep.bar import Bar
from opticcup_fem.studies.sweep.cache import ResultCache, Task
from opticcup_fem.studies.sweep.command import Part
from opticcup_fem.studies.sweep.engine import Engine, engine_of
from opticcup_fem.studies.sweep.rows import summary_row, value_at
from opticcup_fem.studies.sweep.study_file import load_study, parse_study
from opticcup_fem.studies.sweep.table import study_table, write_csv, write_hdf5
from opticcup_fem.studies.sweep.tasks import task_of

RATIO, ALPHA = "shape.radius_over_thickness", "shape.opening_angle_deg"
HERE = "tests.support.tasks"


def quick(name, **parameters):
    return Task.of(f"{HERE}:{name}", "meridian", parameters)


@pytest.mark.parametrize("text", ["0/4", "5/4", "2", "a/b", "-1/2", ""])
def test_wrong_parts_are_explained(text):
    assert Part.parsed("4/4") == Part(4, 4)
    with pytest.raises(CaseError, match=r"write it as 2/8|the parts are 1/4 to 4/4"):
        Part.parsed(text)


# --- study files ----------------------------------------------------------------------------------


def values(study, key):
    return [point.settings[key] for point in study.points]


def test_a_grid_varies_the_last_axis_fastest():
    study = parse_study(
        {
            "axis": [
                {"key": RATIO, "values": [5, 10]},
                {"key": ALPHA, "from": 30, "to": 50, "step": 10},
            ]
        }
    )
    assert study.keys == (RATIO, ALPHA)
    assert values(study, RATIO) == [5, 5, 5, 10, 10, 10]
    assert values(study, ALPHA) == [30, 40, 50, 30, 40, 50]
    case = study.points[-1].case
    assert case is not None
    assert (case.shape.radius_over_thickness, case.shape.opening_angle_deg) == (10, 50)
    assert case.run.model == "meridian"


def test_zipped_axes_and_keys_that_vary_together():
    reading = {
        "keys": ["material.closure", "material.thickness_points"],
        "values": [["paper", [2, 3, 3]], ["condensed", [2, 5, 5]]],
    }
    study = parse_study({"combine": "zip", "axis": [{"key": RATIO, "values": [5, 6]}, reading]})
    assert values(study, RATIO) == [5, 6]
    assert values(study, "material.closure") == ["paper", "condensed"]
    assert [p.case.material.thickness_points for p in study.points if p.case] == [
        (2, 3, 3),
        (2, 5, 5),
    ]


def test_ranges_are_round_numbers():
    def along(**axis):
        return values(parse_study({"axis": [{"key": "material.poisson_ratio", **axis}]}), axis_key)

    axis_key = "material.poisson_ratio"
    assert along(**{"from": 0.1, "to": 0.4}, step=0.1) == [0.1, 0.2, 0.3, 0.4]
    assert along(**{"from": 0.1, "to": 0.4}, count=3) == [0.1, 0.25, 0.4]
    assert along(**{"from": 0.1, "to": 0.4}, step=0.25) == [0.1, 0.35]
    logarithmic = {"from": 1.0, "to": 100.0, "count": 3, "scale": "log"}
    study = parse_study({"axis": [{"key": "material.modulus_ratio", **logarithmic}]})
    assert values(study, "material.modulus_ratio") == [1, 10, 100]


def test_a_combination_that_cannot_be_is_a_point_with_a_reason():
    nu = {"key": "material.poisson_ratio", "values": [0.45, 0.49]}
    study = parse_study({"base": {"material": {"closure": "closed-form"}}, "axis": [nu]})
    assert study.points[0].case is not None
    assert study.points[1].case is None
    assert "ill-posed" in study.points[1].reason


def test_a_study_takes_a_case_file_beside_it(tmp_path):
    (tmp_path / "cup.toml").write_text("[material]\nmodulus_ratio = 30.0\n[run]\nt_end = 0.5\n")
    text = f'case = "cup.toml"\n[base.run]\nt_end = 0.2\n[[axis]]\nkey = "{RATIO}"\nvalues = [7]\n'
    (tmp_path / "study.toml").write_text(text)
    case = load_study(tmp_path / "study.toml").points[0].case
    assert case is not None
    assert (case.material.modulus_ratio, case.run.t_end) == (30.0, 0.2)


AXIS = {"key": RATIO, "values": [5]}
WRONG = {
    "no axis": ({}, "axis"),
    "unknown key": ({"axis": [{"key": "shape.ratio", "values": [5]}]}, "not a key of a case"),
    "no table": ({"axis": [{"key": "ratio", "values": [5]}]}, "table.key"),
    "twice": ({"axis": [AXIS, AXIS]}, "two axes"),
    "no values": ({"axis": [{"key": RATIO}]}, "either `values`"),
    "both": ({"axis": [{**AXIS, "from": 1, "to": 2, "step": 1}]}, "either `values`"),
    "empty": ({"axis": [{"key": RATIO, "values": []}]}, "at least one value"),
    "step": ({"axis": [{"key": RATIO, "from": 5, "to": 9}]}, "either `step` or `count`"),
    "backwards": ({"axis": [{"key": RATIO, "from": 9, "to": 5, "step": 1}]}, "above `from`"),
    "log": ({"axis": [{"key": RATIO, "from": 0, "to": 5, "count": 3, "scale": "log"}]}, "above 0"),
    "tuple": ({"axis": [{"keys": [RATIO, ALPHA], "values": [[5]]}]}, "each of the 2 keys"),
    "lengths": (
        {"combine": "zip", "axis": [AXIS, {"key": ALPHA, "values": [30, 40]}]},
        "axes of one length",
    ),
    "too many": (
        {"axis": [{"key": k, "from": 5, "to": 9, "count": 1000} for k in (RATIO, ALPHA)]},
        "more than 100000",
    ),
    "base": ({"base": {"shape": {"opening_angle_deg": 200}}, "axis": [AXIS]}, "at most 90"),
    "spelling": ({"axes": [AXIS], "axis": [AXIS]}, "axes"),
}


@pytest.mark.parametrize(("data", "part"), WRONG.values(), ids=WRONG.keys())
def test_wrong_studies_are_explained_in_one_sentence(data, part):
    with pytest.raises(CaseError) as caught:
        parse_study(data, source="study.toml")
    assert str(caught.value).startswith("study.toml: ")
    assert part in str(caught.value)
    assert "\n" not in str(caught.value)


# --- identity and cache ---------------------------------------------------------------------------


def test_identity_of_a_task_follows_what_matters():
    def path(**tables):
        return ResultCache().path(task_of(parse_case(tables | {"run": {"model": "meridian"}})))

    chick = path()
    assert path(mesh={"seed": 7}, output={"picture": False}, shape={"radius_um": 60}) == chick
    for tables in (
        {"shape": {"radius_over_thickness": 5.0000001}},
        {"material": {"closure": "condensed"}},
        {"growth": {"mass_change": False}},
        {"output": {"times": [0.5]}},
    ):
        assert path(**tables) != chick
    surface = [parse_case({"mesh": {"seed": seed}}) for seed in (1, 7)]
    assert ResultCache().path(task_of(surface[0])) != ResultCache().path(task_of(surface[1]))


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("OPTICCUP_CACHE", str(tmp_path / "cache"))


def test_identity_follows_the_code_but_not_its_comments(monkeypatch, tmp_path):
    copy = tmp_path / "package"
    shutil.copytree(caching.PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(caching, "PACKAGE", copy)

    def version():
        caching.code_version.cache_clear()
        return caching.code_version("meridian")

    try:
        first = version()
        law = copy / "shell" / "growth.py"
        law.write_text("# a remark\n" + law.read_text().replace('"""', '"""Well, ', 1))
        assert version() == first
        law.write_text(law.read_text() + "\nFACTOR = 2\n")
        second = version()
        assert second != first
        (copy / "shell" / "loops.c").write_text("int one;")
        assert version() != second
    finally:
        caching.code_version.cache_clear()


def test_every_source_of_a_model_exists():
    for names in caching.SOURCES.values():
        for name in names:
            assert (caching.PACKAGE / name).exists(), name


def test_records_come_back_and_damaged_ones_are_not_there():
    cache, task = ResultCache(), quick("square", x=3)
    assert cache.load(task) is None
    cache.store(task, {"status": "ok", "row": {"y": 0.1 + 0.2}})
    assert cache.load(task) == {"status": "ok", "row": {"y": 0.1 + 0.2}}
    assert [p.name for p in cache.path(task).parent.iterdir()] == [cache.path(task).name]
    for damage in ("", "{", "[]", '{"record": 3'):
        cache.path(task).write_text(damage)
        assert cache.load(task) is None


def test_a_cache_that_cannot_be_written_is_explained(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CaseError, match="OPTICCUP_CACHE"):
        ResultCache(tmp_path / "file")


# --- engine ---------------------------------------------------------------------------------------


def threads(cache):
    return Engine(ThreadPoolExecutor(2), 2, cache, Bar(False))


def test_equal_tasks_are_computed_once_ever(tmp_path):
    trace = str(tmp_path / "trace")
    tasks = [quick("square", x=x, trace=trace) for x in (1, 2, 1, 3)]
    engine = threads(ResultCache())
    assert [r["row"]["y"] for r in engine.run(tasks)] == [1, 4, 1, 9]
    assert engine.computed == 3
    again = threads(ResultCache())
    assert again.run(tasks) == engine.run(tasks)
    assert again.computed == 0
    assert sorted((tmp_path / "trace").read_text().split()) == ["1", "2", "3"]


def test_failures_are_records_with_a_reason():
    engine = threads(ResultCache())
    records = engine.run([quick("stopped"), quick("failing"), quick("broken")])
    assert [record["status"] for record in records] == ["ended early", "failed", "failed"]
    assert "arc length step too small" in records[1]["reason"]
    assert "ZeroDivisionError in tasks.py" in records[2]["reason"]
    # a mistake in the program is not kept for ever
    again = threads(ResultCache())
    again.run([quick("stopped"), quick("failing"), quick("broken")])
    assert again.computed == 1


def test_a_dying_process_costs_only_its_own_task():
    tasks = [quick("square", x=1), quick("deadly"), *(quick("square", x=x) for x in (2, 3, 4))]
    with engine_of(ResultCache(), 2, shown=False) as engine:
        assert engine is not None
        records = engine.run(tasks)
    assert [r["row"].get("y") for r in records] == [1, None, 4, 9, 16]
    assert (records[1]["status"], records[1]["reason"][:22]) == ("failed", "the process that compu")


# --- rows and tables ------------------------------------------------------------------------------

PATH = {
    "t_n": [0.0, 0.1, 0.2, 0.15, 0.2, 0.3],
    "D_over_r": [0.0, 0.0, 0.1, 0.2, 0.5, 0.7],
    "lambda_iov": [1.0, 1.1, 1.2, 1.3, 1.4, 1.5],
    "apex_height_over_R": [2.0, 2.0, 1.9, 1.8, 1.4, 1.2],
    "max_radius_over_R": [1.0] * 6,
    "tangent_angle_interface": [0.7, 0.6, 0.4, 0.2, -0.1, -0.4],
    "followed": [True, True, True, False, True, True],
    "jump": [False, False, False, False, True, False],
}


def test_values_on_the_followed_part_are_those_before_a_fall():
    assert value_at(PATH, 0.05, "lambda_iov") == pytest.approx(1.05)
    assert value_at(PATH, 0.2, "D_over_r") == pytest.approx(0.1)
    assert value_at(PATH, 0.25, "D_over_r") == pytest.approx(0.6)
    assert value_at(PATH, 0.31, "D_over_r") is None


def test_rows_hold_events_rotation_and_values():
    case = parse_case({"run": {"t_end": 0.3}, "output": {"times": [0.25, 0.3]}})
    events = [
        event("symmetry_breaking", "bifurcation", 0.1, 2.0, wavenumber=1, early=1),
        event("primary_invagination", "fold", 0.2, 3.65),
        event("symmetry_breaking", "bifurcation", 0.25, 4.2, wavenumber=2),
        event("closure_breakdown", "loss of ellipticity", 0.28, 4.5),
    ]
    row = summary_row(case, PATH, events)
    assert (row["t_1"], row["type_1"], row["t_2"]) == (0.2, "fold", None)
    assert (row["kappa_1"], row["kappa_b"]) == (3.65, 4.2)
    assert row["delta_theta_1"] == pytest.approx(np.radians(40) - 0.4)
    assert (row["t_b"], row["m_b"], row["t_early"], row["m_early"]) == (0.25, 2, 0.1, 1)
    assert row["delta_theta_b"] == pytest.approx(np.radians(40) + 0.25)
    assert (row["t_ellipticity"], row["t_breakdown"]) == (0.28, None)
    assert (row["t_reached"], row["largest_D_over_r"]) == (0.3, 0.7)
    assert row["D_over_r_at_0.25"] == pytest.approx(0.6)


def test_tables_keep_every_digit_and_every_point(tmp_path):
    settings = [{RATIO: 5.0, "material.thickness_points": [2, 3, 3]}, {RATIO: 6.0}, {RATIO: 7.0}]
    records = [
        {"status": "ok", "reason": None, "row": {"t_2": 1 / 3, "type_2": "fold", "m_b": None}},
        {"status": "failed", "reason": "a, b", "row": {}},
        None,
    ]
    table = study_table(settings, records)
    write_csv(table, tmp_path / "t.csv")
    with (tmp_path / "t.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [line["status"] for line in lines] == ["ok", "failed", "pending"]
    assert float(lines[0]["t_2"]) == 1 / 3
    assert lines[0]["material.thickness_points"] == "2 3 3"
    assert (lines[0]["regime"], lines[1]["regime"], lines[1]["reason"]) == (
        "normal",
        "undecided",
        "a, b",
    )
    import h5py

    write_hdf5(table, tmp_path / "t.h5")
    with h5py.File(tmp_path / "t.h5") as file:
        assert set(file) == set(table.columns)
        np.testing.assert_array_equal(file["t_2"][...], [1 / 3, np.nan, np.nan])
        assert [text.decode() for text in file["type_2"][...]] == ["fold", "", ""]
    assert sorted(p.name for p in tmp_path.iterdir() if p.name[0] == ".") == []
    assert isinstance(table, pd.DataFrame) and json.dumps(list(table.columns))


UNCONCERNED = {
    "opticcup_fem",
    "opticcup_fem.checkpoint",
    "opticcup_fem.compat",  # one behaviour on every version of dolfinx
    "opticcup_fem.diagram",
    "opticcup_fem.errors",
    "opticcup_fem.fields",
    "opticcup_fem.folds",  # a column of path.csv, not of a task
    "opticcup_fem.folder_lock",
    "opticcup_fem.records",
    "opticcup_fem.reordering",  # of what is written
    "opticcup_fem.states",
    "opticcup_fem.studies",
    "opticcup_fem.studies.critical_modes",  # for pictures
    "opticcup_fem.studies.interruption",
    "opticcup_fem.studies.outcome",
    "opticcup_fem.studies.progress",
    "opticcup_fem.studies.restart",  # a task has no earlier run to go on from
    "opticcup_fem.studies.sweep",
    "opticcup_fem.versions",
    "opticcup_fem.whole_files",
}
"""Modules that tasks load and that cannot change a number."""

OF_THE_SURFACE = (
    "contact",
    "equilibrium",
    "mesh",
    "sampling",
    "snapshot",
    "studies.contact",
    "studies.stability",
    "wavenumbers",
)
"""What ``studies.model`` and ``studies.meridian`` load for the surface model's sake."""


@pytest.mark.parametrize(
    ("model", "module"), [("meridian", "meridian_tasks"), ("surface", "surface_task")]
)
def test_all_code_that_a_task_loads_is_part_of_its_identity(model, module):
    code = f"import sys, opticcup_fem.studies.sweep.{module}\nprint(' '.join(sys.modules))"
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("OMPI_", "PMIX_", "PMI_"))}
    done = subprocess.run(
        [sys.executable, "-c", code], env=clean, capture_output=True, text=True, check=True
    )
    loaded = {name for name in done.stdout.split() if name.split(".")[0] == "opticcup_fem"}
    names = [*caching.SOURCES[model], *(OF_THE_SURFACE if model == "meridian" else ())]
    covered = {name.removesuffix(".py").replace("/", ".") for name in names}
    missing = {
        name
        for name in loaded - UNCONCERNED
        if not any(f"{name}.".startswith(f"opticcup_fem.{part}.") for part in covered)
    }
    assert not missing
