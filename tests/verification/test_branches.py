"""Cups that are stable to small disturbances and not to finite ones: slits beside round cups.

Below the bifurcation at theta_b the m = 2 slit exists beside the axisymmetric cup.  It is reached
from a slenderer cup, whose axisymmetric state is unstable, by making the shell thicker.  Above it
the branch of slits is followed from the bifurcation by arc length.
"""

from __future__ import annotations

from mpi4py import MPI

import pytest

from opticcup_fem.case import parse_case
from opticcup_fem.contact.potential import EXEMPT
from opticcup_fem.contact.touch import TouchMeter
from opticcup_fem.observables import Observer
from opticcup_fem.shell.recovery import capture
from opticcup_fem.studies.coexistence import cup_of
from opticcup_fem.studies.model import shell_of, stepping_of

pytestmark = pytest.mark.slow

T_N = 0.31
MESH = {
    "cell_size_cap": 0.33,
    "cell_size_interface": 0.12,
    "cell_size_oov": 0.3,
    "symmetry": 4,
}


def test_slit_beside_the_stable_axisymmetric_cup() -> None:
    """R/h = 13, t_n = .31: both cups are stable, the slit is the lower one, and opens at a fold.

    The chain R/h = 15, 14, 13.5, 13 leads from a state that the bifurcation explains to one that
    exists beside the axisymmetric cup.  Numbers of this coarse mesh; finer ones are in
    docs/stability.md.
    """
    case = parse_case({"mesh": MESH, "contact": {"mode": "stop"}})
    slender = cup_of(case, 15.0)
    state = slender.towards_slit(slender.grown([0.27])[0.27].state, 0.27)
    for ratio in (15.0, 14.0, 13.5, 13.0):
        one = cup_of(case, ratio, slender.shell.surface_mesh)
        slit = one.at_rest(state, T_N)
        state = slit.state
        assert slit.m2 > 0.4
    assert not slit.crosses
    round_cup = one.grown([T_N])[T_N]
    assert round_cup.m2 < 1e-9
    assert slit.energy / round_cup.energy - 1 == pytest.approx(-9.2e-5, abs=1e-5)
    opened = next(p for p in one.stepping.follow(state, 0.4, t_start=T_N) if p.jump)
    # a residual of 1e-8 over the eigenvalue of m = 2, some 1e-3
    assert one.form(opened.state, opened.energy).m2 < 1e-4
    (end,) = opened.critical
    assert (end.kind, end.content.wavenumber) == ("limit_point", 2)
    assert end.t_n == pytest.approx(0.3707, abs=5e-4)


def test_branch_of_the_slit_is_subcritical_and_regains_stability() -> None:
    """R/h = 15: the m = 2 branch goes back in t_n from its bifurcation, unstable, turns, touches.

    The mesh has the symmetry that keeps the bifurcation sharp: the branch stays in m = 2, 4, ...
    """
    case = parse_case(
        {
            "shape": {"radius_over_thickness": 15.0},
            "mesh": MESH,
            "run": {"follow": "branch", "t_end": 0.4},
        }
    )
    shell = shell_of(case, MPI.COMM_SELF)
    stepping = stepping_of(case, shell)
    stem, branch = [], []
    observe = meter = None
    for point in stepping.follow(shell.reference_state(), 0.4):
        shell.set_time(point.t_n)
        snapshot = capture(shell, point.state, point.t_n)
        assert snapshot is not None
        observe = observe or Observer(snapshot)
        meter = meter or TouchMeter(snapshot, EXEMPT * shell.thickness)
        row = observe(snapshot)
        if branch or any(one.kind == "bifurcation" for one in point.critical):
            branch.append((point, row))
            nearest = meter(snapshot)
            if nearest is not None and nearest.gap <= 0:
                break
        else:
            stem.append(row)
    assert all(row["interface_m2"] < 1e-9 for row in stem)
    (bifurcation,) = branch[0][0].critical
    assert bifurcation.content.wavenumber == 2
    assert bifurcation.t_n == pytest.approx(0.2911, abs=1e-3)
    times = [point.t_n for point, _ in branch]
    assert times[1] < bifurcation.t_n and branch[1][0].negative_eigenvalues
    folds = [one for point, _ in branch[1:] for one in point.critical]
    assert folds and all(one.kind == "limit_point" for one in folds)
    assert folds[0].t_n == pytest.approx(0.0976, abs=1e-3)
    assert all(row["interface_m3"] < 1e-8 for _, row in branch)
    amplitudes = [row["interface_m2"] for _, row in branch]
    assert amplitudes[-1] > 0.5 and amplitudes[-1] == max(amplitudes)
    assert branch[-1][0].negative_eigenvalues == 0
    assert times[-1] == pytest.approx(0.136, abs=4e-3)
