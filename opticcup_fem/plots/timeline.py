"""When a movie shows which state: constant speed in t_n, slow motion through jumps.

Between two accepted states of one branch a frame shows the monotone cubic through the states around
it, along the distance that the shell moves (a branch that turns back at a limit point is smooth in
that, and not in t_n).  Across a jump there are no equilibria: the shell is shown before it, then
moved straight to the state after it in frames that are marked, then held there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from opticcup_fem.snapshot import Floats, Integers

HOLD_SECONDS, JUMP_SECONDS = 0.5, 1.2
"""How long a jump's two ends are held, and how long the transition between them takes."""

_LEAST = 1e-9
"""Distances between states are at least this: equal states have to be told apart."""


@dataclass(frozen=True)
class Moment:
    """Where on its path a run is in one frame.

    Attributes:
        before: Number of the last state at or before it.
        along: Share of the way to the next state, 0 to 1.
        t_n: Normalised time.
        jump: Whether the frame is part of a jump, and shows no equilibrium where 0 < along < 1.
        ended: Whether the run has ended before.
    """

    before: int
    along: float
    t_n: float
    jump: bool = False
    ended: bool = False


class Course:
    """The accepted states of a run on a clock that is t_n, or |dt_n| summed where it turns back."""

    def __init__(self, t_n: ArrayLike, jump: ArrayLike, gaps: ArrayLike) -> None:
        """Lay the states out.

        Args:
            t_n: Normalised times of the states in the path's order, shape (n,).
            jump: Whether the shell jumped onto the state, shape (n,).
            gaps: Distance from each state to the next one, shape (n - 1,).
        """
        self.t_n = np.asarray(t_n, dtype=float)
        self.branch: Integers = np.cumsum(np.asarray(jump, dtype=int))
        self.clock: Floats = self.t_n[0] + np.append(0.0, np.cumsum(np.abs(np.diff(self.t_n))))
        self._way = np.append(0.0, np.cumsum(np.maximum(np.asarray(gaps, dtype=float), _LEAST)))

    @property
    def jumps(self) -> list[int]:
        """Numbers of the states from which the shell jumps."""
        return [int(k) for k in np.flatnonzero(np.diff(self.branch))]

    def at(self, clock: float) -> Moment:
        """Return the moment that the clock shows; before a jump's end its beginning is held."""
        last = len(self.t_n) - 1
        if clock >= self.clock[-1]:
            return Moment(last, 0.0, float(self.t_n[-1]), ended=clock > self.clock[-1] + 1e-12)
        k = max(int(np.searchsorted(self.clock, clock, side="right")) - 1, 0)
        if self.branch[k] != self.branch[k + 1] or clock <= self.clock[k]:
            return Moment(k, 0.0, float(self.t_n[k]))
        share = np.linspace(0.0, 1.0, 129, dtype=np.float64)
        t = self._interpolated(k, share, lambda j: self.t_n[j])
        passed = np.abs(t - self.t_n[k])
        along = float(np.interp(clock - self.clock[k], np.maximum.accumulate(passed), share))
        return Moment(k, along, float(np.interp(along, share, t)))

    def within_jump(self, k: int, along: float) -> Moment:
        """Return a moment of the jump from state k."""
        t_n = (1 - along) * self.t_n[k] + along * self.t_n[k + 1]
        return Moment(k, float(along), float(t_n), jump=True)

    def value(self, moment: Moment, of: Callable[[int], ArrayLike]) -> Floats:
        """Return what the states have a value of, at a moment.

        Args:
            moment: The moment.
            of: Gives the value of a state, an array or a number, by its number.
        """
        k = moment.before
        if moment.along == 0.0:
            return np.asarray(of(k), dtype=float)
        if moment.jump:
            ends = [np.asarray(of(j), dtype=float) for j in (k, k + 1)]
            straight: Floats = (1 - moment.along) * ends[0] + moment.along * ends[1]
            return straight
        return self._interpolated(k, np.array(moment.along), of)

    def _interpolated(self, k: int, share: Floats, of: Callable[[int], ArrayLike]) -> Floats:
        """Return values between states k and k + 1 of one branch; the nearest four decide."""
        near = [
            j
            for j in range(max(k - 1, 0), min(k + 3, len(self.t_n)))
            if self.branch[j] == self.branch[k]
        ]
        curve = PchipInterpolator(self._way[near], np.stack([np.asarray(of(j)) for j in near]))
        between: Floats = curve(self._way[k] + share * (self._way[k + 1] - self._way[k]))
        return between


@dataclass(frozen=True)
class Frame:
    """One frame: the clock, and the moment of each run."""

    clock: float
    moments: tuple[Moment, ...]


def frames(courses: Sequence[Course], seconds: float, fps: int) -> list[Frame]:
    """Return the frames of one or more runs on one clock.

    Args:
        courses: The runs.
        seconds: Length of the movie without its jumps.
        fps: Frames a second.
    """
    first = min(float(course.clock[0]) for course in courses)
    last = max(float(course.clock[-1]) for course in courses)
    count = max(2, round(seconds * fps))
    ticks = [float(tick) for tick in np.linspace(first, last, count)]
    jumps = sorted((float(c.clock[k]), i, k) for i, c in enumerate(courses) for k in c.jumps)

    def shown(clock: float) -> list[Moment]:
        return [course.at(clock) for course in courses]

    made = [Frame(first, tuple(shown(first)))]
    for before, after in pairwise(ticks):
        while jumps and jumps[0][0] < after:
            clock, run, k = jumps.pop(0)
            for share in _shares(fps):
                moments = shown(max(clock, before))
                moments[run] = courses[run].within_jump(k, share)
                made.append(Frame(clock, tuple(moments)))
        made.append(Frame(float(after), tuple(shown(float(after)))))
    return made


def _shares(fps: int) -> NDArray[np.float64]:
    """Return how far along a jump its frames are: held, slowly off, slowly in, held."""
    hold = max(1, round(HOLD_SECONDS * fps))
    steps = np.linspace(0.0, 1.0, max(3, round(JUMP_SECONDS * fps)))
    return np.concatenate([np.zeros(hold), steps**2 * (3 - 2 * steps), np.ones(hold)])
