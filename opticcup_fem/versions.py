"""Versions of what computes, for the records."""

from __future__ import annotations

import importlib.metadata
import platform

import opticcup_fem


def versions() -> dict[str, str]:
    """Return name and version of this package, Python, dolfinx and PETSc."""
    from petsc4py import PETSc

    petsc = ".".join(str(part) for part in PETSc.Sys.getVersion())
    return {
        "opticcup_fem": opticcup_fem.__version__,
        "python": platform.python_version(),
        "dolfinx": importlib.metadata.version("fenics-dolfinx"),
        "petsc": petsc,
    }
