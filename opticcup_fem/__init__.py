"""opticcup_fem: growth and elastic instabilities of the optic cup, on FEniCSx.

Public names load lazily, so that `import opticcup_fem` and the theory need NumPy at most.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from opticcup_fem import theory
    from opticcup_fem.case import Case, load_case, parse_case, write_case
    from opticcup_fem.equilibrium.growing import grow
    from opticcup_fem.errors import (
        CaseError,
        ClosureBreakdown,
        ConvergenceError,
        InterruptedRun,
        MeshError,
        OpticCupError,
        RecordError,
    )
    from opticcup_fem.fields import write_fields
    from opticcup_fem.records import read_events, read_path
    from opticcup_fem.shell.fibres import GrowthState
    from opticcup_fem.shell.growth import FieldGrowth, LinearGrowth
    from opticcup_fem.shell.model import Shell
    from opticcup_fem.shell.recovery import capture
    from opticcup_fem.shell.section import Layer, Section
    from opticcup_fem.shell.tissue import Tissue
    from opticcup_fem.studies.model import tissue_of
    from opticcup_fem.studies.run import run

__version__ = "0.1.0"

_PUBLIC = {
    "Case": "case",
    "load_case": "case",
    "parse_case": "case",
    "write_case": "case",
    "CaseError": "errors",
    "ClosureBreakdown": "errors",
    "ConvergenceError": "errors",
    "InterruptedRun": "errors",
    "MeshError": "errors",
    "OpticCupError": "errors",
    "RecordError": "errors",
    "run": "studies.run",
    "read_events": "records",
    "read_path": "records",
    "Tissue": "shell.tissue",
    "tissue_of": "studies.model",
    "Layer": "shell.section",
    "Section": "shell.section",
    "GrowthState": "shell.fibres",
    "FieldGrowth": "shell.growth",
    "LinearGrowth": "shell.growth",
    "Shell": "shell.model",
    "grow": "equilibrium.growing",
    "capture": "shell.recovery",
    "write_fields": "fields",
}
_MODULES = ("theory",)

__all__ = [
    "Case",
    "CaseError",
    "ClosureBreakdown",
    "ConvergenceError",
    "FieldGrowth",
    "GrowthState",
    "InterruptedRun",
    "Layer",
    "LinearGrowth",
    "MeshError",
    "OpticCupError",
    "RecordError",
    "Section",
    "Shell",
    "Tissue",
    "__version__",
    "capture",
    "grow",
    "load_case",
    "parse_case",
    "read_events",
    "read_path",
    "run",
    "theory",
    "tissue_of",
    "write_case",
    "write_fields",
]


def __getattr__(name: str) -> Any:
    """Load a public name on first use (PEP 562)."""
    if name in _PUBLIC:
        value = getattr(importlib.import_module(f"{__name__}.{_PUBLIC[name]}"), name)
    elif name in _MODULES:
        value = importlib.import_module(f"{__name__}.{name}")
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the lazy names too."""
    return sorted({*globals(), *__all__})
