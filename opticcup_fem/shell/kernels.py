"""Compile UFL forms with FFCx and call their kernels for all cells or cell edges at once.

The element tensors come back as one array, ready for static condensation cell by cell, which no
assembler offers.  Coefficients are packed by the caller, so that a field on the edges is nothing
special.  The loop around a kernel is ten lines of C, compiled once with cffi.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import jit
from numpy.typing import NDArray

from opticcup_fem import compat, compiled
from opticcup_fem.shell.forms import Integral

Array = NDArray[np.float64]


JIT_OPTIONS: dict[str, Any] = {
    "cffi_extra_compile_args": compiled.C_OPTIONS,
    "timeout": 600,
}

LOOP_DECLARATION = """
void loop_over_entities(uintptr_t kernel, long n, double* A, long n_A, long per_tensor,
                        const double* w, long n_w, const double* x, long n_x, long per_cell);
"""
LOOP_SOURCE = """
#include <stdint.h>
typedef void kernel_t(double*, const double*, const double*, const double*, const int*,
                      const uint8_t* EXTRA_TYPE);
void loop_over_entities(uintptr_t kernel, long n, double* A, long n_A, long per_tensor,
                        const double* w, long n_w, const double* x, long n_x, long per_cell)
{
  const uint8_t permutation[2] = {0, 0};
  const double constants[1] = {0};
  for (long i = 0; i < n; ++i) {
    const int entity[2] = {(int)(i % per_cell), 0};
    ((kernel_t*)kernel)(A + n_A*(i/per_tensor), w + n_w*i, constants, x + n_x*(i/per_cell), entity,
                        permutation EXTRA_VALUE);
  }
}
"""


def _entity_loop() -> tuple[Any, Any]:
    """Return (ffi, library) of the loop, compiling it where the cache lacks it."""
    source = LOOP_SOURCE
    for word, text in (("TYPE", ", void*"), ("VALUE", ", 0")):
        source = source.replace(f" EXTRA_{word}", text if compat.KERNEL_HAS_CUSTOM_DATA else "")
    return compiled.c_library("loop", LOOP_DECLARATION, source)


class Kernel:
    """The compiled kernel of one integral, callable for all cells or cell edges of a rank.

    Cells are triangles with three edges, or intervals with two ends.
    """

    def __init__(self, comm: MPI.Comm, integral: Integral, coordinates: Array) -> None:
        """Compile ``integral``.

        Args:
            comm: Communicator of the mesh (collective: rank 0 compiles, the others load).
            integral: Form with one integral.
            coordinates: Corners of the rank's cells, shape (n_cells, n_corners, 3).
        """
        form = integral.form
        options = {**JIT_OPTIONS, "cache_dir": str(compiled.cache_folder())}

        def compile_form() -> tuple[Any, Any, Any]:
            found: tuple[Any, Any, Any] = jit.ffcx_jit(MPI.COMM_SELF, form, jit_options=options)
            return found

        self._compiled, self._module, _ = compiled.root_first(comm, compile_form)
        self._loop_ffi, self._loop = compiled.root_first(comm, _entity_loop)
        ffi = self._module.ffi
        which = 1 if integral.on_edges else 0
        offset = self._compiled.form_integral_offsets[which]
        tabulate = self._compiled.form_integrals[offset].tabulate_tensor_float64
        self._address = int(ffi.cast("uintptr_t", tabulate))
        self._corners = coordinates.shape[1]
        self.per_cell = self._corners if integral.on_edges else 1
        edges = "interval" if self._corners == 3 else "vertex"
        self._on_edges = {
            c for c in form.coefficients() if compat.cell_name(c.ufl_element()) == edges
        } | integral.edge_coefficients
        self.shape = tuple(_dimension(argument) for argument in form.arguments())
        all_coefficients = form.coefficients()
        self.coefficients = [
            all_coefficients[self._compiled.original_coefficient_positions[i]]
            for i in range(self._compiled.num_coefficients)
        ]
        self._coordinates = np.ascontiguousarray(coordinates)

    def __call__(self, data: Mapping[ufl.Coefficient, Array], into: Array | None = None) -> Array:
        """Tabulate the element tensors.

        Args:
            data: Values of each coefficient, of shape (n_cells, ...) for fields in cells and
                (n_cells, n_corners, ...) for fields on edges.
            into: Contiguous array of shape (n_cells, *shape) to add to; the edges of a cell are
                then summed.

        Returns:
            ``into``, or a new array: (n_cells, *shape) for cells, (n_cells, n_corners, *shape) for
            edges.
        """
        n_cells = len(self._coordinates)
        n = n_cells * self.per_cell
        per_tensor = 1 if into is None else self.per_cell
        if into is None:
            lead = (n_cells,) if self.per_cell == 1 else (n_cells, self.per_cell)
            into = np.zeros(lead + self.shape)
        if n == 0:
            return into
        packed = np.concatenate(
            [self._pack(c, data[c], n_cells) for c in self.coefficients], axis=1
        )
        pointer = self._loop_ffi.from_buffer
        self._loop.loop_over_entities(
            self._address,
            n,
            pointer("double*", into),
            int(np.prod(self.shape)),
            per_tensor,
            pointer("double*", packed),
            packed.shape[1],
            pointer("double*", self._coordinates),
            3 * self._corners,
            self.per_cell,
        )
        return into

    def _pack(self, coefficient: ufl.Coefficient, values: Array, n_cells: int) -> Array:
        """Return the values as rows, one per cell or cell edge."""
        if coefficient in self._on_edges:
            return values.reshape(self._corners * n_cells, -1)
        rows = values.reshape(n_cells, -1)
        return np.repeat(rows, self.per_cell, axis=0) if self.per_cell > 1 else rows


def _dimension(argument: ufl.Argument) -> int:
    """Return the number of element degrees of freedom of a test or trial function."""
    element = argument.ufl_element()
    return int(element.dim)


def compile_kernels(
    comm: MPI.Comm, integrals: Mapping[str, Integral], coordinates: Array
) -> dict[str, Kernel]:
    """Compile every integral; see ``Kernel``."""
    return {name: Kernel(comm, it, coordinates) for name, it in integrals.items()}
