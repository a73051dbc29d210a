"""A forecast from cups that obey a simple law, in the place of computed ones.

Worth reading: the law says that cups buckle below R/h = 6 and beyond 14, and deepen at t_n = 4/n
otherwise.
"""

from __future__ import annotations

import json

import pytest

from opticcup_fem.errors import CaseError
from opticcup_fem.plots.tornado import tornado
from opticcup_fem.studies.predict import PARAMETERS, Geometry, _forecast
from opticcup_fem.studies.sweep.rows import empty_row

TABLES = {"material": {"modulus_ratio": 10.0, "poisson_ratio": 0.48}}


class Lawful:
    """An engine that knows without computing."""

    def run(self, tasks, what=""):
        records = []
        for task in tasks:
            case = json.loads(task.parameters)
            ratio = case["shape"]["radius_over_thickness"]
            n = case["material"]["modulus_ratio"]
            row = {**empty_row(), "t_1": 0.05, "type_1": "fold", "largest_D_over_r": 5 / ratio}
            if ratio > 14 or ratio < 6:
                row |= {"t_b": 0.3, "m_b": 2, "kappa_b": 12.0, "type_b": "bifurcation"}
            else:
                row |= {"t_2": 4 / n, "type_2": "smooth", "kappa_2": 9.0}
            records.append({"status": "ok", "reason": None, "row": row})
        return records


@pytest.fixture(scope="module")
def near():
    """A cup at R/h = 13, from which a tenth leads across the boundary."""
    return _forecast(Lawful(), Geometry(65.0, 5.0, TABLES))[0]


def test_fate_time_and_distance_from_the_boundary(near):
    assert near.fate == "normal"
    assert near.boundary is not None
    assert near.boundary.low < 14 < near.boundary.high
    assert near.boundary.half_width <= 0.01 * 15
    text = "\n".join(near.sentences())
    assert "R/h = 13" in text and "normal cup" in text
    assert "secondary invagination (smooth) at t_n = 0.4000 (8.0 h)" in text
    assert "8 % below it" in text
    assert "R +10 %: abnormal" in text and "h -10 %: abnormal" in text
    assert "n -10 %" not in text


def test_effects_of_each_parameter_have_their_sign_and_order(near):
    times = {one.name: one for one in near.times}
    assert next(iter(times)) in ("R", "h") and set(times) == set(PARAMETERS)
    assert times["n"].low == pytest.approx(4 / 9)
    assert times["n"].high == pytest.approx(4 / 11)
    assert times["R"].high == 0.3 and times["h"].low == 0.3
    assert (times["alpha"].low, times["alpha"].high) == (0.4, 0.4)
    depths = {one.name: one for one in near.depths}
    assert depths["R"].low == pytest.approx(5 / (13 * 0.9))
    assert depths["h"].high == pytest.approx(5 / (13 / 1.1))


def test_an_abnormal_cup_says_when_and_by_which_mode():
    forecast = _forecast(Lawful(), Geometry(100.0, 5.0, TABLES))[0]
    text = "\n".join(forecast.sentences())
    assert "abnormal cup" in text and "loss of symmetry (m = 2) at t_n = 0.3000 (6.0 h)" in text
    assert "above it" in text and "secondary" not in text
    assert "no single change" in text


def test_parameters_change_the_case():
    geometry = Geometry(50.0, 10.0, TABLES)
    assert geometry.case(R=1.1).shape.radius_over_thickness == pytest.approx(5.5)
    assert geometry.case(h=1.1).shape.radius_over_thickness == pytest.approx(5 / 1.1)
    assert geometry.case(alpha=0.9).shape.opening_angle_deg == pytest.approx(36)
    assert geometry.case(**{"IOV growth": 1.1}).growth.iov == pytest.approx(5.5)
    assert geometry.case(nu=1.1).material.poisson_ratio == 0.5
    assert geometry.case().run.model == "meridian"
    with pytest.raises(CaseError, match="geometry: shape"):
        Geometry(10.0, 10.0, TABLES).case()


def test_the_tornado_is_drawn(near, tmp_path):
    picture = tornado(near, tmp_path / "predict.png")
    assert picture.stat().st_size > 10_000
    assert (tmp_path / "predict.svg").exists()
