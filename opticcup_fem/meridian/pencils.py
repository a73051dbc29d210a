"""Sparse eigenproblems A x = lambda M x: eigenvalues by SLEPc, their signs counted by MUMPS.

A pencil belongs to one wavenumber.  Its pattern is that of the cells, so that a new state brings
new numbers only.  Theory: docs/theory.md, "Loss of axisymmetry".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc
from slepc4py import SLEPc

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.errors import OpticCupError

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SHIFT = -1e-6
"""Point about which eigenvalues are sought: not zero, where rigid motions lie and, at a crossing,
the eigenvalue itself, and far nearer to it than those of a shell that is not about to buckle."""

TOLERANCE = 1e-10
"""Relative error of an eigenvalue of the inverted pencil."""

AT_ZERO = 1e-8
"""An eigenvalue this much smaller than the next one may have either sign by rounding."""


@dataclass(frozen=True)
class Motions:
    """Admissible motions: every unknown is held, or is plus or minus one of the free ones.

    Attributes:
        column: The free unknown of each unknown, -1 where it is held; shape (n_u,).
        sign: Its factor, shape (n_u,).
    """

    column: Indices
    sign: Array

    @property
    def size(self) -> int:
        """Number of free unknowns."""
        return int(self.column.max()) + 1

    def whole(self, free: Array) -> Array:
        """Return all unknowns, shape (n_u, ...), of values (size, ...) of the free ones."""
        factor = np.where(self.column < 0, 0.0, self.sign)
        return np.asarray(factor.reshape(-1, *(1,) * (free.ndim - 1)) * free[self.column])

    def free(self, whole: Array) -> Array:
        """Return the free unknowns, shape (size,), of an admissible motion (n_u,)."""
        values = np.zeros(self.size)
        moving = self.column >= 0
        values[self.column[moving]] = (self.sign * whole)[moving]
        return values


class Pencil:
    """The eigenproblem of one wavenumber, on one process."""

    def __init__(
        self, motions: Motions, unknowns: Indices, mass: Array, symmetric: bool = True
    ) -> None:
        """Number the entries and allocate.

        Args:
            motions: Admissible motions.
            unknowns: Unknowns of every cell, shape (n_cells, n_c).
            mass: Mass matrices of the cells, shape (n_cells, n_c, n_c); their sum M is symmetric
                and positive definite on the admissible motions.
            symmetric: Whether A is symmetric.
        """
        self.motions, self.symmetric = motions, symmetric
        self._number(unknowns)
        values = self._values(mass)
        self._mass, self._stiffness = self._matrix(values, True), self._matrix(values, symmetric)
        self._counted = self._stiffness if symmetric else self._matrix(values, True)
        self._factor = PETSc.PC().create(MPI.COMM_SELF)
        self._factor.setOperators(self._counted)
        _use_mumps(self._factor, symmetric=True)
        self._factor.setFactorSetUpSolverType()
        # null pivots are counted, not divided by
        self._factor.getFactorMatrix().setMumpsIcntl(24, 1)
        self._solver = self._make_solver()
        start = np.random.default_rng(0).normal(size=motions.size)
        self._start = PETSc.Vec().createWithArray(start, comm=MPI.COMM_SELF)

    def _number(self, unknowns: Indices) -> None:
        """Find the entry of the sparse matrix to which each entry of a cell's is added."""
        column, sign = self.motions.column[unknowns], self.motions.sign[unknowns]
        rows, columns = np.broadcast_arrays(column[:, :, None], column[:, None, :])
        kept = ((rows >= 0) & (columns >= 0)).ravel()
        n = self.motions.size
        entries, self._entry = np.unique((rows * n + columns).ravel()[kept], return_inverse=True)
        self._kept = np.flatnonzero(kept)
        self._sign = (sign[:, :, None] * sign[:, None, :]).ravel()[kept]
        starts = np.searchsorted(entries, n * np.arange(n + 1))
        self._pattern = (starts.astype(np.int32), (entries % n).astype(np.int32))
        self._transposed = np.searchsorted(entries, entries % n * n + entries // n)

    def _values(self, cells: Array) -> Array:
        """Return the nonzero entries of the sum of the cells' matrices."""
        sums = np.bincount(self._entry, self._sign * cells.ravel()[self._kept])
        return np.asarray(sums, dtype=np.float64)

    def _matrix(self, values: Array, symmetric: bool) -> PETSc.Mat:
        n = self.motions.size
        matrix = PETSc.Mat().createAIJ((n, n), csr=(*self._pattern, values), comm=MPI.COMM_SELF)
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, symmetric)
        return matrix

    def _make_solver(self) -> SLEPc.EPS:
        solver = SLEPc.EPS().create(MPI.COMM_SELF)
        kinds = SLEPc.EPS.ProblemType
        solver.setProblemType(kinds.GHEP if self.symmetric else kinds.GNHEP)
        solver.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        solver.setTarget(SHIFT)
        solver.setTolerances(TOLERANCE, 200)
        transform = solver.getST()
        transform.setType(SLEPc.ST.Type.SINVERT)
        transform.setMatStructure(PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        transform.getKSP().setType(PETSc.KSP.Type.PREONLY)
        _use_mumps(transform.getKSP().getPC(), self.symmetric)
        return solver

    def set(self, cells: Array) -> None:
        """Take the sum of the cells' matrices, shape (n_cells, n_c, n_c), for A."""
        values = self._values(cells)
        _refill(self._stiffness, self._pattern, values)
        if not self.symmetric:
            _refill(self._counted, self._pattern, (values + values[self._transposed]) / 2)

    def negative(self) -> int:
        """Return the exact number of eigenvalues with a negative real part.

        It is that of the negative pivots of L D L^T.  Of an A that is not symmetric the symmetric
        part is factorised: where that is positive definite no eigenvalue has a negative real part;
        else all eigenvalues are computed.
        """
        self._factor.setUp()
        negative = int(self._factor.getFactorMatrix().getInertia()[0])
        if negative and not self.symmetric:
            return int(np.sum(self._all() < 0))
        return negative

    def _all(self) -> Array:
        """Return the real parts of all eigenvalues, by LAPACK."""
        solver = SLEPc.EPS().create(MPI.COMM_SELF)
        solver.setOperators(self._stiffness, self._mass)
        solver.setProblemType(SLEPc.EPS.ProblemType.GNHEP)
        solver.setType(SLEPc.EPS.Type.LAPACK)
        solver.solve()
        return np.array([solver.getEigenvalue(i).real for i in range(solver.getConverged())])

    def nearest(self, count: int, aside: Sequence[Array] = ()) -> tuple[Array, Array]:
        """Return the eigenvalues nearest to zero and their vectors.

        Args:
            count: How many.
            aside: Free unknowns, shape (size,), of the members of a null space to be left out.

        Returns:
            Real parts, ascending, shape (k,), and all unknowns' values as columns, shape (n_u, k),
            with unit mass; k is less than ``count`` where SLEPc does not find so many.
        """
        solver = self._solver
        if count != solver.getDimensions()[0]:
            # else SLEPc 3.22 repeats an eigenvalue in place of the next, where vectors are deflated
            solver.reset()
        solver.setOperators(self._stiffness, self._mass)
        if len(aside):
            vectors = [PETSc.Vec().createWithArray(row, comm=MPI.COMM_SELF) for row in aside]
            solver.setDeflationSpace(vectors)
        solver.setDimensions(count, PETSc.DECIDE)
        # a random start would give other last digits every time
        solver.setInitialSpace([self._start])
        solver.solve()
        count = min(count, solver.getConverged())
        real, imaginary = self._stiffness.createVecs()
        values, columns = np.empty(count), np.empty((self.motions.size, count))
        for i in range(count):
            values[i] = solver.getEigenpair(i, real, imaginary).real
            columns[:, i] = real.array
        order = np.argsort(values)
        return values[order], self.motions.whole(columns[:, order])

    def eigenvalue(self, index: int) -> float:
        """Return the eigenvalue of place ``index`` in ascending order, one not far from zero.

        Raises:
            OpticCupError: SLEPc does not find it.
        """
        negative, size = self.negative(), self.motions.size
        for count in [*(2 ** np.arange(1, int(np.log2(size)) + 1)), size]:
            values, _ = self.nearest(count)
            sizes = np.sort(np.abs(values))
            at_zero = len(sizes) > 1 and sizes[0] < AT_ZERO * sizes[1]
            if at_zero and index - negative in (-1, 0):
                # rounding has decided its sign: the count knows it
                return float(-sizes[0] if index < negative else sizes[0])
            # those found are the last of the negative ones and the first of the others
            place = index - negative + int(np.sum(values < 0))
            if 0 <= place < len(values):
                return float(values[place])
        raise OpticCupError(f"SLEPc does not find eigenvalue {index} of {size}")


def _use_mumps(preconditioner: PETSc.PC, symmetric: bool) -> None:
    kinds = PETSc.PC.Type
    preconditioner.setType(kinds.CHOLESKY if symmetric else kinds.LU)
    preconditioner.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)


def _refill(matrix: PETSc.Mat, pattern: tuple[Any, Any], values: Array) -> None:
    matrix.setValuesCSR(*pattern, values)
    matrix.assemble()
