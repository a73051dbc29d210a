"""Where a buckled cup exists beside the round one, and which of the two has less energy.

The loss of symmetry is subcritical: below the R/h at which small disturbances grow, a slit is an
equilibrium, too.  It is found where the round cup is unstable and followed to thicker shells.
Both cups stand on one mesh, so that most of its error leaves their difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from mpi4py import MPI

from opticcup_fem.case import Case, parse_case
from opticcup_fem.crossing import surface_check
from opticcup_fem.equilibrium.path import LoadStepping
from opticcup_fem.equilibrium.relaxation import Relaxed
from opticcup_fem.errors import CaseError, ConvergenceError
from opticcup_fem.mesh import SurfaceMesh
from opticcup_fem.observables import Observer
from opticcup_fem.shell.closures import CLOSURES
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.recovery import capture
from opticcup_fem.studies.model import (
    growth_of,
    mesh_of,
    sections_of,
    stepping_of,
    with_slenderness,
)
from opticcup_fem.theory.prediction import cap_curvature_of_case

ROUND = 0.1
"""Amplitude of the interface's m = 2, in R, above which a cup is a slit; slits have .4 and more,
round cups on meshes that are not quite round less than .03."""

PUSH = 0.3
"""Move along the mode m = 2, largest of a node in R, from the round cup towards the slit."""


@dataclass(frozen=True)
class Form:
    """A stable cup.

    Attributes:
        state: Its state.
        energy: Its strain energy, mu_IOV R^3.
        m2: Amplitude of the interface's m = 2, in R.
        touches: Whether its parts hold each other; never, where contact is not resisted.
        crosses: Whether the middle surface passes through itself: no tissue can take this form.
    """

    state: ShellState
    energy: float
    m2: float
    touches: bool
    crosses: bool

    @property
    def buckled(self) -> bool:
        """Whether it is a slit."""
        return self.m2 > ROUND


@dataclass(frozen=True)
class Pair:
    """The slit and the round cup of one R/h at one time; None where it is not there.

    Attributes:
        ratio: R/h.
        t_n: Normalised time.
        kappa_cap_R: Natural curvature of the cap, times R: the load axis of the phase diagram.
        slit: The buckled cup.
        round_cup: The axisymmetric cup.
    """

    ratio: float
    t_n: float
    kappa_cap_R: float
    slit: Form | None
    round_cup: Form | None

    def row(self) -> dict[str, Any]:
        """Return the numbers that tell the two apart."""
        both = self.slit is not None and self.round_cup is not None
        row: dict[str, Any] = {
            "ratio": self.ratio,
            "t_n": self.t_n,
            "kappa_cap_R": self.kappa_cap_R,
        }
        for name, form in (("slit", self.slit), ("round", self.round_cup)):
            row[f"energy_{name}"] = None if form is None else form.energy
        row["m2_slit"] = None if self.slit is None else self.slit.m2
        row["slit_touches"] = None if self.slit is None else self.slit.touches
        row["slit_crosses_itself"] = None if self.slit is None else self.slit.crosses
        row["excess"] = row["energy_slit"] / row["energy_round"] - 1 if both else None
        return row


@dataclass
class Cup:
    """One shell of a case, and what brings it to rest.

    Attributes:
        shell: The shell.
        stepping: What follows its stable states.
    """

    shell: Shell
    stepping: LoadStepping
    _observer: Observer | None = field(default=None, repr=False)

    def at_rest(self, state: ShellState, t_n: float) -> Form:
        """Return the stable cup at a time that descent finds from a state.

        Raises:
            ConvergenceError: It finds none.
        """
        self.shell.set_time(t_n)
        relaxed: Relaxed = self.stepping.relaxation.relax(state)
        if not relaxed.converged:
            raise ConvergenceError(
                relaxed.reason, t_n, 0, relaxed.iterations, float(relaxed.residual)
            )
        return self.form(relaxed.state, relaxed.energy)

    def form(self, state: ShellState, energy: float) -> Form:
        """Return a state, at the shell's time, with its numbers."""
        snapshot = capture(self.shell, state, self.shell.t_n)
        assert snapshot is not None  # one process
        self._observer = self._observer or Observer(snapshot)
        check, subdivision = surface_check(snapshot)
        crosses = check(subdivision.matrix @ snapshot.position) is not None
        touches = state.contact is not None and state.contact.touches
        return Form(state, energy, self._observer(snapshot)["interface_m2"], touches, crosses)

    def grown(self, times: Sequence[float]) -> dict[float, Form]:
        """Return the states at some times of the path that is stable from the start.

        Raises:
            ConvergenceError: The path ends early.
        """
        found: dict[float, Form] = {}
        for point in self.stepping.follow(self.shell.reference_state(), max(times), times):
            for t_n in times:
                if abs(point.t_n - t_n) < 1e-12:
                    found[t_n] = self.form(point.state, point.energy)
        if (failure := self.stepping.failure()) is not None:
            raise failure
        return found

    def towards_slit(self, state: ShellState, t_n: float) -> ShellState:
        """Return a round state at a time, moved along its softest mode of m = 2."""
        critical = self.stepping.critical
        assert critical is not None  # a closure with an energy
        self.shell.set_time(t_n)
        mode = critical.softest(t_n, state, 2)
        if mode is None:
            raise ConvergenceError("no mode of m = 2 was found", t_n, 0, 0, 0.0)
        return mode.moved(state, PUSH)


def cup_of(case: Case, ratio: float, mesh: SurfaceMesh | None = None) -> Cup:
    """Return a cup of R/h = ``ratio`` on this process alone.

    Args:
        case: The case; its own R/h is not looked at.
        ratio: R/h.
        mesh: The mesh, that of the case with this R/h by default.

    Raises:
        CaseError: The closure has no energy, or the case does not follow stable states.
    """
    if case.run.follow != "stable" or not CLOSURES[case.material.closure].has_energy:
        raise CaseError(
            "energies are compared of stable states of a closure that has one: take "
            'run.follow = "stable" and layer-stretch, condensed or stationary'
        )
    case = with_slenderness(case, ratio)
    mesh = mesh or mesh_of(case, MPI.COMM_SELF)
    shell = Shell(mesh, sections_of(case), growth_of(case), case.material.closure)
    stepping = stepping_of(case, shell)
    assert isinstance(stepping, LoadStepping)
    return Cup(shell, stepping)


def pairs(case: Case, ratios: Sequence[float], times: Sequence[float], before: float) -> list[Pair]:
    """Return slits and round cups of a case at all of some R/h and times.

    Slits lead from one R/h to the next thicker one at the same time; where one opens, all thicker
    ones are missing, too.  Round cups lead from the thickest R/h to slenderer ones; where descent
    finds no round cup, it is unstable, and it and all slenderer ones are missing.

    Args:
        case: The case, whose mesh for the slenderest R/h serves all.
        ratios: Values of R/h, the slenderest first; at the first of ``times`` its
            round cup is unstable.
        times: Normalised times, in this order; slits lead from the nearest one before to each.
        before: A normalised time after the primary invagination at which the slenderest round
            cup is stable.

    Raises:
        ConvergenceError: No equilibrium was found where there must be one.
    """
    cups = _cups(case, ratios)
    slits = _slits(cups, ratios, times, before)
    rounds = _round_cups(cups, ratios, times)
    return [
        Pair(
            ratio,
            t_n,
            float(cap_curvature_of_case(with_slenderness(case, ratio), t_n)),
            slits.get((ratio, t_n)),
            rounds.get((ratio, t_n)),
        )
        for ratio in ratios
        for t_n in times
    ]


def _cups(case: Case, ratios: Sequence[float]) -> dict[float, Cup]:
    """Return the cups, all on the mesh of the first."""
    slender = cup_of(case, ratios[0])
    mesh = slender.shell.surface_mesh
    return {ratios[0]: slender} | {ratio: cup_of(case, ratio, mesh) for ratio in ratios[1:]}


Forms = dict[tuple[float, float], Form]


def _slits(
    cups: Mapping[float, Cup], ratios: Sequence[float], times: Sequence[float], before: float
) -> Forms:
    found: Forms = {}
    slender = cups[ratios[0]]
    start = slender.towards_slit(slender.grown([before])[before].state, before)
    for t_n in times:
        known = [time for ratio, time in found if ratio == ratios[0]]
        if known:
            start = found[ratios[0], min(known, key=lambda time: abs(time - t_n))].state
        for ratio in ratios:
            form = cups[ratio].at_rest(start, t_n)
            if not form.buckled:
                break
            found[ratio, t_n] = form
            start = form.state
    return found


def _round_cups(
    cups: Mapping[float, Cup], ratios: Sequence[float], times: Sequence[float]
) -> Forms:
    thickest = cups[ratios[-1]].grown(sorted(times))
    found: Forms = {}
    for t_n in times:
        form = thickest[t_n]
        for ratio in reversed(ratios):
            try:
                form = cups[ratio].at_rest(form.state, t_n)
            except ConvergenceError:  # on a mesh with mirror planes nothing leads out of it
                break
            if form.buckled:
                break
            found[ratio, t_n] = form
    return found


def task(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Compute slits and round cups as a task of a sweep.

    Args:
        parameters: ``case`` as nested tables; ``ratios``, ``times``, ``before`` as ``pairs`` has
            them.

    Returns:
        ``pairs``: ``Pair.row`` of each; ``reason`` None.
    """
    found = pairs(
        parse_case(parameters["case"]),
        parameters["ratios"],
        parameters["times"],
        parameters["before"],
    )
    return {"row": {}, "pairs": [pair.row() for pair in found], "reason": None}
