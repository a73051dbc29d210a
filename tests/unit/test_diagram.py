"""Regimes, fits of the laws, transitions, bisection and effects, from rows that are made up.

Worth reading: `test_laws_give_back_their_coefficients`, in which the rows obey the paper's laws.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from opticcup_fem.diagram.bisection import Bracket, bisect, changes, first_change
from opticcup_fem.diagram.fits import fit_laws, fitted_line, transition
from opticcup_fem.diagram.regimes import margin, regime, second_event
from opticcup_fem.diagram.tornado import effects
from opticcup_fem.theory import (
    PAPER_COEFFICIENTS,
    buckling_curvature,
    buckling_transition,
    primary_curvature,
    secondary_curvature,
)

ALPHA, GAMMA, PLATE = math.radians(40), 0.05845, 4.167
NAMES = ("t_1", "type_1", "kappa_1", "t_2", "kappa_2", "t_b", "type_b", "kappa_b")
NOTHING = dict.fromkeys(NAMES)


def row(**numbers):
    return {**NOTHING, "status": "ok", "largest_D_over_r": 0.5, **numbers}


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        ({"t_2": 0.4, "t_b": 0.5}, "normal"),
        ({"t_2": 0.4}, "normal"),
        ({"t_2": 0.4, "t_b": 0.3}, "abnormal"),
        ({"t_b": 0.3}, "abnormal"),
        ({}, "invaginated"),
        ({"largest_D_over_r": 0.0}, "evaginated"),
        ({"largest_D_over_r": 0.0, "status": "ended early"}, "undecided"),
        ({"status": "ended early"}, "undecided"),
        ({"t_2": 0.4, "status": "ended early", "t_reached": 0.6}, "normal"),
        ({"t_b": 0.658, "status": "ended early", "t_reached": 0.66}, "undecided"),
        ({"t_b": 0.5, "status": "ended early", "t_reached": 0.66}, "abnormal"),
        ({"t_2": 0.4, "status": "failed"}, "undecided"),
        ({"t_2": 0.4, "t_ellipticity": 0.5}, "normal"),
        ({"t_b": 0.5, "t_ellipticity": 0.501}, "undecided"),
        ({"t_b": 0.3, "t_2": 0.4, "t_ellipticity": 0.35}, "abnormal"),
        ({"t_ellipticity": 0.5}, "undecided"),
    ],
)
def test_regimes(numbers, expected):
    assert regime(row(**numbers)) == expected


def test_second_event_and_margin():
    normal = row(t_2=0.4, kappa_2=8.0, t_b=0.5, kappa_b=10.0)
    assert second_event(normal) == ("secondary_invagination", 0.4, 8.0)
    assert margin(normal) == pytest.approx(0.25)
    abnormal = row(t_2=0.4, kappa_2=12.0, t_b=0.3, kappa_b=9.0)
    assert second_event(abnormal) == ("symmetry_breaking", 0.3, 9.0)
    assert margin(abnormal) == pytest.approx(-0.25)
    assert second_event(row()) is None
    assert margin(row(kappa_2=8.0)) is None


def test_a_line_has_the_textbook_intervals():
    """Anscombe's first set: 0.5 and 3, with standard errors 0.118 and 1.125."""
    x = [10, 8, 13, 9, 11, 14, 6, 4, 12, 7, 5]
    y = [8.04, 6.95, 7.58, 8.81, 8.33, 9.96, 7.24, 4.26, 10.84, 4.82, 5.68]
    line = fitted_line(x, y)
    assert line is not None
    assert (line.slope, line.offset) == pytest.approx((0.5001, 3.0001), abs=1e-4)
    t_9 = 2.262157  # 97.5 % quantile for 9 degrees of freedom
    assert line.half_widths == pytest.approx((t_9 * 0.1179, t_9 * 1.1247), rel=1e-3)
    assert line(2.0) == pytest.approx(2 * line.slope + line.offset)
    assert fitted_line([1, 2], [1, 2]) is None


def lawful_rows(scatter=0.0, angle=ALPHA):
    """Cups that obey the paper's laws; thin ones buckle first, those of R/h < 7 snap not."""
    rng = np.random.default_rng(1)
    rows = []
    for ratio in np.arange(5.0, 21.0):
        theta = angle * math.sqrt(ratio)
        kappas = {
            "kappa_1": float(primary_curvature(theta, GAMMA)),
            "kappa_2": float(secondary_curvature(ratio)),
            "kappa_b": float(buckling_curvature(theta, angle, GAMMA, PLATE)),
        }
        kappas = {name: k + scatter * rng.normal() for name, k in kappas.items()}
        times = {
            "t_1": 0.05,
            "type_b": "bifurcation",
            "t_2": kappas["kappa_2"] / 20,
            "t_b": kappas["kappa_b"] / 20,
        }
        kind = "fold" if ratio > 6 else "smooth"
        rows.append(row(ratio=ratio, angle=angle, type_1=kind, **kappas, **times))
    return rows


def test_laws_give_back_their_coefficients():
    fits = fit_laws(lawful_rows(), GAMMA, PLATE)
    found = fits.coefficients
    assert found is not None
    for name in ("a_1", "b_1", "a_2", "b_2", "b_b", "c_b"):
        assert getattr(found, name) == pytest.approx(getattr(PAPER_COEFFICIENTS, name), abs=1e-9)
    # theta_b = 2.447 lies between R/h = 12 and 13: each law is fitted to its own cups
    assert fits.snapping is not None and fits.primary is not None
    assert (fits.primary.count, fits.snapping.count) == (16, 14)
    assert fits.secondary is not None and fits.buckling is not None
    assert (fits.secondary.count, fits.buckling.count) == (8, 8)
    crossing = transition(fits, ALPHA, GAMMA, PLATE)
    assert crossing is not None
    assert crossing[0] == pytest.approx(float(buckling_transition(ALPHA, GAMMA, PLATE)), rel=1e-9)
    assert crossing[1] < 1e-6


def test_scatter_widens_the_interval_of_the_transition():
    """The interval follows the scatter, and holds the true crossing of most draws."""
    true = float(buckling_transition(ALPHA, GAMMA, PLATE))
    widths = []
    for scatter in (0.01, 0.02):
        crossing = transition(fit_laws(lawful_rows(scatter), GAMMA, PLATE), ALPHA, GAMMA, PLATE)
        assert crossing is not None
        assert abs(crossing[0] - true) < 2 * crossing[1]
        widths.append(crossing[1])
    assert widths[1] == pytest.approx(2 * widths[0], rel=0.3)


def test_cups_that_lose_symmetry_in_the_primary_fall_are_not_those_of_the_buckling_law():
    rows = lawful_rows()
    thrown = {**rows[-1], "ratio": 24.0, "t_b": 0.05, "kappa_b": 4.0, "type_b": "jump"}
    one, other = (fit_laws(cups, GAMMA, PLATE).buckling for cups in (rows, [*rows, thrown]))
    assert one is not None and other is not None
    assert (one.slope, one.count) == (other.slope, other.count)


def test_laws_without_cups_are_missing():
    normal = [one for one in lawful_rows() if regime(one) == "normal"]
    fits = fit_laws(normal, GAMMA, PLATE)
    assert fits.buckling is None and fits.coefficients is None
    assert transition(fits, ALPHA, GAMMA, PLATE) is None


def test_first_change_skips_what_has_no_answer():
    answers = [(3.0, None), (1.0, False), (4.0, True), (2.0, False), (5.0, False)]
    assert first_change(answers) == Bracket(2.0, 4.0, True)
    assert changes(answers) == [Bracket(2.0, 4.0, True), Bracket(4.0, 5.0, False)]
    assert first_change([(1.0, True), (2.0, False)]) == Bracket(1.0, 2.0, False)
    assert first_change([(1.0, True), (2.0, True), (3.0, None)]) is None


def test_bisection_asks_for_all_at_once_and_finds_each():
    roots, batches = {"up": 1.3, "down": 7.9}, []

    def ask(questions):
        batches.append(dict(questions))
        return [x > roots[name] if name == "up" else x < roots[name] for name, x in questions]

    brackets = {"up": Bracket(0.0, 2.0), "down": Bracket(4.0, 12.0, answer_above=False)}
    found = bisect(brackets, {"up": 0.01, "down": 0.5}, ask)
    for name, bracket in found.items():
        assert bracket.low <= roots[name] <= bracket.high
    assert found["up"].half_width <= 0.01 and found["down"].half_width == 0.5
    assert set(batches[0]) == {"up", "down"} and set(batches[-1]) == {"up"}
    assert len(batches) == 7


def test_bisection_stops_where_there_is_no_answer():
    found = bisect({"a": Bracket(0.0, 1.0)}, {"a": 0.01}, lambda questions: [None])
    assert found["a"] == Bracket(0.0, 1.0)


def test_effects_are_ordered_by_size():
    found = effects(1.0, {"a": 0.9, "b": None, "c": 1.1}, {"a": 1.1, "b": 1.5, "c": 1.0})
    assert [one.name for one in found] == ["b", "a", "c"]
    assert found[0].size == pytest.approx(0.5)
