"""A measurement in a process of its own: with its own memory, caches and MPI."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, TypeVar

T = TypeVar("T")


def measured_apart(measure: Callable[..., T], *arguments: Any) -> T:
    """Return what a function of a module returns, called in a new process."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(measure, *arguments).result()
