"""Results by content: what was computed, by which code, is the name under which it is kept."""

from __future__ import annotations

import ast
import hashlib
import importlib.metadata
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import opticcup_fem
from opticcup_fem.errors import CaseError

Record = dict[str, Any]
"""What a task gave, as JSON knows it: ``status`` "ok" or "failed", ``reason``, and its results."""

PACKAGE = Path(opticcup_fem.__file__).parent

_SHARED = (
    "case",
    "compiled.py",
    "events.py",
    "expressions.py",
    "scalar_fields.py",
    "shell",
    "stimulus.py",
    "studies/curvature.py",
    "studies/model.py",
    "studies/sweep/rows.py",
    "theory",
)
SOURCES = {
    "meridian": (
        *_SHARED,
        "equilibrium/continuation.py",
        "meridian",
        "observables.py",
        "sections.py",
        "studies/meridian.py",
        "studies/sweep/losses.py",
        "studies/sweep/meridian_tasks.py",
    ),
    "surface": (
        *_SHARED,
        "contact",
        "crossing.py",
        "equilibrium",
        "mesh",
        "observables.py",
        "sampling.py",
        "sections.py",
        "snapshot.py",
        "studies/contact.py",
        "studies/cup.py",
        "studies/recorder.py",
        "studies/stability.py",
        "studies/sweep/surface_task.py",
        "wavenumbers.py",
    ),
}
"""The modules on which the results of a model depend: changing one makes its results new ones."""

SOURCES["coexistence"] = (*SOURCES["surface"], "studies/coexistence.py")


@dataclass(frozen=True)
class Task:
    """One thing to compute.

    Attributes:
        kind: A key of ``tasks.KINDS``, or the function itself as ``module:function``.
        model: A key of ``SOURCES``.
        parameters: JSON text of what it is computed from, keys sorted.
    """

    kind: str
    model: str
    parameters: str

    @staticmethod
    def of(kind: str, model: str, parameters: Mapping[str, Any]) -> Task:
        """Return the task of a kind with parameters that JSON knows."""
        return Task(kind, model, json.dumps(parameters, sort_keys=True, allow_nan=False))


@cache
def code_version(model: str) -> str:
    """Return a hash of the code that a model's results depend on; Python's comments do not."""
    digest = hashlib.sha256()
    for name in SOURCES[model]:
        place = PACKAGE / name
        for path in sorted(place.rglob("*")) if place.is_dir() else [place]:
            if path.suffix not in (".c", ".py"):
                continue
            text = path.read_text(encoding="utf-8")
            if path.suffix == ".py":
                text = ast.dump(_without_docstrings(ast.parse(text)))
            digest.update(str(path.relative_to(PACKAGE)).encode())
            digest.update(text.encode())
    for package in ("fenics-dolfinx", "numpy", "scipy"):
        digest.update(importlib.metadata.version(package).encode())
    return digest.hexdigest()


def _without_docstrings(tree: ast.Module) -> ast.Module:
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [  # type: ignore[attr-defined]
                part
                for part in body
                if not (isinstance(part, ast.Expr) and isinstance(part.value, ast.Constant))
            ]
    return tree


def default_folder() -> Path:
    """Return the cache's folder: OPTICCUP_CACHE, else opticcup_fem/points in the user's cache."""
    given = os.environ.get("OPTICCUP_CACHE")
    if given:
        return Path(given)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "opticcup_fem" / "points"


class ResultCache:
    """A folder of records, one file each, which any number of processes may share."""

    def __init__(self, folder: Path | None = None) -> None:
        """Make the folder.

        Args:
            folder: ``default_folder()`` by default.

        Raises:
            CaseError: It cannot be written.
        """
        self.folder = default_folder() if folder is None else folder
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.folder):
                pass
        except OSError as error:
            raise CaseError(
                f"the cache {self.folder} cannot be written ({error.strerror}): give another "
                "folder in OPTICCUP_CACHE"
            ) from None

    def path(self, task: Task) -> Path:
        """Return the file of a task's record."""
        digest = hashlib.sha256()
        for part in (task.kind, task.model, task.parameters, code_version(task.model)):
            digest.update(part.encode() + b"\0")
        name = digest.hexdigest()[:32]
        return self.folder / name[:2] / f"{name}.json"

    def load(self, task: Task) -> Record | None:
        """Return the record of a task, None where there is none or its file is damaged."""
        try:
            entry = json.loads(self.path(task).read_text(encoding="utf-8"))
            record: Record = entry["record"]
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return record

    def store(self, task: Task, record: Record) -> None:
        """Keep a record: its file appears whole or not at all."""
        path = self.path(task)
        path.parent.mkdir(exist_ok=True)
        entry = {"kind": task.kind, "parameters": json.loads(task.parameters), "record": record}
        handle, unfinished = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=".json")
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            json.dump(entry, file, allow_nan=False)
        os.replace(unfinished, path)
