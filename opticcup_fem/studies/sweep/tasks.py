"""What a study can compute, by name, and cases as tasks."""

from __future__ import annotations

import importlib
import json
import traceback
from typing import Any

from opticcup_fem.case import Case
from opticcup_fem.errors import OpticCupError
from opticcup_fem.studies.sweep.cache import Record, Task

_HERE = "opticcup_fem.studies.sweep"
KINDS = {
    "cup": f"{_HERE}.meridian_tasks:cup",
    "layers": f"{_HERE}.meridian_tasks:layers",
    "plate": f"{_HERE}.meridian_tasks:plate",
    "surface_cup": f"{_HERE}.surface_task:surface_cup",
    "coexistence": "opticcup_fem.studies.coexistence:task",
}
"""Module and function of each kind: parameters in, a record out.  Other kinds are such a name."""

_UNUSED: dict[str, tuple[str, ...]] = {"meridian": ("mesh", "solver"), "surface": ()}


def task_of(case: Case, kind: str = "cup") -> Task:
    """Return a case as a task of its own model; keys that do not change its numbers are left out.

    Args:
        case: The case.
        kind: "cup" or "layers".
    """
    tables: dict[str, Any] = case.model_dump(mode="json")
    model = case.run.model
    for name in _UNUSED[model]:
        del tables[name]
    unwanted = dict.fromkeys(("fields", "states", "picture"), False)
    tables["output"] = {"times": tables["output"]["times"], **unwanted}
    del tables["shape"]["radius_um"]
    return Task.of("surface_cup" if model == "surface" else kind, model, tables)


def compute(task: Task) -> Record:
    """Compute a task, in whatever process; a failure is a record with its reason.

    A failure that the package did not foresee carries ``unforeseen``: it is not to be kept.
    """
    module, name = KINDS.get(task.kind, task.kind).split(":")
    try:
        function = getattr(importlib.import_module(module), name)
        record: Record = function(json.loads(task.parameters))
    except OpticCupError as error:
        return {"status": "failed", "reason": str(error), "row": {}}
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{last.filename.rsplit('/', 1)[-1]}:{last.lineno}"
        reason = f"{type(error).__name__} in {place}: {error}"
        return {"status": "failed", "reason": reason, "row": {}, "unforeseen": True}
    return {"status": "ok" if record.get("reason") is None else "ended early", **record}
