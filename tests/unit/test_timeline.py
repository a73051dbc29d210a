"""When a movie shows which state.

What matters: steady speed in t_n, no equilibrium where there is none, and that what lies between
two states is on the curve through their neighbours.
"""

import numpy as np
import pytest

from opticcup_fem.plots.timeline import Course, frames

T = np.array([0.0, 0.1, 0.3, 0.3001, 0.5, 1.0])
JUMP = np.array([False, False, False, True, False, False])


@pytest.fixture
def course() -> Course:
    """Return a path that jumps between its third and its fourth state."""
    return Course(T, JUMP, [0.1, 0.2, 1.0, 0.2, 0.5])


def test_time_goes_on_steadily_but_for_jumps(course: Course) -> None:
    """Outside jumps the frames' t_n are equally spaced from the first to the last state."""
    shown = frames([course], seconds=4.0, fps=10)
    steady = [frame.moments[0].t_n for frame in shown if not frame.moments[0].jump]
    assert len(steady) == 40
    # while the clock is in the jump's own step its beginning is held
    np.testing.assert_allclose(steady, np.linspace(0, 1, 40), atol=2e-4)


def test_jumps_are_slow_and_marked(course: Course) -> None:
    """Held, moved from one state to the next, held: 0.5 s, 1.2 s, 0.5 s."""
    shown = [frame.moments[0] for frame in frames([course], seconds=4.0, fps=10)]
    marked = [k for k, moment in enumerate(shown) if moment.jump]
    assert marked == list(range(marked[0], marked[0] + 22))
    along = np.array([shown[k].along for k in marked])
    assert (np.diff(along) >= 0).all()
    assert (along[:5] == 0).all() and (along[-5:] == 1).all()
    assert {shown[k].before for k in marked} == {2}
    assert course.value(shown[marked[-1]], lambda k: T[k]) == T[3]
    assert all(not m.jump or m.before == 2 for m in shown)


def test_between_states_of_a_branch_the_curve_is_smooth() -> None:
    """Near a limit point t_n = 1 - (1 - s)^2 the shape is smooth in s, and so are the frames."""
    s = np.linspace(0.0, 1.0, 11)
    fold = Course(1 - (1 - s) ** 2, np.zeros(11), np.full(10, 0.1))
    clocks = np.linspace(0.0, 0.9999, 200)
    moments = [fold.at(clock) for clock in clocks]
    np.testing.assert_allclose([m.t_n for m in moments], clocks, atol=1e-4)
    found = np.array([fold.value(m, lambda k: s[k]) for m in moments])
    np.testing.assert_allclose(found, 1 - np.sqrt(1 - clocks), atol=6e-3)
    # linear in t_n it would be far off near the limit point
    straight = np.interp(clocks, fold.t_n, s)
    assert np.abs(straight - (1 - np.sqrt(1 - clocks))).max() > 0.02


def test_states_of_another_branch_do_not_count(course: Course) -> None:
    """A value that is constant on each branch stays so up to the jump."""
    values = np.array([1.0, 1.0, 1.0, 5.0, 5.0, 5.0])
    for clock in (0.05, 0.29, 0.30005, 0.31, 0.99):
        expected = 1.0 if clock < 0.3001 else 5.0
        assert course.value(course.at(clock), lambda k: values[k]) == expected


def test_two_runs_share_the_clock(course: Course) -> None:
    """The shorter one is held at its end, and while the other jumps."""
    short = Course([0.0, 0.2, 0.4], [False] * 3, [0.1, 0.1])
    shown = frames([course, short], seconds=4.0, fps=10)
    assert shown[-1].moments[1].ended and not shown[-1].moments[0].ended
    held = [frame.moments[1].t_n for frame in shown if frame.moments[0].jump]
    assert np.ptp(held) == 0 and held[0] == pytest.approx(0.3, abs=0.03)


def test_a_path_that_turns_back_is_shown_to_its_end() -> None:
    """The clock adds up |dt_n|."""
    back = Course([0.3, 0.2, 0.1], [False] * 3, [0.1, 0.1])
    shown = [frame.moments[0] for frame in frames([back], seconds=1.0, fps=20)]
    np.testing.assert_allclose([m.t_n for m in shown], np.linspace(0.3, 0.1, 20), atol=1e-6)


def test_a_run_of_one_state_gives_frames() -> None:
    """A run that has just begun is a still."""
    still = frames([Course([0.0], [False], [])], seconds=1.0, fps=5)
    assert {frame.moments[0].before for frame in still} == {0}
