"""Cups that are stable to small disturbances and not to finite ones: slits beside round cups.

Below the bifurcation at theta_b the m = 2 slit exists beside the axisymmetric cup.  It is reached
from a slenderer cup, whose axisymmetric state is unstable, by making the shell thicker.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import pytest

from opticcup_fem.case import parse_case
from opticcup_fem.crossing import surface_check
from opticcup_fem.equilibrium.path import LoadStepping, PathPoint
from opticcup_fem.mesh import SurfaceMesh
from opticcup_fem.observables import Observer
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.recovery import capture
from opticcup_fem.studies.model import growth_of, mesh_of, sections_of, stepping_of

T_N = 0.31
SIZES = {"cell_size_cap": 0.34, "cell_size_interface": 0.12, "cell_size_oov": 0.3}


@dataclass
class Cup:
    """A shell of some slenderness and what follows its stable states."""

    shell: Shell
    stepping: LoadStepping

    def at(self, state: ShellState) -> PathPoint:
        """Return the stable state at t_n = .31 that relaxation finds from ``state``."""
        self.shell.set_time(T_N)
        relaxed = self.stepping.relaxation.relax(state)
        assert relaxed.converged, relaxed.reason
        return PathPoint(
            T_N, relaxed.state, False, relaxed.negative_eigenvalues, 0, 0.0, relaxed.energy
        )

    def slit(self, state: ShellState) -> float:
        """Return the amplitude of the interface circle's m = 2."""
        snapshot = capture(self.shell, state, self.shell.t_n)
        assert snapshot is not None
        return Observer(snapshot)(snapshot)["interface_m2"]

    def crosses_itself(self, state: ShellState) -> bool:
        """Return whether the middle surface crosses itself."""
        snapshot = capture(self.shell, state, self.shell.t_n)
        assert snapshot is not None
        check, subdivision = surface_check(snapshot)
        return check(subdivision.matrix @ snapshot.position) is not None


def cup(ratio: float, mesh: SurfaceMesh | None) -> Cup:
    """Return a cup, on the mesh of another one where it is given."""
    case = parse_case(
        {"shape": {"radius_over_thickness": ratio}, "mesh": dict(SIZES), "run": {"t_end": T_N}}
    )
    mesh = mesh or mesh_of(case, MPI.COMM_SELF)
    shell = Shell(mesh, sections_of(case), growth_of(case), case.material.closure)
    stepping = stepping_of(case, shell)
    assert isinstance(stepping, LoadStepping)
    return Cup(shell, stepping)


def axisymmetric_state(one: Cup, t_end: float = T_N) -> PathPoint:
    """Return the axisymmetric cup at ``t_end``."""
    return list(one.stepping.follow(one.shell.reference_state(), t_end))[-1]


@pytest.mark.slow
def test_slit_beside_the_stable_axisymmetric_cup() -> None:
    """R/h = 13, t_n = .31: both cups are stable, the slit is the lower one and ends going back.

    The chain R/h = 15, 14, 13.5, 13 leads from a state that the bifurcation explains to one that
    exists beside the axisymmetric cup.  Where the slit ends depends on the mesh
    (docs/stability.md).
    """
    slender = cup(15.0, None)
    mesh = slender.shell.surface_mesh
    before = axisymmetric_state(slender, 0.27)
    critical = slender.stepping.critical
    assert critical is not None
    slender.shell.set_time(0.27)
    mode = critical.spectrum.modes(before.state)[0]
    state = mode.moved(before.state, 0.3)
    for ratio in (15.0, 14.0, 13.5, 13.0):
        one = cup(ratio, mesh)
        slit = one.at(state)
        state = slit.state
        assert slit.negative_eigenvalues == 0 and one.slit(state) > 0.4
    assert not one.crosses_itself(state)
    round_cup = axisymmetric_state(one)
    assert round_cup.negative_eigenvalues == 0 and one.slit(round_cup.state) < 0.02
    assert -1e-3 < slit.energy / round_cup.energy - 1 < 0
    back = list(one.stepping.follow(state, 0.29, t_start=T_N))
    (end,) = (critical for point in back for critical in point.critical)
    assert end.kind == "limit_point"
    assert end.t_n == pytest.approx(0.3035, abs=5e-3)
