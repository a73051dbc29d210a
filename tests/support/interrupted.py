"""Runs that stop as if Ctrl-C had been pressed."""

import signal

import pytest

from opticcup_fem.studies import restart


def stop_after(steps: int, patch: pytest.MonkeyPatch) -> None:
    """Have the next run receive SIGINT on every rank in its ``steps``-th state."""
    seen = 0

    def received(self: restart.StopSignals) -> int:
        nonlocal seen
        seen += 1
        return signal.SIGINT if seen == steps else 0

    patch.setattr(restart.StopSignals, "received", received)
