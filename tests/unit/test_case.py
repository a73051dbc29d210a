"""Cases: every mistake gives one sentence with the key, the value and what is allowed.

Worth reading: the table of wrong cases, and the round trip of the resolved case.
"""

import doctest
import math
import tomllib

import pydantic
import pytest

from opticcup_fem.case import Case, checks, files, load_case, parse_case, write_case
from opticcup_fem.errors import CaseError
from opticcup_fem.theory.prediction import growth_factor

# override, then what the sentence must hold
WRONG = {
    "unknown key": ("shape.radius=50", ["shape.radius is not a known key", "shape.radius_um"]),
    "unknown key, nothing close": (
        "run.colour=1",
        ["run.colour", "model, follow, switch_wave"],
    ),
    "unknown table": ("materials.closure=paper", ["materials is not a known table", "material?"]),
    "negative ratio": ("shape.radius_over_thickness=-5", ["= -5", "at least 2"]),
    "thick ball": ("shape.radius_over_thickness=1.5", ["= 1.5", "at least 2"]),
    "an endless run": ("run.t_end=1e9", ["= 1000000000.0", "above 0 and at most 100"]),
    "invisible cells": ("mesh.cell_size_oov=1e-309", ["= 1e-309", "at least 0.001"]),
    "a key of an obstacle": (
        "contact.obstacles=[{kind = 'sphere', centre = [0, 0, 3], sizes = 1}]",
        ["sizes in entry 1 of contact.obstacles is not", "did you mean sides in entry 1"],
    ),
    "an obstacle without a place": (
        "contact.obstacles=[{kind = 'sphere'}]",
        ["centre in entry 1 of contact.obstacles is missing", "3 numbers"],
    ),
    "an obstacle's place": (
        "contact.obstacles=[{kind = 'sphere', centre = [0, 0, 'a']}]",
        ["entry 3 of centre in entry 1 of contact.obstacles", '= "a"', "3 numbers"],
    ),
    "a sentence of two lines": ('shape.kind="a\\nb"', ['"a\\nb"', '"disk"']),
    "zero radius": ("shape.radius_um=0", ["shape.radius_um = 0", "above 0", "micrometres"]),
    "unit in the value": ("shape.radius_um=50 um", ['"50 um"', "a number", "micrometres"]),
    "radians": ("shape.opening_angle_deg=0.698", ["= 0.698", "at least 5", "degrees"]),
    "more than a half": ("shape.opening_angle_deg=120", ["= 120", "at most 90"]),
    "cap narrower than thick": ("shape.opening_angle_deg=8", ["narrower", "11.5 degrees"]),
    "not finite": ("shape.opening_angle_deg=nan", ["= nan", "a number"]),
    "text for a number": ('material.modulus_ratio="stiff"', ['"stiff"', "a number at least 1e-06"]),
    "boolean for a number": (
        "material.thickness_ratio=true",
        ["= true", "a number at least 1e-06"],
    ),
    "negative thickness": (
        "material.thickness_ratio=-0.1",
        ["= -0.1", "at least 1e-06", "h_ECM/h_IOV"],
    ),
    "negative poisson": ("material.poisson_ratio=-0.1", ["= -0.1", "at least 0"]),
    "beyond incompressible": ("material.poisson_ratio=0.6", ["= 0.6", "at most 0.5"]),
    "unknown closure": ("material.closure=stationary", ['"stationary"', '"layer-stretch"']),
    "two counts": ("material.thickness_points=[2, 5]", ["[2, 5]", "3 whole numbers"]),
    "no point": ("material.thickness_points=[2, 0, 5]", ["entry 2", "= 0", "at least 1"]),
    "half a point": ("material.thickness_points=[2, 2.5, 5]", ["entry 2", "= 2.5"]),
    "shrinks to nothing": ("growth.oov=-1.0", ["growth.oov = -1.0", "rate above -1"]),
    "text for a switch": ("growth.mass_change=yes", ['"yes"', "true or false"]),
    "model that does not exist": ("run.model=solid", ['"solid"', '"meridian"', '"surface"']),
    "no time": ("run.t_end=0", ["run.t_end = 0", "above 0"]),
    "too coarse": ("mesh.cell_size_cap=0.6", ["= 0.6", "too coarse", "0.349"]),
    "too coarse below": ("mesh.cell_size_oov=0.7", ["= 0.7", "too coarse", "0.611"]),
    "coarse interface": ("mesh.cell_size_interface=0.32", ["finest", "at most 0.3"]),
    "endless mesh": ("mesh.cell_size_oov=0.003", ["cell_size_interface", "cells"]),
    "endless spot": (
        "mesh.refinements=[{colatitude_deg = 70, extent = 1, cell_size = 0.001}]",
        ["mesh.refinements.cell_size = 0.001", "cells"],
    ),
    "spot without a size": (
        "mesh.refinements=[{colatitude_deg = 70}]",
        ["cell_size in entry 1 of mesh.refinements is missing"],
    ),
    "spot below the pole": (
        "mesh.refinements=[{colatitude_deg = 190, cell_size = 0.05}]",
        ["colatitude_deg in entry 1 of mesh.refinements", "= 190", "at most 180"],
    ),
    "half a seed": ("mesh.seed=2.5", ["= 2.5", "a whole number"]),
    "steps in disorder": ("solver.min_step=0.02", ["initial_step = 0.01"]),
    "first step too long": ("solver.initial_step=0.2", ["max_step = 0.1"]),
    "no growth of the step": ("solver.growth_factor=1.0", ["= 1", "above 1"]),
    "time after the end": ("output.times=[0.0, 1.5]", ["1.5", "run.t_end = 1"]),
    "negative time": ("output.times=[-0.1, 0.5]", ["entry 1", "= -0.1", "at least 0"]),
    "times in disorder": ("output.times=[0.5, 0.2]", ["[0.5, 0.2]", "increase"]),
    "a time twice": ("output.times=[0.5, 0.5]", ["once"]),
    "one time": ("output.times=0.5", ["= 0.5", "an array of numbers"]),
    "ill-posed closure": ("material.closure=closed-form", ["0.48", "closed-form"]),
}


@pytest.fixture
def case_file(tmp_path):
    def write(text):
        path = tmp_path / "case.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def is_one_sentence(message):
    return "\n" not in message and "Traceback" not in message and len(message) < 300


@pytest.mark.parametrize(("override", "parts"), WRONG.values(), ids=WRONG.keys())
def test_wrong_values_are_explained(case_file, override, parts):
    path = case_file("[material]\npoisson_ratio = 0.49\n" if "closed-form" in override else "")
    with pytest.raises(CaseError) as caught:
        load_case(path, [override])
    message = str(caught.value)
    assert is_one_sentence(message)
    assert str(path) in message
    for part in parts:
        assert part in message


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("shape = 3", ["shape = 3 is not a table", "[shape]"]),
        ("radius_over_thickness = 5", ["radius_over_thickness is not a known table"]),
        ("[shape\n", ["not valid TOML", "line 1"]),
        ("[shape]\nkind = 'cup'\nkind = 'cup'", ["not valid TOML"]),
        ("[shape]\nradus_um = 1\nradius_over_thickness = -1", ["radus_um", "1 more mistake"]),
    ],
)
def test_wrong_files_are_explained(case_file, text, parts):
    with pytest.raises(CaseError) as caught:
        load_case(case_file(text))
    assert is_one_sentence(str(caught.value))
    for part in parts:
        assert part in str(caught.value)


def test_missing_file_folder_and_binary_are_explained(tmp_path):
    with pytest.raises(CaseError, match="there is no such case file"):
        load_case(tmp_path / "absent.toml")
    with pytest.raises(CaseError, match="cannot be read"):
        load_case(tmp_path)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CaseError, match="not a text file"):
        load_case(binary)


@pytest.mark.parametrize("override", ["shape", "=3", "shape=3", "shape.x", "shape.x=", ".x=1"])
def test_overrides_in_the_wrong_form_are_explained(case_file, override):
    with pytest.raises(CaseError, match=r"table\.key=value"):
        load_case(case_file(""), [override])


def test_override_of_what_is_not_a_table(case_file):
    with pytest.raises(CaseError, match="shape is not a table"):
        load_case(case_file("shape = 3"), ["shape.radius_um=4"])


def test_defaults_are_the_chick():
    case = parse_case({})
    assert case.shape.radius_over_thickness == 5
    assert case.shape.thickness == 0.2
    assert case.shape.opening_angle == pytest.approx(math.radians(40))
    assert case.shape.theta_bar == pytest.approx(1.561, abs=5e-4)
    assert case.material.closure == "layer-stretch"
    assert case.material.thickness_points == (2, 5, 5)
    assert [growth_factor(case, layer, 0.5) for layer in ("ecm", "iov", "oov")] == [1, 3.5, 1.75]
    assert case.output.times == tuple(k / 10 for k in range(11))


@pytest.mark.parametrize(
    ("closure", "points"),
    [("paper", (2, 3, 3)), ("condensed", (2, 5, 5)), ("closed-form", (2, 5, 5))],
)
def test_default_thickness_rule_follows_the_closure(closure, points):
    material = {"closure": closure}
    assert parse_case({"material": material}).material.thickness_points == points
    material["thickness_points"] = [3, 6, 8]
    assert parse_case({"material": material}).material.thickness_points == (3, 6, 8)


@pytest.mark.parametrize(
    ("tables", "parts"),
    [
        ({"run": {"follow": "branch"}}, ["run.keep_mirrors = true", 'run.follow = "stable"']),
        ({"run": {"model": "meridian"}}, ["run.keep_mirrors = true", 'run.model = "surface"']),
        ({"mesh": {"symmetry": 3}}, ["mesh.symmetry = 3", "take 4"]),
        ({"mesh": {"symmetry": 0}}, ["mesh.symmetry = 0", "take 4"]),
        (
            {"contact": {"mode": "resist", "obstacles": [{"kind": "sphere", "centre": [0, 0, 3]}]}},
            ["run.keep_mirrors = true", "no obstacles"],
        ),
    ],
)
def test_mirrors_that_cannot_be_kept_are_explained(tables, parts):
    run = {**tables.get("run", {}), "keep_mirrors": True}
    with pytest.raises(CaseError) as caught:
        parse_case({**tables, "run": run})
    assert is_one_sentence(str(caught.value))
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize(
    ("run", "planes"),
    [
        ({"follow": "stable"}, 0),
        ({"follow": "axisymmetric"}, 4),
        ({"follow": "branch"}, 4),
        ({"keep_mirrors": True}, 4),
    ],
)
def test_default_symmetry_of_the_mesh_follows_the_path(run, planes):
    assert parse_case({"run": run}).mesh.symmetry == planes
    given = {"run": run, "mesh": {"symmetry": 6}}
    assert parse_case(given).mesh.symmetry == 6


@pytest.mark.parametrize(
    ("t_end", "times"),
    [(0.3, (0, 0.1, 0.2, 0.3)), (0.25, (0, 0.1, 0.2, 0.25)), (0.02, (0, 0.02))],
)
def test_default_times_follow_the_end(t_end, times):
    assert parse_case({"run": {"t_end": t_end}}).output.times == times
    assert parse_case({"run": {"t_end": t_end}, "output": {"times": []}}).output.times == ()


def test_overrides_apply_in_order_and_take_toml_or_bare_words(case_file):
    path = case_file("[shape]\nradius_over_thickness = 7\n")
    overrides = [
        "shape.radius_over_thickness=10",
        "shape.radius_over_thickness = 15",
        "material.closure=paper",
        "material.poisson_ratio=.4",
        "growth.mass_change=false",
        "output.times=[0.0, 0.5]",
    ]
    case = load_case(path, overrides)
    assert case.shape.radius_over_thickness == 15
    assert case.material.closure == "paper"
    assert case.material.poisson_ratio == 0.4
    assert case.growth.mass_change is False
    assert case.output.times == (0, 0.5)
    assert load_case(path, ['material.closure="paper"']).material.closure == "paper"


def test_a_value_cannot_smuggle_in_other_keys(case_file):
    with pytest.raises(CaseError, match="a number"):
        load_case(case_file(""), ["shape.radius_um=1\nother = 2"])


@pytest.mark.parametrize(
    ("name", "tables"),
    [
        ("chick", {"contact": {"mode": "stop"}}),
        ("slender", {"shape": {"radius_over_thickness": 15}, "contact": {"mode": "stop"}}),
    ],
)
def test_demo_cases_load(name, tables, request):
    case = load_case(request.config.rootpath / "demos" / f"{name}.toml")
    assert case == parse_case(tables)


@pytest.mark.parametrize(
    ("tables", "mode"),
    [
        ({}, "resist"),
        ({"material": {"closure": "condensed"}}, "resist"),
        ({"material": {"closure": "paper"}}, "stop"),
        ({"run": {"model": "meridian"}}, "stop"),
        ({"run": {"follow": "axisymmetric"}}, "stop"),
        ({"run": {"follow": "branch"}}, "stop"),
        ({"contact": {"mode": "off"}}, "off"),
    ],
)
def test_contact_is_resisted_where_it_can_be(tables, mode):
    case = parse_case(tables)
    assert case.contact.mode == mode
    if mode == "stop":
        with pytest.raises(CaseError, match=r'contact\.mode = "resist"'):
            parse_case({**tables, "contact": {"mode": "resist"}})


@pytest.mark.parametrize("size", [0.02, 0.02013, 0.0219, 0.03])
def test_default_barrier_is_no_wider_than_the_cells(size):
    sizes = {"cell_size_interface": size}
    assert parse_case({"mesh": sizes}).contact.distance == pytest.approx(size / 0.2, abs=1e-3)
    assert parse_case({}).contact.distance == 0.2
    with pytest.raises(CaseError, match=r"contact\.distance = 0\.2 is not possible"):
        parse_case({"mesh": sizes, "contact": {"distance": 0.2}})


def test_collisions_are_found_by_triangles_smaller_than_the_thickness() -> None:
    """By default; beside obstacles, where triangles push, they are nine a cell."""
    slender = {"shape": {"radius_over_thickness": 15}, "mesh": {"cell_size_oov": 0.24}}
    assert parse_case(slender).contact.subdivision == 5
    assert parse_case({}).contact.subdivision == 3
    assert parse_case({**slender, "contact": {"subdivision": 2}}).contact.subdivision == 2
    plate = {"kind": "plate", "centre": [0, 0, 2]}
    assert parse_case({**slender, "contact": {"obstacles": [plate]}}).contact.subdivision == 3


def test_resolved_case_round_trips_with_versions_and_units(tmp_path):
    case = parse_case(
        {
            "shape": {"radius_over_thickness": 15, "opening_angle_deg": 35.5},
            "material": {"closure": "paper"},
            "growth": {"mass_change": False},
            "run": {"t_end": 0.35},
            "solver": {"tolerance": 1e-10},
        }
    )
    path = tmp_path / "case.toml"
    write_case(case, path, {"dolfinx": "0.9.0", "python": "3.13"})
    assert load_case(path) == case
    text = path.read_text(encoding="utf-8")
    for part in ("# dolfinx 0.9.0", "# python 3.13", "micrometres", "degrees", "units of R"):
        assert part in text
    # nothing is left to a default
    tables = tomllib.loads(text)
    assert set(tables) == set(Case.model_fields)
    for name, table in tables.items():
        assert set(table) == set(type(getattr(case, name)).model_fields)


def test_a_case_cannot_be_written_below_a_file(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(CaseError, match="cannot be written"):
        write_case(parse_case({}), tmp_path / "file" / "case.toml")


def test_cases_are_immutable():
    case = parse_case({})
    with pytest.raises(pydantic.ValidationError):
        case.shape.radius_um = 1.0


def test_opening_angles_at_the_bounds_are_possible():
    for angle, ratio in ((90, 5), (5, 12)):
        small = {"cell_size_cap": 0.04, "cell_size_oov": 0.3, "cell_size_interface": 0.03}
        shape = {"opening_angle_deg": angle, "radius_over_thickness": ratio}
        assert parse_case({"shape": shape, "mesh": small}).shape.opening_angle_deg == angle


@pytest.mark.parametrize("module", [files, checks])
def test_examples_in_the_docstrings(module):
    results = doctest.testmod(module)
    assert results.attempted > 0
    assert results.failed == 0
