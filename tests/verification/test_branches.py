"""Cups that are stable to small disturbances and not to finite ones: slits beside round cups.

Below the bifurcation at theta_b the m = 2 slit exists beside the axisymmetric cup.  It is reached
from a slenderer cup, whose axisymmetric state is unstable, by making the shell thicker.
"""

from __future__ import annotations

import pytest

from opticcup_fem.case import parse_case
from opticcup_fem.studies.coexistence import cup_of

T_N = 0.31
SIZES = {"cell_size_cap": 0.34, "cell_size_interface": 0.12, "cell_size_oov": 0.3}


@pytest.mark.slow
def test_slit_beside_the_stable_axisymmetric_cup() -> None:
    """R/h = 13, t_n = .31: both cups are stable, the slit is the lower one and ends going back.

    The chain R/h = 15, 14, 13.5, 13 leads from a state that the bifurcation explains to one that
    exists beside the axisymmetric cup.  Where the slit ends depends on the mesh
    (docs/stability.md).
    """
    case = parse_case({"mesh": SIZES})
    slender = cup_of(case, 15.0)
    state = slender.towards_slit(slender.grown([0.27])[0.27].state, 0.27)
    for ratio in (15.0, 14.0, 13.5, 13.0):
        one = cup_of(case, ratio, slender.shell.surface_mesh)
        slit = one.at_rest(state, T_N)
        state = slit.state
        assert slit.m2 > 0.4
    assert not slit.crosses
    round_cup = one.grown([T_N])[T_N]
    assert round_cup.m2 < 0.02
    assert -1e-3 < slit.energy / round_cup.energy - 1 < 0
    back = list(one.stepping.follow(state, 0.29, t_start=T_N))
    (end,) = (critical for point in back for critical in point.critical)
    assert end.kind == "limit_point"
    assert end.t_n == pytest.approx(0.3035, abs=5e-3)
