"""Compiled code: where it is kept, who may compile, and C sources called through cffi."""

from __future__ import annotations

import fcntl
import hashlib
import importlib.util
import os
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from mpi4py import MPI

import cffi
from dolfinx import jit


def _processor_tag() -> str:
    """Return a tag of this processor's features: code of -march=native may not run on another."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        features = next(line for line in lines if line.startswith(("flags", "Features")))
    except (OSError, StopIteration):
        features = platform.processor()
    return hashlib.sha1(features.encode()).hexdigest()[:8]


C_OPTIONS = [
    # reordering sums lets the compiler vectorise the element loops: the second derivative of the
    # curvature runs three times faster than with -O1 (measured); NaN must stay NaN
    "-O3",
    "-march=native",
    "-ffast-math",
    "-fno-finite-math-only",
    # kernels of another kind of processor are other kernels, where a cache is shared
    f"-DPROCESSOR_{_processor_tag()}",
]


def cache_folder() -> Path:
    """Return the folder of our compiled kernels, inside the one that dolfinx uses."""
    return Path(jit.get_options(None)["cache_dir"]) / "opticcup"


@contextmanager
def _sole_compiler() -> Iterator[None]:
    """Hold the cache for one process, and clear what a killed compilation left there.

    FFCx waits for a source file without its ``.cached`` mark until a timeout.  While the lock is
    held none of us compiles, so that such a file of one of our kernels can only be a leftover.
    """
    folder = cache_folder()
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "opticcup.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        for source in folder.glob("libffcx_forms_*.c"):
            if not source.with_suffix(".c.cached").exists():
                source.unlink(missing_ok=True)
        yield


def root_first(comm: MPI.Comm, make: Callable[[], Any]) -> Any:
    """Call ``make`` on rank 0, which may fill the cache, then on the other ranks.

    Raises:
        RuntimeError: The call failed; every rank raises.
    """
    result, message = None, None
    if comm.rank == 0:
        try:
            with _sole_compiler():
                result = make()
        except Exception as exc:  # all ranks must agree on the failure before one raises
            message = f"{type(exc).__name__}: {exc}"
    message = comm.bcast(message)
    if message is not None:
        raise RuntimeError(f"a kernel could not be compiled: {message}")
    return result if comm.rank == 0 else make()


@cache
def c_library(name: str, declarations: str, source: str) -> tuple[Any, Any]:
    """Return cffi's (ffi, library) of a C source, compiled where the cache lacks it.

    Args:
        name: What its functions are for, one word.
        declarations: Those of the functions to call.
        source: The source.
    """
    options = " ".join(C_OPTIONS)
    digest = hashlib.sha1(f"{declarations}{source}{options}".encode()).hexdigest()[:12]
    module_name, folder = f"_opticcup_{name}_{digest}", cache_folder()
    found = sorted(folder.glob(f"{module_name}*.so"))
    if not found:
        builder = cffi.FFI()
        builder.cdef(declarations)
        builder.set_source(module_name, source, extra_compile_args=C_OPTIONS, libraries=["m"])
        built = Path(builder.compile(tmpdir=str(folder / f"{name}-{os.getpid()}")))
        found = [folder / built.name]
        os.replace(built, found[0])
    spec = importlib.util.spec_from_file_location(module_name, found[0])
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.ffi, module.lib
