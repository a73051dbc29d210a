"""The global problem of a shell: PETSc vectors and matrix, factorisation and inertia."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from opticcup_fem.contact.model import Contact
from opticcup_fem.shell.condensation import CondensedCells
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.spaces import number_unknowns

Array = NDArray[np.float64]

MOST_STALE = 3.0
"""The tangent's pattern is made afresh when it holds this many times the contacts there are."""


MEDIUM = 1e-4
"""Stiffness per reference area, unit mu_IOV/R, of the medium that a shell beside obstacles floats
in.  Points that are held instead would carry the obstacles' forces."""


@dataclass(frozen=True)
class Inertia:
    """Numbers of negative, zero and positive eigenvalues of a symmetric tangent."""

    negative: int
    zero: int
    positive: int


class Problem:
    """Assembly and linear algebra in the unknowns u = (r, alpha) of a shell.

    Attributes:
        shell: The shell.
        held: Mask of held unknowns over the rank's local unknowns (see ``shell.supports``).
        contact: Contact that is resisted, if any.
        awake: Whether contact is evaluated; it is not while a solve is tried without it.
        matrix: The tangent H.
        symmetric: Whether H is symmetric and factorised as L D L^T, else as L U.
    """

    def __init__(
        self, shell: Shell, held: NDArray[np.bool_], contact: Contact | None = None
    ) -> None:
        """Number the unknowns and allocate (collective).

        Args:
            shell: The shell.
            held: Mask of held unknowns; their rows and columns become those of the identity.
            contact: Contact to be resisted, if any.
        """
        self.shell, self.held, self.contact = shell, held, contact
        self.awake = contact is not None
        self.comm: MPI.Intracomm = shell.comm
        self.symmetric = shell.has_energy
        self._numbering = number_unknowns(shell.spaces)
        self._split = 3 * shell.spaces.n_nodes
        self._map_cells()
        self._allocate()
        self._springs: PETSc.Vec | None = None
        if contact is not None and contact.has_obstacles:
            self._springs = self._soft_springs()
        self._make_solver()

    def _map_cells(self) -> None:
        """Local numbers of the unknowns of every cell, shape (n_cells, n_u)."""
        shell, spaces = self.shell, self.shell.spaces
        positions = 3 * spaces.nodes[:, :, None] + np.arange(3)
        slots: Array = np.arange(spaces.n_edges * spaces.degree, dtype=np.float64)
        angles = self._split + shell.directors.per_cell(slots.reshape(-1, spaces.degree))
        n = spaces.n_cells
        self.cell_unknowns = np.concatenate(
            [positions.reshape(n, -1), angles.reshape(n, -1)], axis=1
        ).astype(np.int32)
        # PETSc skips negative numbers: held unknowns receive nothing
        self._inserted = np.where(self.held[self.cell_unknowns], -1, self.cell_unknowns).astype(
            np.int32
        )

    def _allocate(self) -> None:
        numbering = self._numbering
        sizes = (numbering.owned, None)
        self._map = PETSc.LGMap().create(numbering.local_to_global, comm=self.comm)
        before = self.comm.exscan(numbering.owned)  # None on rank 0
        self._start = int(before or 0)
        self.matrix = PETSc.Mat().createAIJ((sizes, sizes), comm=self.comm)
        self.matrix.setLGMap(self._map, self._map)
        self.matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        self._far: sparse.csr_array | None = None
        self._has_old_contacts = False
        self._preallocate()
        if self.symmetric:
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        n = numbering.local_to_global
        self._is_ghost = (n < self._start) | (n >= self._start + numbering.owned)
        ghosts = n[self._is_ghost]
        self.vector = PETSc.Vec().createGhost(ghosts, sizes, comm=self.comm)
        self._local_slot = np.empty(len(n), dtype=np.int64)
        self._local_slot[~self._is_ghost] = n[~self._is_ghost] - self._start
        self._local_slot[self._is_ghost] = numbering.owned + np.arange(len(ghosts))
        self._held_owned = n[self.held & ~self._is_ghost].astype(np.int32)
        if self.contact is not None:
            numbers = np.where(self.held, -1, n)[: self._split].reshape(-1, 3).astype(np.int32)
            self._unknown_of_node = self.contact.gather.everywhere(numbers).ravel()

    def _preallocate(self) -> None:
        """Reserve the pattern of cells and contacts, and the diagonal of the held unknowns."""
        preallocator = PETSc.Mat().create(comm=self.comm)
        preallocator.setType(PETSc.Mat.Type.PREALLOCATOR)
        preallocator.setSizes(((self._numbering.owned, None), (self._numbering.owned, None)))
        preallocator.setLGMap(self._map, self._map)
        preallocator.setUp()
        n_u = self.cell_unknowns.shape[1]
        self.insert(preallocator, np.zeros((len(self._inserted), n_u, n_u)))
        diagonal = np.arange(self._start, self._start + self._numbering.owned, dtype=np.int32)
        for i in diagonal:
            preallocator.setValue(i, i, 0.0, addv=PETSc.InsertMode.ADD_VALUES)
        if self._far is not None:
            self._insert_far(preallocator, self._far)
        preallocator.assemble()
        preallocator.preallocatorPreallocate(self.matrix)

    def insert(self, matrix: PETSc.Mat, cells: Array) -> None:
        """Add cell matrices (n_cells, n_u, n_u); rows and columns of held unknowns are left out."""
        matrix.setValuesLocalRCV(
            self._inserted, self._inserted, cells, addv=PETSc.InsertMode.ADD_VALUES
        )

    def _make_solver(self) -> None:
        self.ksp = PETSc.KSP().create(self.comm)
        self.ksp.setType(PETSc.KSP.Type.PREONLY)
        self.ksp.setOperators(self.matrix)
        self._configure(self.ksp, self.symmetric)

    @cached_property
    def _symmetric_part(self) -> tuple[PETSc.Mat, PETSc.KSP]:
        """(H + H^T)/2 and its factorisation."""
        matrix = self.matrix.duplicate(copy=False)
        matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        ksp = PETSc.KSP().create(self.comm)
        ksp.setType(PETSc.KSP.Type.PREONLY)
        ksp.setOperators(matrix)
        self._configure(ksp, True)
        return matrix, ksp

    def _configure(self, ksp: PETSc.KSP, symmetric: bool) -> None:
        """Make a KSP factorise by MUMPS: L D L^T with its inertia, or L U."""
        pc = ksp.getPC()
        pc.setType(PETSc.PC.Type.CHOLESKY if symmetric else PETSc.PC.Type.LU)
        pc.setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        pc.setFactorSetUpSolverType()
        factor = pc.getFactorMatrix()
        factor.setMumpsIcntl(13, 1)  # a parallel root would hide part of the inertia
        factor.setMumpsIcntl(24, 1)  # null pivots are counted, not divided by
        factor.setMumpsIcntl(14, 60)  # room for pivoting

    # --- vectors ------------------------------------------------------------------------------

    def global_values(self, state: ShellState) -> Array:
        """Return the rank's owned values of u = (r, alpha), in global order."""
        return self.owned_values(state.r, state.alpha)

    def owned_values(self, r: Array, alpha: Array) -> Array:
        """Return the rank's owned values of positions and angles, in global order."""
        return np.concatenate([r.ravel(), alpha.ravel()])[self._numbering.owned_local]

    def to_local(self, owned: Array) -> Array:
        """Return all local values (owned and ghost) from the owned ones (collective)."""
        with self.vector.localForm() as local:
            local.array[: len(owned)] = owned
        self.vector.ghostUpdate(PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)
        with self.vector.localForm() as local:
            values: Array = local.array_r[self._local_slot]
        return values

    def split(self, local: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return local values as positions (n_nodes, 3) and angles (n_edges, k)."""
        degree = self.shell.spaces.degree
        return local[: self._split].reshape(-1, 3), local[self._split :].reshape(-1, degree)

    def on_cells(self, local: Array) -> Array:
        """Return local values cell by cell, shape (n_cells, n_u)."""
        return local[self.cell_unknowns]

    def with_mean_directors(self, guess: ShellState, last: ShellState) -> ShellState:
        """Return an extrapolated state on its mean directors; held edges keep theirs (collective).

        Args:
            guess: Extrapolated state.
            last: Last accepted state, whose held directors stay.
        """
        _, held = self.split(self.held)
        turned = self.shell.with_mean_directors(guess)
        return replace(
            turned,
            alpha=np.where(held, last.alpha, turned.alpha),
            director=np.where(held[:, :, None], last.director, turned.director),
        )

    def assemble_vector(self, cells: Array, out: PETSc.Vec) -> None:
        """Add up cell vectors into ``out``; held unknowns get zero (collective)."""
        n_local = len(self._numbering.local_to_global)
        summed = np.bincount(self.cell_unknowns.ravel(), weights=cells.ravel(), minlength=n_local)
        summed[self.held] = 0.0
        with self.vector.localForm() as local:
            local.array[self._local_slot] = summed
        self.vector.ghostUpdate(PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
        out.array[:] = self.vector.array_r

    def norm(self, owned: Array) -> float:
        """Return the Euclidean norm of values spread over the ranks (collective)."""
        return float(np.sqrt(self.comm.allreduce(np.sum(owned * owned))))

    def distance(self, one: ShellState, other: ShellState) -> float:
        """Return the r.m.s. distance of the nodes in two states (collective)."""
        n = self.shell.spaces.position.dofmap.index_map.size_local
        square = np.sum((one.r[:n] - other.r[:n]) ** 2)
        total, count = self.comm.allreduce(np.array([square, float(n)]))
        return float(np.sqrt(total / count))

    def largest(self, values: Array) -> float:
        """Return the largest of values spread over the ranks (collective)."""
        return float(self.comm.allreduce(np.max(values, initial=0.0), MPI.MAX))

    # --- contact ------------------------------------------------------------------------------

    def _awake(self) -> Contact | None:
        return self.contact if self.awake else None

    def _soft_springs(self) -> PETSc.Vec:
        """Return the stiffness of the medium at the nodes, nought for angles (collective)."""
        areas = np.repeat(self.shell.nodal_areas(), 3, axis=1)
        angles = self.cell_unknowns.shape[1] - areas.shape[1]
        cells = np.concatenate([areas, np.zeros((len(areas), angles))], axis=1)
        springs = self.vector.duplicate()
        self.assemble_vector(MEDIUM * cells, springs)
        return springs

    def _from_reference(self, state: ShellState) -> Array:
        start = np.concatenate([self.shell.reference.ravel(), state.alpha.ravel()])
        return self.global_values(state) - start[self._numbering.owned_local]

    def energy(self, state: ShellState) -> float:
        """Return the energy of shell, contact and medium (collective)."""
        contact, energy = self._awake(), self.shell.energy(state)
        if self._springs is not None:
            square = np.sum(self._springs.array_r * self._from_reference(state) ** 2)
            energy += float(self.comm.allreduce(square)) / 2
        return energy if contact is None else energy + contact.energy(state)

    def assemble_gradient(self, cells: CondensedCells, state: ShellState, out: PETSc.Vec) -> None:
        """Add up the gradient of cells, contact and medium into ``out`` (collective)."""
        self.assemble_vector(cells.gradient, out)
        if self._springs is not None:
            out.array[:] += self._springs.array_r * self._from_reference(state)
        contact = self._awake()
        forces = None if contact is None else contact.gradient(state)
        if forces is not None:
            local = np.zeros(len(self._numbering.local_to_global))
            local[: self._split] = forces.ravel()
            local[self.held] = 0.0
            out.array[:] += local[self._numbering.owned_local]

    def contact_stiffness(self, state: ShellState, convex: bool = False) -> sparse.csr_array | None:
        """Return the Hessian of contact for ``assemble_tangent`` (collective).

        Args:
            state: The state.
            convex: Without what it has of negative stiffness.
        """
        contact = self._awake()
        return None if contact is None else contact.hessian(state, convex)

    def with_contact(self, state: ShellState) -> ShellState:
        """Return a state that has contact data, its own where it had none (collective)."""
        if self.contact is None or state.contact is not None:
            return state
        return self.contact.brought_up_to_date(state)

    def free_fraction(self, state: ShellState, dr: Array) -> float:
        """Return the share of a move of the nodes that is safe, 0 to 1 (collective)."""
        contact = self._awake()
        if contact is None:
            return 1.0
        return contact.free_fraction(state, replace(state, r=state.r + dr))

    def is_free(self, before: ShellState, after: ShellState) -> bool:
        """Return whether the way between two states is free of collisions (collective)."""
        contact = self._awake()
        return contact is None or contact.free_fraction(before, after) >= 1.0

    def _insert_far(self, matrix: PETSc.Mat, far: sparse.csr_array) -> None:
        """Add a matrix over all nodes' coordinates; held unknowns receive nothing."""
        index_map = self.shell.spaces.position.dofmap.index_map
        first, last = (3 * end for end in index_map.local_range)
        rows = far[first:last]
        matrix.setValuesIJV(
            rows.indptr.astype(np.int32),
            self._unknown_of_node[rows.indices],
            rows.data,
            addv=PETSc.InsertMode.ADD_VALUES,
            rowmap=self._unknown_of_node[first:last],
        )

    def _make_room(self, far: sparse.csr_array) -> None:
        """Let the tangent's pattern hold the contacts; one that holds too many is made afresh."""
        wanted = sparse.csr_array((np.ones(far.nnz), far.indices, far.indptr), shape=far.shape)
        if self._far is not None:
            union = self._far + wanted
            if union.nnz <= MOST_STALE * wanted.nnz:
                if union.nnz == self._far.nnz:
                    return
                wanted = union
        self._far = wanted
        self._renew_pattern()

    def forget_contacts(self) -> None:
        """Let the tangent's pattern, and with it rounding, depend on contacts to come alone."""
        self._has_old_contacts = self._has_old_contacts or self._far is not None
        self._far = None

    def _renew_pattern(self) -> None:
        self._has_old_contacts = False
        self._preallocate()
        # a new pattern needs a new factor, which needs its settings
        self.ksp.reset()
        self.ksp.setOperators(self.matrix)
        self._configure(self.ksp, self.symmetric)

    # --- tangent ------------------------------------------------------------------------------

    def assemble_tangent(self, cells: CondensedCells, far: sparse.csr_array | None = None) -> None:
        """Assemble H from the condensed cells, contact and medium (collective).

        Args:
            cells: The cells.
            far: Hessian of contact, see ``contact_stiffness``.
        """
        if far is not None:
            self._make_room(far)
        elif self._has_old_contacts and self._far is None:
            self._renew_pattern()
        self._assemble(self.matrix, cells.hessian, far)
        if self._springs is not None:
            self.add_diagonal(self._springs, 1.0)

    def _assemble(
        self, matrix: PETSc.Mat, cells: Array, far: sparse.csr_array | None = None
    ) -> None:
        matrix.zeroEntries()
        self.insert(matrix, cells)
        if far is not None:
            self._insert_far(matrix, far)
        for i in self._held_owned:
            matrix.setValue(i, i, 1.0, addv=PETSc.InsertMode.ADD_VALUES)
        matrix.assemble()

    def add_diagonal(self, diagonal: PETSc.Vec, factor: float) -> None:
        """Add ``factor`` times a diagonal to the assembled tangent (collective)."""
        scaled = diagonal.copy()
        scaled.scale(factor)
        self.matrix.setDiagonal(scaled, addv=PETSc.InsertMode.ADD_VALUES)

    def factorise(self) -> None:
        """Factorise the present tangent (collective).

        Raises:
            PETSc.Error: MUMPS failed.
        """
        self.ksp.setUp()
        self.ksp.getPC().setUp()

    def inertia(self) -> Inertia | None:
        """Return the inertia of the factorised tangent, None where it is not symmetric.

        Held unknowns count as positive.
        """
        if not self.symmetric:
            return None
        return _inertia(self.ksp)

    def inertia_of_symmetric_part(self, cells: CondensedCells) -> Inertia:
        """Return the inertia of (H + H^T)/2 (collective).

        Where none of its eigenvalues is negative, no eigenvalue of H has a negative real part; the
        converse does not hold.  Held unknowns count as positive.

        Args:
            cells: The condensed cells that H is assembled from.
        """
        matrix, ksp = self._symmetric_part
        self._assemble(matrix, (cells.hessian + cells.hessian.transpose(0, 2, 1)) / 2)
        ksp.setUp()
        ksp.getPC().setUp()
        return _inertia(ksp)


def _inertia(ksp: PETSc.KSP) -> Inertia:
    negative, zero, positive = ksp.getPC().getFactorMatrix().getInertia()
    return Inertia(negative, zero, positive)
