"""Progress of a study on the terminal: how many of how many, failures, time left."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


class Bar:
    """A progress bar on standard error, or silence.  To be used as a context manager."""

    def __init__(self, shown: bool) -> None:
        """Prepare the bar.

        Args:
            shown: Whether anything is shown at all.
        """
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=Console(file=sys.stderr, highlight=False),
            speed_estimate_period=600.0,
            disable=not shown,
            transient=True,
        )
        self._task = self._bar.add_task("", total=0, note="")
        self._failed = 0

    def __enter__(self) -> Self:
        """Show the bar."""
        if not self._bar.disable:
            self._bar.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Take the bar away."""
        if not self._bar.disable:  # a silent one prints a line
            self._bar.stop()

    def begin(self, what: str, missing: int, known: int) -> None:
        """Begin a batch of ``missing`` tasks; ``known`` more are in the cache already."""
        self._failed = 0
        note = f"({known} known)" if known else ""
        self._bar.reset(self._task, total=missing, description=what, note=note)

    def advance(self, failed: bool = False) -> None:
        """Count a finished task."""
        self._failed += failed
        self._bar.update(self._task, advance=1)
        if self._failed:
            self._bar.update(self._task, note=f"{self._failed} failed")
