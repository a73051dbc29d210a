"""How much each parameter moves a number: one at a time, up and down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Effect:
    """What a parameter does to a number.

    Attributes:
        name: The parameter.
        low: The number with the parameter lowered, None where there is none.
        high: With it raised.
        base: With all parameters as they are.
    """

    name: str
    low: float | None
    high: float | None
    base: float

    @property
    def size(self) -> float:
        """Largest change of the number."""
        return max(abs(v - self.base) for v in (self.low, self.high, self.base) if v is not None)


def effects(
    base: float, low: Mapping[str, float | None], high: Mapping[str, float | None]
) -> list[Effect]:
    """Return the effects, the largest first; parameters of equal effect in the order given."""
    found = [Effect(name, low[name], high[name], base) for name in low]
    return sorted(found, key=lambda one: -one.size)
