"""Runs that stop as if Ctrl-C had been pressed, and the same run in two folders."""

import signal
from pathlib import Path

import numpy as np
import pytest

from opticcup_fem.records import read_events, read_path, read_sections
from opticcup_fem.states import States
from opticcup_fem.studies import interruption


def stop_after(steps: int, patch: pytest.MonkeyPatch) -> None:
    """Have the next run receive SIGINT on every rank in its ``steps``-th state."""
    seen = 0

    def received(self: interruption.StopSignals) -> int:
        nonlocal seen
        seen += 1
        return signal.SIGINT if seen == steps else 0

    patch.setattr(interruption.StopSignals, "received", received)


def require_same_run(folder: Path, other: Path, tolerance: float = 1e-10) -> None:
    """Check that two run folders hold the same run."""
    one, two = read_path(folder), read_path(other)
    assert list(one.columns) == list(two.columns) and len(one) == len(two)
    difference = np.abs(one.select_dtypes("number") - two.select_dtypes("number"))
    assert difference.max().max() <= tolerance
    assert [e["kind"] for e in read_events(folder)] == [e["kind"] for e in read_events(other)]
    assert [s.t_n for s in read_sections(folder)] == [s.t_n for s in read_sections(other)]
    assert len(States(folder)) == len(States(other)) == len(one)
    for name in ("fields.pvd", "modes.pvd"):
        files = [run / name for run in (folder, other)]
        assert files[0].exists() == files[1].exists()
        if files[0].exists():
            counts = [file.read_text().count("<DataSet") for file in files]
            assert counts[0] == counts[1]
    names = [sorted(p.name for p in (run / "fields").iterdir()) for run in (folder, other)]
    assert names[0] == names[1]
