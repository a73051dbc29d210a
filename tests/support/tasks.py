"""Tasks that take no time, for tests of the engine."""

from __future__ import annotations

import os
from pathlib import Path

from opticcup_fem.errors import ConvergenceError


def square(parameters):
    """Return x squared, and leave a trace of having been called."""
    x = parameters["x"]
    if trace := parameters.get("trace"):
        with Path(trace).open("a") as file:
            file.write(f"{x}\n")
    return {"row": {"y": x * x}}


def stopped(parameters):
    """Return a record of a path that ended early."""
    return {"row": {"y": 1.0}, "reason": "no equilibrium beyond"}


def failing(parameters):
    """Fail as the package does."""
    raise ConvergenceError("arc length step too small", 0.3, 7, 0, float("nan"))


def broken(parameters):
    """Fail as nobody foresaw."""
    raise ZeroDivisionError("by nothing")


def deadly(parameters):
    """End the process."""
    os._exit(9)
