"""Timers wrapped around the package's functions from outside; the package itself has none.

Python functions are timed exclusively: what a wrapped function spends in another wrapped one
counts for the latter only.  Factorisations and solves happen inside PETSc and come from its log.
"""

from __future__ import annotations

import functools
import importlib
import resource
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

from petsc4py import PETSc

PLACES = {
    "meshing": ["studies.model.mesh_of", "mesh.SurfaceMesh.reference_position"],
    "kernels, compiled or loaded": ["shell.model.compile_kernels"],
    "forms": ["shell.kernels.Kernel.__call__"],
    "constitutive": ["shell.model.Shell.resultants"],
    "condensation": [
        "shell.condensation.condense",
        "shell.condensation.condensed_gradient",
        "shell.condensation.curvature_slope",
        "shell.condensation.CondensedCells.hessian",
        "shell.condensation.CondensedCells.local_update",
    ],
    "assembly": [
        "equilibrium.problem.Problem.assemble_tangent",
        "equilibrium.unknowns.Unknowns.add_cells",
        "equilibrium.problem.Problem.add_diagonal",
    ],
    "output": [
        "studies.cup.capture",
        "studies.recorder.Recorder.accept",
        "studies.recorder.Recorder.finish",
    ],
}
"""What is timed: places inside opticcup_fem, by phase."""

PETSC_EVENTS = {
    "factorise": ("MatCholFctrSym", "MatCholFctrNum", "MatLUFactorSym", "MatLUFactorNum"),
    "solve": ("MatSolve",),
}
"""PETSc's log events, by phase."""


class Timers:
    """Wall-clock seconds by phase, from the moment of installation.

    Attributes:
        seconds: Exclusive time by phase.
        calls: Calls by place.
    """

    def __init__(self) -> None:
        """Wrap the places; an AttributeError tells that one has moved."""
        PETSc.Log.begin()
        self.seconds: Counter[str] = Counter()
        self.calls: Counter[str] = Counter()
        self._nested = [0.0]
        self._petsc_before = {event: (0, 0.0) for event in _petsc_events()}
        for phase, places in PLACES.items():
            for place in places:
                self._install(phase, place)
        self.reset()

    def reset(self) -> None:
        """Start afresh."""
        self.seconds.clear()
        self.calls.clear()
        self._petsc_before = _petsc_events()
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    def split(self) -> dict[str, float]:
        """Return the seconds of every phase; "rest" makes them add up to the wall clock's."""
        total = time.perf_counter() - self._wall
        phases = {phase: self.seconds[phase] for phase in PLACES}
        now = _petsc_events()
        for phase, events in PETSC_EVENTS.items():
            phases[phase] = sum(now[event][1] - self._petsc_before[event][1] for event in events)
        return {**phases, "rest": total - sum(phases.values()), "total": total}

    @property
    def cpu(self) -> float:
        """Processor seconds; well below the total if the machine had other work."""
        return time.process_time() - self._cpu

    @property
    def factorisations(self) -> int:
        """Number of numerical factorisations."""
        now = _petsc_events()
        events = ("MatCholFctrNum", "MatLUFactorNum")
        return sum(now[event][0] - self._petsc_before[event][0] for event in events)

    @property
    def iterations(self) -> int:
        """Number of tangents assembled: Newton iterations and steps of relaxations."""
        return self.calls["equilibrium.problem.Problem.assemble_tangent"]

    def _install(self, phase: str, place: str) -> None:
        owner, name = locate(place)
        wrapped = vars(owner)[name]
        if isinstance(wrapped, functools.cached_property):
            timed = functools.cached_property(self._timed(wrapped.func, phase, place))
            timed.__set_name__(owner, name)
        else:
            timed = self._timed(wrapped, phase, place)
        setattr(owner, name, timed)

    def _timed(self, function: Callable[..., Any], phase: str, place: str) -> Callable[..., Any]:
        @functools.wraps(function)
        def timed(*args: Any, **kwargs: Any) -> Any:
            self.calls[place] += 1
            self._nested.append(0.0)
            start = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                elapsed = time.perf_counter() - start
                self.seconds[phase] += elapsed - self._nested.pop()
                self._nested[-1] += elapsed

        return timed


def locate(place: str) -> tuple[Any, str]:
    """Return the module or class that holds a place, and the place's name in it."""
    parts = place.split(".")
    for length in range(len(parts) - 1, 0, -1):
        try:
            owner = importlib.import_module(".".join(["opticcup_fem", *parts[:length]]))
        except ModuleNotFoundError:
            continue
        for part in parts[length:-1]:
            owner = getattr(owner, part)
        return owner, parts[-1]
    raise AttributeError(f"opticcup_fem has no {place}")


def peak_memory() -> float:
    """Return the largest resident set of this process so far, in MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def table(split: dict[str, float], per: int = 0) -> str:
    """Return the phases as aligned lines, in seconds, per cent and, if asked for, ms per item."""
    lines = []
    for phase, seconds in split.items():
        share = f"{100 * seconds / split['total']:5.1f} %"
        each = f"{1000 * seconds / per:9.1f} ms" if per else ""
        lines.append(f"{phase:30}{seconds:8.2f} s  {share}{each}")
    return "\n".join(lines)


def _petsc_events() -> dict[str, tuple[int, float]]:
    names = [name for events in PETSC_EVENTS.values() for name in events]
    info = {name: PETSc.Log.Event(name).getPerfInfo() for name in names}
    return {name: (int(one["count"]), float(one["time"])) for name, one in info.items()}
