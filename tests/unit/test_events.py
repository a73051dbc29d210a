"""Events in recorded paths.

What matters: the times of the reference paths are found in rows as sparse as an adaptive run
writes them, nothing is reported before it has happened, and what is no event stays none.
"""

from typing import Any

import numpy as np
import pytest

from opticcup_fem.events import detect_events, event, with_limit_points
from tests.support.paths import recorded_path, stable_branches

SEEDS = range(6)


def rows_of(size: int, seed: int = 0, **changed: float) -> list[dict[str, Any]]:
    """Return the rows of a run with the steps that the documentation recommends."""
    steps = {"max_move": 0.15, "max_step": 0.07, "bracket": 6e-4, "t_end": 1.0} | changed
    return recorded_path(stable_branches(size), seed=seed, **steps)


def descending(t_n: np.ndarray, c: np.ndarray, **columns: Any) -> list[dict[str, Any]]:
    """Return rows of a given apex height that are deep and without jumps."""
    return [
        {"t_n": t, "apex_height_over_R": x, "D_over_r": 0.3, "kappa_cap_R": 10 * t}
        | {name: values[k] for name, values in columns.items()}
        for k, (t, x) in enumerate(zip(t_n, c, strict=True))
    ]


# the reference solver; t_1 within 1 %, t_2 within .003
@pytest.mark.parametrize(
    ("size", "first", "first_type", "second", "second_type"),
    [
        (5, 0.0640, "smooth", 0.4729, "fold"),
        (10, 0.04092, "fold", 0.4000, "smooth"),
        (15, 0.03652, "fold", 0.399, "smooth"),
    ],
)
@pytest.mark.parametrize("seed", SEEDS)
def test_invaginations_of_the_reference_paths(
    size: int, first: float, first_type: str, second: float, second_type: str, seed: int
) -> None:
    """Both events are found with their types and times in irregular, sparse rows."""
    rows = rows_of(size, seed)
    assert len(rows) < 60
    primary, secondary = detect_events(rows)
    assert (primary["kind"], primary["type"]) == ("primary_invagination", first_type)
    assert (secondary["kind"], secondary["type"]) == ("secondary_invagination", second_type)
    assert primary["t_n"] == pytest.approx(first, rel=0.01)
    assert secondary["t_n"] == pytest.approx(second, abs=0.003)
    for found in (primary, secondary):
        low, high = found["t_n_range"]
        assert low <= found["t_n"] <= high
        kappa = np.interp(found["t_n"], *(np.array([(r["t_n"], r["kappa_cap_R"]) for r in rows]).T))
        assert found["kappa_cap_R"] == pytest.approx(kappa, rel=0.01)


@pytest.mark.parametrize("size", [5, 10, 15])
def test_nothing_is_reported_that_the_whole_path_denies(size: int) -> None:
    """Every event found while the run goes on is still there, at its time, when it ends."""
    rows = rows_of(size, seed=3)
    final = {(e["kind"], e["type"]): e["t_n"] for e in detect_events(rows)}
    seen = set()
    for count in range(1, len(rows) + 1):
        for found in detect_events(rows[:count]):
            seen.add((found["kind"], found["type"]))
            assert found["t_n"] == pytest.approx(final[found["kind"], found["type"]], abs=0.01)
            assert found["t_n"] <= rows[count - 1]["t_n"]
    assert seen == set(final)


def test_limit_point_lies_between_the_rows_of_the_jump() -> None:
    """A fold's range is the last row before and the first row after the jump."""
    rows = rows_of(10)
    after = next(k for k, row in enumerate(rows) if row["jump"])
    primary = detect_events(rows)[0]
    assert primary["t_n_range"] == [rows[after - 1]["t_n"], rows[after]["t_n"]]
    assert primary["t_n"] == pytest.approx(np.mean(primary["t_n_range"]), rel=1e-12)


def test_curvature_function_gives_kappa() -> None:
    """A given curvature function is used instead of the rows' column."""
    found = detect_events(rows_of(5), curvature=lambda t: 100 * t)
    assert [e["kappa_cap_R"] for e in found] == pytest.approx([100 * e["t_n"] for e in found])


def test_fastest_descent_of_a_known_curve() -> None:
    """The least slope of c = 2 - tanh((t - .3)/.05)/2 is at t = .3, once it has eased."""
    t = np.array([0, 0.06, 0.1, 0.17, 0.2, 0.24, 0.27, 0.285, 0.3, 0.31, 0.33, 0.37, 0.4, 0.5, 0.6])
    rows = descending(t, 2 - np.tanh((t - 0.3) / 0.05) / 2)
    (found,) = detect_events(rows)
    assert found["kind"] == "primary_invagination"
    assert found["t_n"] == pytest.approx(0.3, abs=1e-3)
    assert detect_events([row for row in rows if row["t_n"] <= 0.3]) == []


def test_descent_without_a_dimple_is_no_invagination() -> None:
    """A falling apex that stays the top (an evaginating cup) is no event."""
    t = np.linspace(0, 0.6, 25)
    rows = descending(t, 2 - np.tanh((t - 0.3) / 0.05) / 2)
    assert detect_events([row | {"D_over_r": 0.0} for row in rows]) == []


def test_apex_that_rises_for_ever_has_no_second_event() -> None:
    """After the first invagination a rising apex is no secondary invagination."""
    t = np.linspace(0, 1, 41)
    rows = descending(t, 2 - np.tanh((t - 0.1) / 0.03) / 2 + 0.3 * t)
    assert [e["kind"] for e in detect_events(rows)] == ["primary_invagination"]


def test_jump_upwards_is_no_invagination() -> None:
    """A jump over which the apex rises is not an invagination."""
    t = np.linspace(0, 1, 21)
    jump = [k == 10 for k in range(21)]
    rows = descending(t, 1 + t + np.where(t >= 0.5, 0.3, 0.0), jump=jump)
    assert detect_events(rows) == []


@pytest.mark.parametrize(("jump", "kind_type"), [(True, "jump"), (False, "smooth")])
def test_symmetry_breaking_ends_the_search_for_invaginations(jump: bool, kind_type: str) -> None:
    """Loss of symmetry is found with type and wavenumber; later falls are no invaginations."""
    rows = rows_of(10)
    for row in rows:
        broken = row["t_n"] > 0.25
        row |= {"asymmetry": 3e-3 if broken else 1e-8, "interface_m1": 1e-6}
        row |= {"interface_m2": 0.1 if broken else 1e-6, "interface_m3": 1e-5}
    first = next(row for row in rows if row["t_n"] > 0.25)
    first["jump"] = jump
    before = max(row["t_n"] for row in rows if row["t_n"] <= 0.25)
    primary, broken = detect_events(rows)
    assert primary["kind"] == "primary_invagination"
    assert (broken["kind"], broken["type"], broken["wavenumber"]) == (
        "symmetry_breaking",
        kind_type,
        2,
    )
    assert broken["t_n_range"] == [before, first["t_n"]]


@pytest.mark.parametrize(
    ("asymmetry", "at", "kind_type"),
    [
        ([1e-8, 5e-5, 2e-4, 8e-4, 0.05, 0.06], 4, "jump"),  # bent by the mesh, then thrown
        ([1e-8, 5e-5, 2e-4, 8e-4, 3e-3, 0.06], 2, "smooth"),  # the jump changes little
        ([1e-8, 5e-5, 2e-4, 5e-3, 0.06, 0.07], 2, "smooth"),  # far from symmetric before it
        ([1e-8, 1e-8, 1e-8, 1e-8, 2e-4, 3e-4], 4, "jump"),
    ],
)
def test_an_imperfect_mesh_does_not_advance_the_loss_of_symmetry(
    asymmetry: list[float], at: int, kind_type: str
) -> None:
    """With a jump before row 4, the event is the jump if that is what breaks the symmetry."""
    t = np.linspace(0, 0.5, 6)
    jump = [k == 4 for k in range(6)]
    rows = descending(t, 1 + t, asymmetry=asymmetry, jump=jump)
    (found,) = detect_events(rows)
    assert (found["kind"], found["type"]) == ("symmetry_breaking", kind_type)
    assert found["t_n_range"] == pytest.approx([t[at - 1], t[at]])


def test_a_fall_that_carries_a_bent_cup_over_the_threshold_keeps_its_symmetry() -> None:
    """The fall is a fold, unless it throws the cup; a later growth by ten is the loss."""
    t = np.linspace(0, 0.5, 6)
    height = np.where(t > 0.25, 1.0, 1.5) + t
    jump = [k == 3 for k in range(6)]
    depth = {"D_over_r": 0.5}

    def kinds(asymmetry: list[float]) -> list[tuple[str, str]]:
        rows = descending(t, height, asymmetry=asymmetry, jump=jump)
        return [(e["kind"], e["type"]) for e in detect_events([row | depth for row in rows])]

    fold = ("primary_invagination", "fold")
    assert kinds([1e-8, 5e-6, 6e-5, 1.5e-4, 2e-4, 1e-4]) == [fold]
    assert kinds([1e-8, 5e-6, 6e-5, 1.5e-4, 1e-3, 3e-3]) == [fold, ("symmetry_breaking", "smooth")]
    assert kinds([1e-8, 5e-6, 6e-5, 1e-3, 1e-3, 1e-3]) == [("symmetry_breaking", "jump")]
    assert kinds([1e-8, 5e-6, 1.5e-4, 2e-4, 2e-4, 1e-4]) == [("symmetry_breaking", "smooth")]


def test_asymmetry_below_the_threshold_is_the_mesh() -> None:
    """Rows below the threshold are axisymmetric; a lower threshold finds them."""
    rows = [row | {"asymmetry": 5e-5} for row in rows_of(10)]
    assert len(detect_events(rows)) == 2
    kinds = [e["kind"] for e in detect_events(rows, asymmetry_threshold=1e-5)]
    assert kinds == ["symmetry_breaking"]


def test_recorded_events_replace_those_of_their_kind_and_all_are_in_order() -> None:
    """What the run knows goes first; the rest is added and sorted by time."""
    contact = event("self_contact", "ipctk", 0.8, 5.0, places=4)
    better = event("primary_invagination", "fold", 0.0409, 2.5)
    found = detect_events(rows_of(10), [contact, better])
    assert [e["kind"] for e in found] == [
        "primary_invagination",
        "secondary_invagination",
        "self_contact",
    ]
    assert found[0] is better
    assert found[2]["places"] == 4


def test_unknown_kinds_are_refused() -> None:
    """A misspelt kind is an error, not a new kind."""
    with pytest.raises(ValueError, match="secondary_invagination"):
        event("second_invagination", "fold", 0.4, 4.0)


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_paths_that_have_just_begun_have_no_events(count: int) -> None:
    """Few rows are no reason to fail."""
    assert detect_events(rows_of(5)[:count]) == []


def test_limit_point_explains_the_fold_that_encloses_it() -> None:
    """The fold keeps its kind and takes time and mode; one that lets nothing fall stays."""
    fold = event("primary_invagination", "fold", 0.0411, 5.0, t_n_range=[0.04095, 0.0412])
    mode = {"wavenumber": 0, "purity": 0.99, "t_n_range": [0.04095, 0.0411]}
    limit = event("limit_point", "fold", 0.04097, 4.9, **mode)
    other = event("limit_point", "fold", 0.3, 9.0, wavenumber=2)
    smooth = event("secondary_invagination", "smooth", 0.4, 9.5)
    # before the fold's bracket, and inside no bracket
    early = event("limit_point", "fold", 0.0409, 4.8, **mode)
    merged = with_limit_points([early, limit, fold, other, smooth])
    assert [one["kind"] for one in merged] == [
        "limit_point",
        "primary_invagination",
        "limit_point",
        "secondary_invagination",
    ]
    assert merged[0] is early
    assert merged[1] == {**limit, "kind": "primary_invagination"}
    assert merged[2:] == [other, smooth]
    # a limit point explains one fold only
    again = with_limit_points([limit, fold, fold])
    assert [one["t_n"] for one in again] == [0.04097, 0.0411]
