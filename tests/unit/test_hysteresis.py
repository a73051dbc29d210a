"""The slit beside the round cup: what is read off the states, and what is refused.

What matters: the region's ends and the equality of energies come from the right branches, and a
case without a slit gets one sentence.
"""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from opticcup_fem.errors import CaseError
from opticcup_fem.plots.hysteresis import hysteresis
from opticcup_fem.studies.hysteresis import TABLE, _crossing, _found, _Ledger, _require
from opticcup_fem.studies.model import with_slenderness
from opticcup_fem.studies.progress import Progress
from tests.support.cups import coarse_case


def row(branch: str, t_n: float, energy: float, slit: bool, ratio: float = 15.0) -> dict:
    return {
        "branch": branch,
        "radius_over_thickness": ratio,
        "t_n": t_n,
        "energy": energy,
        "slit": slit,
        "mouth_width_over_R": 0.2 if slit else 0.6,
    }


ROWS = [
    *(row("on", t, t, t > 0.28) for t in (0.1, 0.2, 0.3)),
    *(row("back", t, t + 0.1 * (0.16 - t), slit=t > 0.1) for t in (0.3, 0.2, 0.15, 0.1)),
    *(row("round", t, t, slit=False) for t in (0.1, 0.15, 0.2, 0.3)),
]
THICKER = [
    row("thicker", 0.3, 1.0, True, 14.0),
    row("thicker round", 0.3, 1.1, False, 14.0),
    row("thicker", 0.3, 1.1, True, 13.0),
    row("thicker round", 0.3, 1.05, False, 13.0),
    row("thicker", 0.3, 1.05, False, 12.0),
]


def ledger(rows: list[dict], path: Path | None = None) -> _Ledger:
    kept = _Ledger(path, Progress(1.0, shown=False))
    for one in rows:
        kept.add(one)
    return kept


def test_rows_are_in_the_table_at_once(tmp_path: Path) -> None:
    """Whatever ends the study, what was computed is there."""
    kept = ledger(ROWS[:2], tmp_path / TABLE)
    assert list(pd.read_csv(tmp_path / TABLE).t_n) == [0.1, 0.2]
    kept.add(ROWS[2])
    assert list(pd.read_csv(tmp_path / TABLE).slit) == [False, False, True]


def test_stiffness_goes_with_the_thickness_squared() -> None:
    """From R/h = 15 to 10, (h/R)^2 grows 2.25 times; nothing else changes."""
    case = coarse_case(15.0, contact={"mode": "resist", "stiffness": 2.0})
    thicker = with_slenderness(case, 10.0)
    assert thicker.contact.stiffness == pytest.approx(4.5)
    assert thicker.shape.radius_over_thickness == 10.0
    assert thicker.mesh == case.mesh and thicker.solver == case.solver


def test_ends_and_equality_are_read_off_the_branches() -> None:
    """The slit opens after .15; its energy falls below the round cup's at .16, and at 13.33."""
    found = _found(ledger([*ROWS, *THICKER]))
    assert found.ok and found.opens == (0.1, 0.15)
    assert found.equal == pytest.approx(0.16)
    assert found.lost == (12.0, 13.0)
    assert found.equal_ratio == pytest.approx(13 + 0.05 / 0.15)
    for words in ("between t_n = 0.1 and 0.15", "t_n = 0.1600", "R/h = 12 and 13", "R/h = 13.333"):
        assert words in found.message


def test_a_slit_that_stays_is_no_hysteresis() -> None:
    found = _found(ledger([r for r in ROWS if r["t_n"] > 0.1]))
    assert not found.ok and found.opens is None and found.lost is None
    assert "did not become a slit" in found.message


def test_last_change_of_sign_counts() -> None:
    """Energies that are equal where the slit does not exist yet do not count."""
    assert _crossing({0.1: 1.0, 0.2: -1.0, 0.3: 1.0, 0.5: -1.0}) == pytest.approx(0.4)
    assert _crossing({0.1: 1.0, 0.2: 2.0}) is None


def test_wrong_cases_are_refused() -> None:
    """One sentence each."""
    with pytest.raises(CaseError, match=r'contact\.mode = "stop" is not possible: a slit'):
        _require(coarse_case(15.0, contact={"mode": "stop"}), None)
    resisting = coarse_case(15.0, 0.3)
    with pytest.raises(CaseError, match=r"--at 0\.25 is not possible: take one of output\.times"):
        _require(resisting, 0.25)
    _require(resisting, 0.3)
    with pytest.raises(CaseError, match="imperfection"):
        _require(coarse_case(imperfection={"amplitude": 0.1}), None)


def test_picture_shows_excess_in_per_cent(tmp_path: Path) -> None:
    """Drawn from the table alone, with and without thicker shells."""
    for rows in (ROWS, [*ROWS, *THICKER]):
        pd.DataFrame(rows).to_csv(tmp_path / "table.csv", index=False)
        picture = hysteresis(tmp_path / "table.csv", tmp_path / "picture.png")
        assert picture.stat().st_size > 5000
    assert np.isfinite(pd.read_csv(tmp_path / "table.csv").energy).all()
