"""Where an answer changes from no to yes along a parameter, for many such questions at once."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise


@dataclass(frozen=True)
class Bracket:
    """An interval of a parameter over which an answer changes.

    Attributes:
        low: Parameter where the answer is ``not answer_above``.
        high: Parameter where it is ``answer_above``.
        answer_above: The answer at ``high``.
    """

    low: float
    high: float
    answer_above: bool = True

    @property
    def middle(self) -> float:
        """Its middle."""
        return (self.low + self.high) / 2

    @property
    def half_width(self) -> float:
        """Half of its width."""
        return (self.high - self.low) / 2


def changes(answers: Iterable[tuple[float, bool | None]]) -> list[Bracket]:
    """Return the intervals over which the answer changes, in their order.

    Args:
        answers: Pairs of parameter and answer; None is no answer.
    """
    known = sorted((x, yes) for x, yes in answers if yes is not None)
    return [
        Bracket(low, high, after)
        for (low, before), (high, after) in pairwise(known)
        if before != after
    ]


def first_change(answers: Iterable[tuple[float, bool | None]]) -> Bracket | None:
    """Return the first of the ``changes``, None if there is none."""
    return next(iter(changes(answers)), None)


def bisect(
    brackets: Mapping[str, Bracket],
    tolerance: Mapping[str, float],
    ask: Callable[[Sequence[tuple[str, float]]], Sequence[bool | None]],
) -> dict[str, Bracket]:
    """Halve brackets until each is no wider than twice its tolerance.

    Args:
        brackets: Brackets by name.
        tolerance: Half width wanted, by name.
        ask: Answers a batch of questions (name, parameter); one question a name and round.

    Returns:
        The final brackets; one whose middle has no answer stays as it is.
    """
    found = dict(brackets)
    active = set(found)
    while active := {n for n in active if found[n].half_width > tolerance[n]}:
        questions = [(name, found[name].middle) for name in sorted(active)]
        for (name, x), yes in zip(questions, ask(questions), strict=True):
            old = found[name]
            if yes is None:
                active.discard(name)
            elif yes == old.answer_above:
                found[name] = Bracket(old.low, x, old.answer_above)
            else:
                found[name] = Bracket(x, old.high, old.answer_above)
    return found
