"""Critical points where the eigenvalues are known functions of t_n.

What matters: an eigenvalue that goes as a square root is a limit point's, one that goes linearly a
bifurcation's, and both are localised far better than the states that enclose them; eigenvalues are
told apart by their wavenumber.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from opticcup_fem.equilibrium.critical import (
    CriticalPoints,
    Known,
    _bracket,
    _crossing,
    _Sample,
    _zero,
)
from opticcup_fem.equilibrium.newton import Solution
from opticcup_fem.equilibrium.spectrum import Mode
from opticcup_fem.errors import ConvergenceError
from opticcup_fem.shell.model import ShellState
from opticcup_fem.wavenumbers import AzimuthalContent

Curve = Callable[[float], float]
"""An eigenvalue as a function of t_n."""


def state_at(t_n: float) -> ShellState:
    """Return a state that remembers its time: one node, at (t_n, 0, 0)."""
    return ShellState(np.array([[t_n, 0, 0]]), *[np.zeros((1, 3))] * 4)


@dataclass
class Invented:
    """A shell whose eigenvalues are given, by wavenumber; it is its own spectrum and solver."""

    curves: Sequence[tuple[int, Curve]]
    cosines: float = 0.0
    asymmetry: float = 0.0
    unsolved: tuple[float, float] = (2.0, 2.0)
    t_n: float = 0.0
    solved: list[float] = field(default_factory=list)

    @property
    def shell(self) -> "Invented":
        return self

    @property
    def problem(self) -> Any:
        return SimpleNamespace(with_mean_directors=lambda guess, last: guess)

    def set_time(self, t_n: float) -> None:
        self.t_n = t_n

    def with_updated_directors(self, state: ShellState) -> ShellState:
        return state

    def modes(self, state: ShellState, count: int = 8) -> list[Mode]:
        assert state.r[0, 0] == pytest.approx(self.t_n, abs=1e-14), "another state's growth"
        modes = [
            Mode(curve(self.t_n), np.array([[float(m), 0, 0]]), np.zeros(1))
            for m, curve in self.curves
        ]
        return sorted(modes, key=lambda mode: mode.eigenvalue)[:count]

    def cosine(self, state: ShellState, move: np.ndarray, mode: Mode) -> float:
        return self.cosines

    def solve(self, guess: ShellState) -> Solution:
        self.solved.append(self.t_n)
        converged = not self.unsolved[0] < self.t_n < self.unsolved[1]
        return Solution(guess, converged, "invented", 3, 0.0)

    def classify(self, state: ShellState, mode: Mode) -> AzimuthalContent:
        shares = [0.0] * 10
        shares[int(mode.r[0, 0])] = 1.0
        return AzimuthalContent(tuple(shares), tuple(shares[:9]), self.asymmetry)

    def points(self) -> CriticalPoints:
        parts: Any = self
        return CriticalPoints(parts, parts, self.classify, lambda state: state, 1e-7)

    def known(self, t_n: float) -> Known:
        return Known(t_n, state_at(t_n), sum(curve(t_n) < 0 for _, curve in self.curves))


def sample(t_n: float, eigenvalue: float) -> _Sample:
    return _Sample(
        t_n, eigenvalue, state_at(t_n), Mode(eigenvalue, np.zeros((1, 3)), np.zeros(1)), ()
    )


def test_zero_of_a_straight_line() -> None:
    """Between two points, beyond them, and with a level line the second one."""
    assert _zero((0.0, 1.0), (1.0, -3.0)) == pytest.approx(0.25)
    assert _zero((1.0, 4.0), (2.0, 3.0)) == pytest.approx(5.0)
    assert _zero((1.0, 4.0), (2.0, 4.0)) == 2.0


def test_crossing_is_that_of_the_cubic_through_four_samples() -> None:
    """Exact for a cubic, in any order of the samples, and the nearest four count."""

    def cubic(t: float) -> float:
        return (t - 0.37) * (1 + t + 2 * t * t)

    times = [0.5, 0.3, 0.1, 0.45]
    assert _crossing([sample(t, cubic(t)) for t in times]) == pytest.approx(0.37, abs=1e-10)
    far = [sample(-4.0, -1e6), *(sample(t, cubic(t)) for t in times)]
    assert _crossing(far) == pytest.approx(0.37, abs=1e-10)
    assert _bracket([sample(t, cubic(t)) for t in times]) == (0.3, 0.45)


def test_without_a_change_of_sign_there_is_no_crossing() -> None:
    with pytest.raises(ConvergenceError, match="no change of sign"):
        _bracket([sample(0.1, 1.0), sample(0.2, 0.5)])


def test_limit_point_by_the_square_of_its_eigenvalue() -> None:
    """sqrt(t_c - t) in m = 0: exact in t_c, which no equilibrium lies behind."""
    t_c = 0.5123
    cup = Invented([(0, lambda t: 3 * np.sqrt(t_c - t)), (2, lambda t: 1.7)])
    states = [(t, state_at(t)) for t in (0.45, 0.5, 0.51)]
    found = cup.points().at_loss(states, (0.515, None))
    assert (found.kind, found.lost, found.content.wavenumber) == ("limit_point", True, 0)
    assert found.t_n == pytest.approx(t_c, abs=1e-12)
    assert found.t_n_range == (0.51, 0.515) and found.at == 0.51 == cup.t_n
    assert found.eigenvalues == pytest.approx((3 * np.sqrt(t_c - 0.51), 1.7))


def test_limit_point_stays_inside_its_bracket() -> None:
    """Where the estimate leaves the bracket, its end counts: a solve failed there."""
    cup = Invented([(0, lambda t: np.sqrt(0.7 - t))])
    found = cup.points().at_loss([(t, state_at(t)) for t in (0.4, 0.5)], (0.51, None))
    assert found.t_n == 0.51


@pytest.mark.parametrize("beyond", [True, False])
def test_bifurcation_is_linear_in_the_eigenvalue(beyond: bool) -> None:
    """In m = 2: interpolated to the unstable state behind it, or extrapolated from before."""
    t_c = 0.512
    cup = Invented([(0, lambda t: 0.4), (2, lambda t: 2 * (t_c - t))])
    states = [(t, state_at(t)) for t in (0.49, 0.51)]
    found = cup.points().at_loss(states, (0.52, state_at(0.52) if beyond else None))
    assert (found.kind, found.lost, found.content.wavenumber) == ("bifurcation", True, 2)
    assert found.t_n == pytest.approx(t_c, abs=1e-12)
    assert found.mode.eigenvalue == pytest.approx(0.004)


@pytest.mark.parametrize(("cosine", "kind"), [(0.9, "limit_point"), (0.1, "bifurcation")])
def test_on_a_bent_branch_the_paths_direction_decides(cosine: float, kind: str) -> None:
    """There a limit point may have any wavenumber: its mode is the path's own direction."""
    cup = Invented([(2, lambda t: np.sqrt(0.6 - t))], cosines=cosine, asymmetry=0.1)
    states = [(t, state_at(t)) for t in (0.5, 0.55)]
    assert cup.points().at_loss(states, (0.61, None)).kind == kind


def test_bifurcations_between_two_states() -> None:
    """A pair is lost in m = 2 and one regained in m = 3, each localised, in the path's order."""
    curves: list[tuple[int, Curve]] = [
        (2, lambda t: (0.31 - t) * (1 + t)),
        (2, lambda t: (0.3102 - t) * (1 + t)),
        (3, lambda t: np.sin(t - 0.355)),
        (0, lambda t: 0.2),
        (4, lambda t: -0.3),  # negative at both ends: no crossing
        *((5, lambda t, k=k: 1.0 + k) for k in range(9)),
    ]
    cup = Invented(curves)
    points = cup.points().between(cup.known(0.3), cup.known(0.4))
    assert [(p.content.wavenumber, p.lost, p.kind) for p in points] == [
        (2, True, "bifurcation"),
        (3, False, "bifurcation"),
    ]
    assert points[0].t_n == pytest.approx(0.3101, abs=1e-5)
    assert points[1].t_n == pytest.approx(0.355, abs=1e-6)
    assert all(point.t_n_range == (0.3, 0.4) for point in points)
    back = cup.points().between(cup.known(0.4), cup.known(0.3))
    assert [(p.content.wavenumber, p.lost) for p in back] == [(3, True), (2, False)]


def test_bifurcation_that_cannot_be_solved_beside() -> None:
    """Where no state converges next to it, those around it are interpolated."""
    curves: list[tuple[int, Curve]] = [
        (2, lambda t: 0.345 - t - (t - 0.345) ** 2),
        *((5, lambda t, k=k: 1.0 + k) for k in range(9)),
    ]
    cup = Invented(curves, unsolved=(0.34, 0.35))
    (point,) = cup.points().between(cup.known(0.3), cup.known(0.4))
    assert not 0.34 < point.at < 0.35
    assert any(0.34 < t < 0.35 for t in cup.solved)
    assert point.t_n == pytest.approx(0.345, abs=1e-5)


def test_eigenvalue_that_is_not_found_is_an_error() -> None:
    """One that passes zero from so far away that it is hidden behind others: a shorter step."""
    curves: list[tuple[int, Curve]] = [(2, lambda t: 1000 * (0.3 - t))]
    cup = Invented([*curves, *((5, lambda t: 0.001) for _ in range(12))])
    with pytest.raises(ConvergenceError, match="too few eigenvalues near zero in wavenumber 2"):
        cup.points().between(cup.known(0.2), cup.known(0.301))
