"""When a step in touch that Newton's method fails on is tried by descent (decision 0049).

A descent costs more than a shorter step, unless Newton's method came near.  What it finds far away
has lost its stability on the way: up to there it need not be looked for again.
"""

from __future__ import annotations

SLIP_STEP = 10
"""Smallest steps in a step on which parts that touch may slip: where on it does not matter."""

NEAR_REST = 1e-4
"""Residual, unit mu_IOV R^2, from which descent comes to rest in a few steps."""


class Descents:
    """Keeps count of what failed on a path.

    Attributes:
        lost_by: Time by which stability was found to be lost, None where it was not.
    """

    def __init__(self, smallest: float) -> None:
        """Begin a path.

        Args:
            smallest: Smallest step in t_n.
        """
        self._short = SLIP_STEP * smallest
        self._failures = 0
        self.lost_by: float | None = None

    def begin(self, lost_by: float | None = None) -> None:
        """Begin another path, or one that was interrupted."""
        self._failures, self.lost_by = 0, lost_by

    def accept(self, jump: bool = False) -> None:
        """Count anew behind an accepted state; behind a jump stability is to be lost once more."""
        self.begin(None if jump else self.lost_by)

    def is_short(self, t_0: float, t_1: float) -> bool:
        """Return whether a step is so short that a jump on it is accepted."""
        return abs(t_1 - t_0) <= self._short

    def follows(self, t_0: float, t_1: float, least: float) -> bool:
        """Count a failure, and return whether descent follows on it.

        Args:
            t_0: Time of the last state.
            t_1: Time at which Newton's method failed.
            least: Smallest residual norm that it came to.
        """
        self._failures += 1
        if self.is_short(t_0, t_1):
            return True
        is_beyond = self.lost_by is None or (self.lost_by - t_1) * (t_1 - t_0) < 0
        return is_beyond and (self._failures > 1 or least < NEAR_REST)
