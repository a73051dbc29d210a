"""When descent follows a failed step in touch: near rest, once more, or on short steps."""

import pytest

from opticcup_fem.equilibrium.descents import NEAR_REST, SLIP_STEP, Descents

FAR = 100 * NEAR_REST


def test_a_shorter_step_comes_first() -> None:
    """Far from rest descent follows the second failure behind a state, near to it the first."""
    descents = Descents(1e-4)
    assert not descents.follows(0.3, 0.4, FAR)
    assert descents.follows(0.3, 0.34, FAR)
    descents.accept()
    assert not descents.follows(0.34, 0.4, FAR)
    descents.accept()
    assert descents.follows(0.34, 0.4, NEAR_REST / 2)


def test_short_steps_are_always_tried() -> None:
    descents = Descents(1e-4)
    descents.lost_by = 0.5
    short = SLIP_STEP * 1e-4
    assert descents.is_short(0.3, 0.3 + 0.99 * short) and descents.is_short(0.3, 0.3 - 0.99 * short)
    assert not descents.is_short(0.3, 0.3 + 1.01 * short)
    assert descents.follows(0.3, 0.3 + 0.99 * short, FAR)


@pytest.mark.parametrize("sign", [1, -1])
def test_lost_stability_is_found_once(sign: int) -> None:
    """No long descent up to the time by which it was lost, forth or back; behind a jump anew."""
    descents = Descents(1e-4)
    descents.lost_by = sign * 0.4
    descents.accept()
    for t_1 in (0.36, 0.4):
        assert not descents.follows(sign * 0.3, sign * t_1, NEAR_REST / 2)
    assert descents.follows(sign * 0.3, sign * 0.41, FAR)
    descents.accept(jump=True)
    assert descents.lost_by is None
    assert descents.follows(sign * 0.3, sign * 0.4, NEAR_REST / 2)
    descents.begin(sign * 0.5)
    assert not descents.follows(sign * 0.3, sign * 0.4, NEAR_REST / 2)
