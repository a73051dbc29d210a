"""Slits beside round cups, from shells that are made up: who leads where, and which is lower.

Worth reading: `test_slits_lead_to_thicker_shells_and_round_cups_to_slenderer_ones`, in which a slit
is there from R/h = 12 on and a round cup up to 14.
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from opticcup_fem.case import parse_case
from opticcup_fem.diagram.coexistence import equal_energy, slices, thickest_slit
from opticcup_fem.errors import CaseError
from opticcup_fem.studies import coexistence
from opticcup_fem.studies.coexistence import Form, Pair, cup_of
from opticcup_fem.theory.prediction import cap_curvature_of_case


@dataclass
class Made:
    """A cup whose slit exists from R/h = 12 and whose round state up to 14; states are widths."""

    ratio: float

    def at_rest(self, state, t_n):
        buckled = self.ratio >= 12 and (state > 0.1 or self.ratio > 14)
        width = 0.05 * self.ratio if buckled else 0.0
        energy = 100.0 - (self.ratio - 12.75 if buckled else 0.0) + t_n
        return Form(width, energy, width, self.ratio > 14.2, self.ratio > 13.2)

    def grown(self, times):
        return {t_n: self.at_rest(0.0, t_n) for t_n in times}

    def towards_slit(self, state, t_n):
        return state + 0.3


RATIOS, TIMES = [15.0, 13.5, 13.0, 12.5, 12.0, 11.5], [0.31, 0.34]


@pytest.fixture
def made(monkeypatch):
    monkeypatch.setattr(coexistence, "_cups", lambda case, ratios: {r: Made(r) for r in ratios})
    return coexistence.pairs(parse_case({}), RATIOS, TIMES, 0.27)


def test_slits_lead_to_thicker_shells_and_round_cups_to_slenderer_ones(made):
    assert [(pair.ratio, pair.t_n) for pair in made] == [(r, t) for r in RATIOS for t in TIMES]
    slits = {pair.ratio for pair in made if pair.slit is not None}
    rounds = {pair.ratio for pair in made if pair.round_cup is not None}
    assert slits == {15.0, 13.5, 13.0, 12.5, 12.0}
    assert rounds == {13.5, 13.0, 12.5, 12.0, 11.5}


def test_energies_are_equal_where_the_excess_changes_its_sign(made):
    rows = [pair.row() for pair in made if pair.t_n == 0.31]
    assert equal_energy(rows) == pytest.approx(12.75)
    assert thickest_slit(rows) == 12.0
    by_ratio = {row["ratio"]: row for row in rows}
    assert by_ratio[13.0]["excess"] == pytest.approx(-0.25 / 100.31)
    assert by_ratio[12.5]["excess"] > 0
    assert by_ratio[15.0]["excess"] is None and by_ratio[15.0]["energy_round"] is None
    assert by_ratio[11.5]["excess"] is None and by_ratio[11.5]["energy_slit"] is None
    assert by_ratio[15.0]["slit_touches"] and not by_ratio[13.0]["slit_touches"]
    assert by_ratio[13.5]["slit_crosses_itself"] and not by_ratio[13.0]["slit_crosses_itself"]


def test_without_a_change_of_sign_no_energies_are_equal():
    rows = [Pair(13.0, 0.3, 6.0, None, None).row()]
    assert equal_energy(rows) is None and thickest_slit(rows) is None
    lower = [{"ratio": r, "excess": -1e-4, "energy_slit": 1.0} for r in (12.0, 13.0)]
    assert equal_energy(lower) is None and thickest_slit(lower) == 12.0


def test_a_closure_without_an_energy_is_refused():
    case = parse_case({"material": {"closure": "paper"}})
    with pytest.raises(CaseError, match="closure that has one"):
        cup_of(case, 5.0)


def test_slices_lie_between_the_shells_with_and_without(made):
    """The slit is gone between 12 and 11.5, the round cup between 13.5 and 15."""
    found = slices([pair.row() for pair in made])
    assert [one.t_n for one in found] == TIMES
    for one in found:
        assert (one.first, one.last) == (11.75, 14.25)
        assert one.equal == pytest.approx(12.75)
        case = parse_case({"shape": {"radius_over_thickness": 12.75}})
        kappa = float(cap_curvature_of_case(case, one.t_n))
        assert one.kappa_per_ratio * 12.75 == pytest.approx(kappa)


def test_slices_end_with_the_shells():
    """Cups that every shell has end with the last shell; cups that none has are nowhere."""
    rows = [
        {"ratio": r, "t_n": 0.2, "kappa_cap_R": r / 2, "excess": None, "energy_slit": 1.0}
        | {"energy_round": None}
        for r in (15.0, 12.0)
    ]
    (one,) = slices(rows)
    assert (one.first, one.last, one.equal, one.kappa_per_ratio) == (12.0, None, None, 0.5)
