"""opticcup_fem: growth and elastic instabilities of the optic cup, on FEniCSx.

Public names load lazily, so that `import opticcup_fem` and the theory need NumPy at most.
"""

from __future__ import annotations

import importlib
from typing import Any

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
}
_MODULES = ("theory",)

__all__ = ["__version__", *_PUBLIC, *_MODULES]


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
