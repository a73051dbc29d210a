"""Numerical experiments: each runs a case and writes its records."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from pathlib import Path

    from opticcup_fem.case import Case
    from opticcup_fem.studies.outcome import RunSummary


class Runner(Protocol):
    """Runs a case and writes its run folder (collective)."""

    def __call__(self, case: Case, out_dir: Path, *, quiet: bool = False) -> RunSummary:
        """Return the outcome, the same on every rank."""
        ...


def runner(model: str) -> Runner:
    """Return the study that grows a cup on the discretisation ``run.model``."""
    if model == "meridian":
        from opticcup_fem.studies import meridian

        return meridian.run
    from opticcup_fem.studies import cup

    return cup.run
