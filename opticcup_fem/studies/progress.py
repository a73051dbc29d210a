"""Progress of a run on the terminal: a bar with t_n, step and iterations, and events above it."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as RichProgress


class Progress:
    """A progress bar on standard error, or silence."""

    def __init__(self, t_end: float, shown: bool) -> None:
        """Prepare the bar.

        Args:
            t_end: Normalised time at which the bar is full.
            shown: Whether anything is shown at all.
        """
        self._console = Console(file=sys.stderr, highlight=False)
        self._bar = RichProgress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("t_n = {task.completed:.4f}"),
            TextColumn("step {task.fields[step]}, {task.fields[iterations]} iterations"),
            TimeElapsedColumn(),
            console=self._console,
            disable=not shown,
            transient=True,
        )
        self._task = self._bar.add_task("", total=t_end, step=0, iterations=0)
        self._step, self._iterations = 0, 0

    @contextmanager
    def running(self) -> Iterator[None]:
        """Show the bar inside the context."""
        with nullcontext() if self._bar.disable else self._bar:  # a silent one prints a line
            yield

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Name what is going on inside the context."""
        self._bar.update(self._task, description=name)
        yield
        self._bar.update(self._task, description="growing")

    def iteration(self) -> None:
        """Count an iteration."""
        self._iterations += 1
        self._bar.update(self._task, iterations=self._iterations)

    def step(self, t_n: float) -> None:
        """Count an accepted step that reached ``t_n``."""
        self._step += 1
        self._bar.update(self._task, completed=t_n, step=self._step)

    def event(self, event: Mapping[str, Any]) -> None:
        """Print an event above the bar."""
        if not self._bar.disable:
            self._bar.console.print(sentence(event))


def sentence(event: Mapping[str, Any]) -> str:
    """Return an event in words: "secondary_invagination (fold) at t_n = 0.4730".

    >>> sentence({"kind": "symmetry_breaking", "type": "jump", "t_n": 0.283, "wavenumber": 2})
    'symmetry breaking (jump, m = 2) at t_n = 0.2830'
    """
    kind = str(event["kind"]).replace("_", " ")
    wave = f", m = {event['wavenumber']}" if "wavenumber" in event else ""
    parts = f", {event['parts']}" if "parts" in event else ""
    return f"{kind} ({event['type']}{wave}{parts}) at t_n = {event['t_n']:.4f}"
