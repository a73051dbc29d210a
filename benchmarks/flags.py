"""Compare compiler flags of the element kernels: time to compile, time to run, rounding.

    docker/run python3 benchmarks/flags.py ["FLAGS" ...]

Each argument is one set of flags; by default those that docs/decisions/0008 compares.  The last
column is the largest difference to the first set's tensors, relative to their largest entry.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from dataclasses import replace

import numpy as np

DEFAULTS = (
    "-O1 -march=native -ftree-loop-vectorize",
    "-O2 -march=native",
    "-O3 -march=native",
    "-O2 -march=native -ffast-math -fno-finite-math-only",
    "-O3 -march=native -ffast-math -fno-finite-math-only",
)
REPEATS = 5


def main() -> None:
    """Measure every set of flags in an empty cache and print one table each."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder  # before dolfinx looks for its cache
        measure(sys.argv[1:] or DEFAULTS)


def measure(choices) -> None:
    """Compile and run all kernels on the default mesh with every set of flags."""
    from mpi4py import MPI

    from opticcup_fem.case import Case
    from opticcup_fem.shell import kernels
    from opticcup_fem.studies.model import shell_of

    default = kernels.JIT_OPTIONS["cffi_extra_compile_args"]
    shell = shell_of(Case(), MPI.COMM_SELF)
    data = _data(shell)
    print(f"{shell.spaces.n_cells} cells; the package compiles with {' '.join(default)}")
    first = {}
    for flags in choices:
        kernels.JIT_OPTIONS["cffi_extra_compile_args"] = [*flags.split(), "-DAFRESH"]
        print(f"\n{flags}\n{'kernel':8}{'compile':>10}{'run':>12}{'difference':>12}")
        totals = [0.0, 0.0, 0.0]
        for name, integral in shell.forms.integrals.items():
            start = time.perf_counter()
            kernel = kernels.Kernel(shell.comm, integral, shell.spaces.coordinates)
            compile_seconds = time.perf_counter() - start
            seconds = min(_time(kernel, data) for _ in range(REPEATS))
            tensors = kernel(data)
            reference = first.setdefault(name, tensors)
            difference = np.abs(tensors - reference).max() / np.abs(reference).max()
            _print(name, compile_seconds, seconds, difference)
            totals = [totals[0] + compile_seconds, totals[1] + seconds, max(totals[2], difference)]
        _print("all", *totals)


def _print(name: str, compile_seconds: float, seconds: float, difference: float) -> None:
    line = f"{name:8}{compile_seconds:8.2f} s{1000 * seconds:9.2f} ms{difference:12.1e}"
    print(line, flush=True)


def _data(shell):
    """Return the coefficients of a grown and warped shell, which no kernel finds trivial."""
    shell.set_time(0.01)
    state = shell.reference_state()
    state = replace(state, r=state.r + 0.002 * np.sin(3 * state.r[:, [1, 2, 0]]))
    state = shell.with_local_equilibrium(state)
    return shell._kinematic_data(state) | shell._material_data(shell.resultants(state))


def _time(kernel, data) -> float:
    start = time.perf_counter()
    kernel(data)
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
