r"""Critical points of a path: where eigenvalues of the tangent pass zero, and by which motion.

At a limit point the path turns back in t_n and its tangent is the critical mode; near it the
eigenvalue goes as the square root of the distance in t_n.  At a bifurcation the path goes on, the
eigenvalue passes zero linearly, and the mode is another than the path's own direction.  Modes
cos m phi and sin m phi pass together, so that the sign of det H would not change: eigenvalues are
counted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import brentq

from opticcup_fem.equilibrium.newton import MixedNewton
from opticcup_fem.equilibrium.spectrum import Mode, Spectrum
from opticcup_fem.errors import ConvergenceError
from opticcup_fem.shell.model import ShellState
from opticcup_fem.wavenumbers import AzimuthalContent

Classify = Callable[[ShellState, Mode], AzimuthalContent]
"""Returns the azimuthal content of a mode of a state, on every rank (collective)."""

Symmetrise = Callable[[ShellState], ShellState]
"""Returns the axisymmetric mean of a state, in local equilibrium (collective)."""

ALONG_THE_PATH = 0.5
"""Share of the path's direction that the critical mode of a limit point has at least."""

NEARLY_AXISYMMETRIC = 3e-3
"""Asymmetry of a state that an imperfect mesh may have bent, so near a bifurcation that the path
turns back; a branch that has lost its symmetry has more."""

PROBES = 6
"""Rounds of solving for states between two others in the search for a bifurcation."""

MOST_MODES = 48
"""Negative eigenvalues are not looked for among more modes than this."""


@dataclass(frozen=True)
class CriticalPoint:
    """An eigenvalue passes zero.

    Attributes:
        t_n: Normalised time.
        kind: Whether the path turns back there, or another one crosses it.
        lost: Whether stability against the mode is lost in the direction of the path, or regained.
        t_n_range: Normalised times of the states that enclose it, in the order of the path.
        at: Normalised time of ``state``.
        state: An equilibrium right beside it.
        mode: The critical mode there.
        content: Its azimuthal content.
        eigenvalues: The eigenvalues nearest to zero there, lowest first.
    """

    t_n: float
    kind: Literal["limit_point", "bifurcation"]
    lost: bool
    t_n_range: tuple[float, float]
    at: float
    state: ShellState
    mode: Mode
    content: AzimuthalContent
    eigenvalues: tuple[float, ...]


@dataclass(frozen=True)
class Known:
    """An equilibrium with its time and its number of negative eigenvalues."""

    t_n: float
    state: ShellState
    negative: int


class CriticalPoints:
    """Localises and classifies the critical points between states of a path."""

    def __init__(
        self,
        spectrum: Spectrum,
        newton: MixedNewton,
        classify: Classify,
        symmetrise: Symmetrise,
        tolerance: float = 1e-5,
    ) -> None:
        """Keep the parts.

        Args:
            spectrum: Eigenvalues of the shell's states.
            newton: Solver of the states in between.
            classify: Azimuthal content of a mode.
            symmetrise: Axisymmetric mean of a state.
            tolerance: Accuracy in t_n of a bifurcation between two equilibria.
        """
        self.spectrum, self.newton = spectrum, newton
        self.classify, self.symmetrise = classify, symmetrise
        self.tolerance = tolerance

    def at_loss(
        self, states: Sequence[tuple[float, ShellState]], beyond: tuple[float, ShellState | None]
    ) -> CriticalPoint:
        """Return the critical point right behind the last state of a path (collective).

        Args:
            states: Normalised times and states that the path passed, in its order.
            beyond: Normalised time of the attempt that failed, and the unstable equilibrium there
                if one was found.
        """
        t_1, state = states[-1]
        modes = self._modes_at(t_1, state)
        mode = _nearest(modes)
        t_2, unstable = beyond
        content = self.classify(state, mode)
        if content.asymmetry < NEARLY_AXISYMMETRIC:
            limit = content.wavenumber == 0
        else:
            limit = self._along_the_path(states, mode) > ALONG_THE_PATH
        t_c = (t_1 + t_2) / 2
        if unstable is not None and not limit:
            other = _nearest(self._modes_at(t_2, unstable))
            t_c = _zero((t_1, mode.eigenvalue), (t_2, other.eigenvalue))
        elif len(states) > 1:
            t_0, before = states[-2]
            other = _nearest(self._modes_at(t_0, before))
            power = 2 if limit else 1
            t_c = _zero((t_0, other.eigenvalue**power), (t_1, mode.eigenvalue**power))
        # an imperfect mesh rounds the eigenvalue's passage off: the bracket is certain
        t_c = min(max(t_c, min(t_1, t_2)), max(t_1, t_2))
        self.spectrum.shell.set_time(t_1)
        return CriticalPoint(
            t_c,
            "limit_point" if limit else "bifurcation",
            limit or mode.eigenvalue > 0,
            (t_1, t_2),
            t_1,
            state,
            mode,
            content,
            tuple(one.eigenvalue for one in modes),
        )

    def at_limit_point(self, before: Known, t_n: float, state: ShellState) -> CriticalPoint:
        """Return a limit point that was localised by arc length, with its mode (collective).

        Args:
            before: The state before it on the path.
            t_n: Its normalised time.
            state: The equilibrium there.
        """
        lost = _nearest(self._modes_at(before.t_n, before.state)).eigenvalue > 0
        modes = self._modes_at(t_n, state)
        mode = _nearest(modes)
        values = tuple(one.eigenvalue for one in modes)
        content = self.classify(state, mode)
        times = (before.t_n, t_n)
        return CriticalPoint(t_n, "limit_point", lost, times, t_n, state, mode, content, values)

    def softest(self, t_n: float, state: ShellState, wavenumber: int) -> Mode | None:
        """Return the mode of a wavenumber with the eigenvalue nearest to zero (collective).

        Returns:
            None if there is none among the modes near zero.
        """
        modes = self._modes_at(t_n, state, 16)
        of_m = [one for one in modes if self.classify(state, one).wavenumber == wavenumber]
        return _nearest(of_m) if of_m else None

    def between(self, low: Known, high: Known) -> list[CriticalPoint]:
        """Return the bifurcations between neighbouring axisymmetric equilibria (collective).

        Raises:
            ConvergenceError: The eigenvalues that pass zero were not found at both states.
        """
        counts = [self.negative_by_wavenumber(end) for end in (low, high)]
        found = []
        for m in sorted({*counts[0], *counts[1]}):
            first, last = (count.get(m, 0) for count in counts)
            if first != last:
                places = range(min(first, last), max(first, last))
                found.append(self._localised(low, high, m, places, last > first))
        return sorted(found, key=lambda point: abs(point.t_n - low.t_n))

    def negative_by_wavenumber(self, point: Known) -> dict[int, int]:
        """Return how many of a state's negative eigenvalues belong to each wavenumber."""
        counts: dict[int, int] = {}
        for mode in self._negative(point):
            m = self.classify(point.state, mode).wavenumber
            counts[m] = counts.get(m, 0) + 1
        return counts

    def _negative(self, point: Known) -> list[Mode]:
        """Return all modes of negative eigenvalue of a state."""
        if point.negative == 0:
            return []
        count = point.negative + 6
        while True:
            modes = self._modes_at(point.t_n, point.state, count)
            negative = [mode for mode in modes if mode.eigenvalue < 0]
            if len(negative) >= point.negative or count >= MOST_MODES:
                return negative
            count = min(2 * count, MOST_MODES)

    def _localised(
        self, low: Known, high: Known, m: int, places: range, lost: bool
    ) -> CriticalPoint:
        """Return where eigenvalues of given places in the order of wavenumber m pass zero.

        An unsymmetric mesh rounds a bifurcation off: right beside it no axisymmetric state can be
        solved for.  States around it are, as near as they converge, and the mean of the
        eigenvalues, which the mesh splits, is interpolated between them.
        """
        ends = [self._sample(end.t_n, end.state, m, places) for end in (low, high)]
        samples = {sample.t_n: sample for sample in ends}
        t_c = _crossing(list(samples.values()))
        for _ in range(PROBES):
            before = t_c
            around = _bracket(list(samples.values()))
            for t_n in (t_c, (around[0] + t_c) / 2, (around[1] + t_c) / 2):
                try:
                    state = self._state_between(low, high, t_n)
                    samples[t_n] = self._sample(t_n, state, m, places)
                    break
                except ConvergenceError:
                    continue
            else:
                break
            t_c = _crossing(list(samples.values()))
            if abs(t_c - before) < self.tolerance:
                break
        nearest = samples[min(samples, key=lambda t_n: abs(t_n - t_c))]
        self.spectrum.shell.set_time(nearest.t_n)
        return CriticalPoint(
            t_c,
            "bifurcation",
            lost,
            (low.t_n, high.t_n),
            nearest.t_n,
            nearest.state,
            nearest.mode,
            self.classify(nearest.state, nearest.mode),
            nearest.eigenvalues,
        )

    def _sample(self, t_n: float, state: ShellState, m: int, places: range) -> _Sample:
        """Return the mean of eigenvalues of given places in the order of wavenumber m.

        Raises:
            ConvergenceError: There are fewer of that wavenumber near zero.
        """
        modes = self._modes_at(t_n, state, places.stop + 8)
        of_m = [one for one in modes if self.classify(state, one).wavenumber == m]
        if len(of_m) < places.stop:
            reason = f"too few eigenvalues near zero in wavenumber {m}"
            raise ConvergenceError(reason, t_n, 0, 0, np.nan)
        mean = float(np.mean([of_m[place].eigenvalue for place in places]))
        values = tuple(one.eigenvalue for one in modes)
        return _Sample(t_n, mean, state, of_m[places.start], values)

    def _state_between(self, low: Known, high: Known, t_n: float) -> ShellState:
        """Return the axisymmetric equilibrium at ``t_n`` between two others.

        Raises:
            ConvergenceError: It could not be solved for.
        """
        share = (t_n - low.t_n) / (high.t_n - low.t_n)
        self.spectrum.shell.set_time(t_n)
        start, end = self.symmetrise(low.state), self.symmetrise(high.state)
        guess = start.plus(end.minus(start), share)
        solution = self.newton.solve(self.newton.problem.with_mean_directors(guess, start))
        if not solution.converged:
            raise ConvergenceError(solution.reason, t_n, 0, solution.iterations, solution.residual)
        return self.spectrum.shell.with_updated_directors(solution.state)

    def _modes_at(self, t_n: float, state: ShellState, count: int = 8) -> list[Mode]:
        self.spectrum.shell.set_time(t_n)
        return self.spectrum.modes(state, count)

    def _along_the_path(self, states: Sequence[tuple[float, ShellState]], mode: Mode) -> float:
        """Return the cosine between the path's last move and a mode, 0 for a single state."""
        if len(states) < 2:
            return 0.0
        (_, before), (_, last) = states[-2:]
        return self.spectrum.cosine(last, last.r - before.r, mode)


@dataclass(frozen=True)
class _Sample:
    """A state beside a bifurcation: the eigenvalue that passes zero, its mode, its neighbours."""

    t_n: float
    eigenvalue: float
    state: ShellState
    mode: Mode
    eigenvalues: tuple[float, ...]


def _bracket(samples: Sequence[_Sample]) -> tuple[float, float]:
    """Return the times of the two neighbours, in order of t_n, between which the sign changes."""
    ordered = sorted(samples, key=lambda one: one.t_n)
    for low, high in pairwise(ordered):
        if (low.eigenvalue < 0) != (high.eigenvalue < 0):
            return low.t_n, high.t_n
    raise ConvergenceError("no change of sign", ordered[0].t_n, 0, 0, np.nan)


def _crossing(samples: Sequence[_Sample]) -> float:
    """Return where the eigenvalue, interpolated through its four nearest samples, is zero."""
    low, high = _bracket(samples)
    near = sorted(samples, key=lambda one: abs(one.t_n - (low + high) / 2))[:4]
    curve = BarycentricInterpolator([one.t_n for one in near], [one.eigenvalue for one in near])
    return float(brentq(lambda t: float(curve(t)), low, high))


def _nearest(modes: Sequence[Mode]) -> Mode:
    """Return the mode whose eigenvalue is nearest to zero."""
    return min(modes, key=lambda mode: abs(mode.eigenvalue))


def _zero(first: tuple[float, float], second: tuple[float, float]) -> float:
    """Return where the straight line through two points (x, y) is zero."""
    (x_1, y_1), (x_2, y_2) = first, second
    return x_2 if y_1 == y_2 else x_1 - y_1 * (x_2 - x_1) / (y_2 - y_1)
