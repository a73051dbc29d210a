"""The report from made-up results: every figure, its tables, the comparison, the page.

Worth reading: cups that obey the paper's laws must give back the paper's numbers in the table.
"""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

from opticcup_fem.errors import CaseError
from opticcup_fem.report import command
from opticcup_fem.report.figures.base import Comparison, followed_parts
from opticcup_fem.report.figures.material import _shallower
from opticcup_fem.report.plan import BY_ANGLE, RATIOS, SETS, SLITS
from opticcup_fem.report.registry import FIGURES
from opticcup_fem.report.results import Computed, compute
from tests.support.reports import cup, layers, path, plate, results


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    measured = pd.DataFrame({"t_n": [0.1, 0.5], "D_over_r": [0.4, 0.6]})
    page, missing = command._write(list(FIGURES), results(), measured, folder, "Made up.")
    assert missing == []
    return page


def test_every_figure_has_its_pictures_and_tables(report):
    page = report.read_text(encoding="utf-8")
    for name in FIGURES:
        for suffix in ("png", "svg"):
            assert (report.parent / f"{name}.{suffix}").stat().st_size > 5_000, name
        assert f'<h2 id="{name}">' in page
    for table in re.findall(r'href="([\w-]+\.csv)"', page):
        assert len(pd.read_csv(report.parent / table)) > 0, table


def test_the_page_needs_nothing_from_elsewhere(report):
    page = report.read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == len(FIGURES)
    assert not re.search(r'(src|href)="https?:', page)
    assert "<script" not in page and "Made up." in page


def test_lawful_cups_give_the_papers_coefficients(report):
    fits = pd.read_csv(report.parent / "fig4_fits.csv", dtype={"alpha / deg": str})
    for angle in ("40", "all"):
        of_angle = fits[fits["alpha / deg"] == angle]
        np.testing.assert_allclose(of_angle["slope"], of_angle["slope, paper"], rtol=2e-3)
        np.testing.assert_allclose(of_angle["offset"], of_angle["offset, paper"], rtol=2e-2)
    page = report.read_text(encoding="utf-8")
    line = page[page.index("theta_b of (6) at 40 deg") :]
    assert "2.447" in line[: line.index("</tr>")]


def test_slits_of_equal_energy_give_a_boundary(report):
    page = report.read_text(encoding="utf-8")
    line = page[page.index("if the cup of less energy is taken") :]
    line = line[: line.index("</tr>")]
    assert f"{np.radians(40) * np.sqrt(12.75):.4g}" in line and "12.75" in line
    summary = pd.read_csv(report.parent / "coexistence_summary.csv")
    assert list(summary["t_n"]) == sorted(SLITS["times"])
    assert set(summary["slit found down to R/h"]) == {12.0}


@pytest.mark.parametrize(
    ("depths", "answer"), [((0.6, 0.5, 0.4), "yes"), ((0.6, 0.5, 0.55), "no"), ((0.6, None), None)]
)
def test_cups_are_shallower_if_every_one_is(depths, answer):
    pairs = zip((20.0, 50.0, 100.0), depths, strict=False)
    cups = [Computed({"modulus_ratio": n}, depth_at(depth)) for n, depth in pairs]
    cups.append(Computed({"poisson_ratio": 0.4}, depth_at(0.1)))
    change = ("larger modulus ratio", cups, "modulus_ratio", True)
    line = _shallower(*change, "D_over_r_at_0.4", "D/r at t_n = 0.4")
    assert line.paper == "yes" and line.ours == answer
    assert line.note.startswith("n = 20: 0.600, n = 50: ") and "0.100" not in line.note


def depth_at(value):
    return {"status": "ok", "row": {"D_over_r_at_0.4": value}}


def test_what_the_paper_does_not_say_is_left_blank(report):
    page = report.read_text(encoding="utf-8")
    line = page[page.index("<td>n = 20</td>") :]
    assert line[: line.index("</tr>")].startswith("<td>n = 20</td><td></td><td>invaginates</td>")


def test_differences_are_numbers_or_words():
    assert Comparison("x", 2.0, 2.1).difference == "+0.1 (+5.0 %)"
    assert Comparison("x", -2.0, -2.1).difference == "-0.1 (-5.0 %)"
    assert Comparison("x", "yes", "no").difference == "differs"
    assert Comparison("x", "yes", "yes").difference == "agrees"
    assert Comparison("x", None, 2.1).difference == ""


def test_a_fall_is_drawn_at_its_time():
    before, after = followed_parts(path())
    assert before["t_n"][-1] == after["t_n"][0] == 0.04
    # a third of the way from the last state that no cup follows to the first that one does
    assert after["D_over_r"][0] == pytest.approx(0.3 + 0.05 / 3)


class Lawful:
    """An engine that knows without computing; thin cups at 40 degrees evade it."""

    def run(self, tasks, what=""):
        import json

        return [self.record(task.kind, json.loads(task.parameters)) for task in tasks]

    def record(self, kind, given):
        if kind == "plate":
            return plate(given["radius_over_thickness"])
        if kind == "layers":
            return layers({"times": given["output"]["times"]})
        shape, n = given["shape"], given["material"]["modulus_ratio"]
        settings = {
            "ratio": shape["radius_over_thickness"],
            "alpha_deg": shape["opening_angle_deg"],
        }
        record = cup(settings | {"modulus_ratio": 10.0 if n < 12.34 else n})
        record["row"]["type_1"] = "fold" if settings["ratio"] > 7.7 else "smooth"
        return record


def test_transitions_are_bracketed_between_cups_and_bisected():
    found = compute(Lawful(), ["slenderness", "angles", "evagination"])
    for name, value in {"theta_s 40": 7.7, "evagination": 12.34}.items():
        bracket = found.transitions[name]
        assert bracket.low <= value <= bracket.high
    assert found.transitions["evagination"].half_width <= 0.1
    # (4) and (5) with the paper's coefficients meet at theta_bar = 2.447
    bracket = found.transitions["theta_b 40"]
    assert bracket.low <= (2.447 / np.radians(40)) ** 2 <= bracket.high + 0.02
    assert bracket.half_width <= 0.03
    assert len(found.asked["theta_b 40"]) == 5


def test_the_plan_covers_what_the_report_promises():
    assert [one.settings["ratio"] for one in SETS["slenderness"]()] == list(RATIOS)
    assert set(RATIOS) == set(range(5, 21))
    assert all(len(ratios) >= 12 for ratios in BY_ANGLE.values())
    needs = {need for entry in FIGURES.values() for need in entry.needs}
    assert needs == set(SETS)


def test_a_figure_without_its_computations_says_why(tmp_path):
    found = results()
    for one in found.sets["shapes"]:
        one.record.clear()
        one.record.update({"status": "failed", "reason": "no equilibrium", "row": {}})
    page, missing = command._write(["s1", "s4"], found, None, tmp_path, "")
    assert len(missing) == 1
    assert missing[0].startswith("s1 is not drawn: ") and "no equilibrium" in missing[0]
    assert '<h2 id="s4">' in page.read_text(encoding="utf-8")


def test_names_and_measurements_are_checked(tmp_path):
    assert command.checked_names(["s4", "fig1"]) == ["fig1", "s4"]
    assert command.checked_names([]) == list(FIGURES)
    for text, part in {
        "t_n,depth\n0,1\n": "D_over_r or lambda_iov",
        "t_n,D_over_r\n0,deep\n": "something else than numbers",
    }.items():
        (tmp_path / "measured.csv").write_text(text)
        with pytest.raises(CaseError, match=part):
            command.read_experiment(tmp_path / "measured.csv")
    (tmp_path / "measured.csv").write_text("# eye 3\nt_n,D_over_r\n0.1,0.4\n")
    assert list(command.read_experiment(tmp_path / "measured.csv")["D_over_r"]) == [0.4]
