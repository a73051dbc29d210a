"""The global problem of a shell: PETSc vectors and matrix, factorisation and inertia."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from opticcup_fem.contact.blocks import SIDE, Blocks
from opticcup_fem.contact.model import KEEP, Contact
from opticcup_fem.equilibrium.unknowns import Unknowns
from opticcup_fem.shell.condensation import CondensedCells
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.snapshot import Integers

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
        unknowns: Numbers of the unknowns, those held, and mirrors that are kept.
        contact: Contact that is resisted, if any.
        awake: Whether contact is evaluated; it is not while a solve is tried without it.
        matrix: The tangent H.
        symmetric: Whether H is symmetric and factorised as L D L^T, else as L U.
    """

    def __init__(
        self,
        shell: Shell,
        held: NDArray[np.bool_],
        contact: Contact | None = None,
        mirrors: Sequence[int] = (),
    ) -> None:
        """Number the unknowns and allocate (collective).

        Args:
            shell: The shell.
            held: Mask of held unknowns; rows and columns of idle ones become the identity's.
            contact: Contact to be resisted, if any.
            mirrors: Planes that the deformation keeps, see ``Unknowns``.

        Raises:
            MeshError: A plane is no mirror of the mesh.
        """
        self.shell, self.contact = shell, contact
        self.unknowns = Unknowns(shell, held, mirrors)
        self._every = Unknowns(shell, held) if mirrors else self.unknowns
        self.vector = self.unknowns.vector
        self.awake = contact is not None
        self.comm: MPI.Intracomm = shell.comm
        self.symmetric = shell.has_energy
        self._allocate()
        self._springs: PETSc.Vec | None = None
        if contact is not None and contact.has_obstacles:
            self._springs = self._soft_springs()
        self._make_solver()

    def _allocate(self) -> None:
        unknowns = self.unknowns
        sizes = (unknowns.owned, None)
        # PETSc skips negative numbers: idle unknowns receive nothing
        idle = unknowns.idle[unknowns.in_cells]
        self._inserted = np.where(idle, -1, unknowns.in_cells).astype(np.int32)
        self.matrix = PETSc.Mat().createAIJ((sizes, sizes), comm=self.comm)
        self.matrix.setLGMap(unknowns.map, unknowns.map)
        self.matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        # pairs of cells in contact that the pattern has room for, as one number each
        self._far: Integers | None = None
        self._has_old_contacts = False
        self._preallocate()
        if self.symmetric:
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
            self.matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)
        if self.contact is not None:
            gather = self.contact.gather
            nodes = self.comm.bcast(gather.cells)
            numbers, _ = unknowns.split(np.where(unknowns.idle, -1, unknowns.numbers))
            of_cells = gather.everywhere(numbers)[nodes].reshape(-1, SIDE)
            self._unknowns_of = of_cells.astype(PETSc.IntType)
            if unknowns.sign is not None:
                signs, _ = unknowns.split(unknowns.sign)
                self._sign_of = gather.everywhere(signs)[nodes].reshape(-1, SIDE)

    def _preallocate(self) -> None:
        """Reserve the pattern of cells, and the diagonal of the held unknowns."""
        preallocator = PETSc.Mat().create(comm=self.comm)
        preallocator.setType(PETSc.Mat.Type.PREALLOCATOR)
        sizes = (self.unknowns.owned, None)
        preallocator.setSizes((sizes, sizes))
        preallocator.setLGMap(self.unknowns.map, self.unknowns.map)
        preallocator.setUp()
        n_cells, n_u = self._inserted.shape
        self.insert(preallocator, np.zeros((n_cells, n_u, n_u)))
        for i in range(*self.unknowns.range):
            preallocator.setValue(i, i, 0.0, addv=PETSc.InsertMode.ADD_VALUES)
        preallocator.assemble()
        preallocator.preallocatorPreallocate(self.matrix)

    @cached_property
    def _pattern_of_cells(self) -> sparse.csr_array:
        """Pattern of the owned rows without contact."""
        ends, columns, _ = self.matrix.getValuesCSR()
        shape = (self.unknowns.owned, self.matrix.size[1])
        return sparse.csr_array((np.ones(len(columns), np.float32), columns, ends), shape=shape)

    @cached_property
    def _places_of_cells(self) -> tuple[sparse.csr_array, sparse.csr_array]:
        """Ones where unknowns are those of the nodes of cells: of all ranks, and owned ones.

        Shapes (n_cells of all ranks, n_u) and, turned over, (owned, n_cells of all ranks).
        """
        cell, at = np.nonzero(self._unknowns_of >= 0)
        entries = (
            np.ones(len(cell), np.float32),
            (_short(cell), _short(self._unknowns_of[cell, at])),
        )
        every = sparse.csr_array(entries, shape=(len(self._unknowns_of), self.matrix.size[1]))
        return every, sparse.csr_array(every[:, slice(*self.unknowns.range)].T)

    def _reserve(self) -> None:
        """Reserve the pattern of cells and of pairs of cells in contact, if any."""
        pattern = self._pattern_of_cells
        if self._far is not None:
            every, owned = self._places_of_cells
            n = len(self._unknowns_of)
            first, second = map(_short, np.divmod(self._far, n))
            entries = np.ones(2 * len(first), np.float32)
            where = (np.concatenate([first, second]), np.concatenate([second, first]))
            pairs = sparse.csr_array((entries, where), shape=(n, n))
            far = owned @ (pairs @ every)
            far.sort_indices()  # the sum of sorted ones is sorted
            pattern = pattern + far
        kinds = (array.astype(PETSc.IntType) for array in (pattern.indptr, pattern.indices))
        self.matrix.setPreallocationCSR(tuple(kinds))

    def insert(self, matrix: PETSc.Mat, cells: Array) -> None:
        """Add cell matrices (n_cells, n_u, n_u); rows and columns of idle unknowns are left out."""
        if self.unknowns.sign is not None:
            sign = self.unknowns.sign[self.unknowns.in_cells]
            cells = cells * sign[:, :, None] * sign[:, None, :]
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

    # --- states -------------------------------------------------------------------------------

    def stepped(
        self, state: ShellState, cells: CondensedCells, owned: Array, fraction: float = 1.0
    ) -> ShellState:
        """Return the state after a step of (r, alpha) and of what (kappa, sigma) do with it.

        Args:
            state: The state.
            cells: The condensed cells at the state.
            owned: The step of the owned unknowns, the share of the full one applied.
            fraction: This share.
        """
        unknowns = self.unknowns
        local = unknowns.to_local(owned)
        dr, dalpha = unknowns.split(local)
        dkappa, dsigma = cells.local_update(local[unknowns.in_cells], state.sigma, fraction)
        return replace(
            state,
            r=state.r + dr,
            alpha=state.alpha + dalpha,
            kappa=state.kappa + dkappa,
            sigma=state.sigma + dsigma,
        )

    def with_mean_directors(self, guess: ShellState, last: ShellState) -> ShellState:
        """Return an extrapolated state on its mean directors; held edges keep theirs (collective).

        Args:
            guess: Extrapolated state.
            last: Last accepted state, whose held directors stay.
        """
        _, held = self.unknowns.split(self.unknowns.held)
        turned = self.shell.with_mean_directors(guess)
        return replace(
            turned,
            alpha=np.where(held, last.alpha, turned.alpha),
            director=np.where(held[:, :, None], last.director, turned.director),
        )

    def along(self, last: ShellState, other: ShellState, share: float) -> ShellState:
        """Return a state on the line through two, on its mean directors (collective).

        Args:
            last: An accepted state, whose held directors stay.
            other: Another one.
            share: Share of the way from the first to it, of any size and sign.
        """
        return self.with_mean_directors(last.plus(other.minus(last), share), last)

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
        angles = self._inserted.shape[1] - areas.shape[1]
        cells = np.concatenate([areas, np.zeros((len(areas), angles))], axis=1)
        springs = self.vector.duplicate()
        self.unknowns.add_cells(MEDIUM * cells, springs, power=2)
        return springs

    def _from_reference(self, state: ShellState) -> Array:
        still = np.zeros_like(state.alpha)
        return self.unknowns.owned_values(state.r - self.shell.reference, still)

    def energy(self, state: ShellState) -> float:
        """Return the energy of shell, contact and medium (collective)."""
        contact, energy = self._awake(), self.shell.energy(state)
        if self._springs is not None:
            square = np.sum(self._springs.array_r * self._from_reference(state) ** 2)
            energy += float(self.comm.allreduce(square)) / 2
        return energy if contact is None else energy + contact.energy(state)

    def assemble_gradient(self, cells: CondensedCells, state: ShellState, out: PETSc.Vec) -> None:
        """Add up the gradient of cells, contact and medium into ``out`` (collective)."""
        self.unknowns.add_cells(cells.gradient, out)
        if self._springs is not None:
            out.array[:] += self._springs.array_r * self._from_reference(state)
        pushed = self._pushed(state, self.unknowns)
        if pushed is not None:
            out.axpy(1.0, pushed)

    def _pushed(self, state: ShellState, unknowns: Unknowns) -> PETSc.Vec | None:
        """Return the gradient of contact, None where nothing touches (collective)."""
        contact = self._awake()
        forces = None if contact is None else contact.gradient(state)
        if forces is None:
            return None
        pushed = unknowns.vector.duplicate()
        unknowns.add_own(unknowns.joined(forces, np.zeros_like(state.alpha)), pushed)
        return pushed

    def force_across_mirrors(self, state: ShellState) -> float:
        """Return the largest force or moment that keeping mirrors takes up (collective).

        Args:
            state: A state that keeps them, in local equilibrium.
        """
        gradient = self._every.vector.duplicate()
        self._every.add_cells(self.shell.gradient(state), gradient)
        pushed = self._pushed(state, self._every)
        if pushed is not None:
            gradient.axpy(1.0, pushed)
        every = self._every.to_local(gradient.array_r)
        part = self.unknowns.symmetric_part(*self.unknowns.split(every))
        return self.largest(np.abs(every - self.unknowns.to_local(part)))

    def contact_stiffness(self, state: ShellState, convex: bool = False) -> Blocks | None:
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
        """Return the share of a move of the nodes that is safe, 0 to 1 (collective).

        Gaps keep ``KEEP`` of what they are: a barrier that is nearly closed pushes so hard that
        the next step is none.
        """
        contact = self._awake()
        if contact is None:
            return 1.0
        return contact.free_fraction(state, replace(state, r=state.r + dr), KEEP)

    def is_free(self, before: ShellState, after: ShellState) -> bool:
        """Return whether the way between two states is free of collisions (collective)."""
        contact = self._awake()
        return contact is None or contact.free_fraction(before, after) >= 1.0

    def _insert_far(self, matrix: PETSc.Mat, far: Blocks) -> None:
        """Add blocks between cells, which rank 0 has; idle unknowns receive nothing."""
        for blocks in (far, far.mirrored()):
            values = np.ascontiguousarray(blocks.values)
            if self.unknowns.sign is not None:
                values = values * self._sign_of[blocks.first][:, :, None]
                values *= self._sign_of[blocks.second][:, None]
            rows, columns = (self._unknowns_of[cells] for cells in (blocks.first, blocks.second))
            matrix.setValuesRCV(rows, columns, values, addv=PETSc.InsertMode.ADD_VALUES)

    def _make_room(self, far: Blocks) -> None:
        """Let the tangent's pattern hold the contacts; one that holds too many is made afresh."""
        wanted = np.unique(far.first * len(self._unknowns_of) + far.second)
        if self._far is not None:
            union = np.union1d(self._far, wanted)
            if len(union) <= MOST_STALE * len(wanted):
                wanted = union
        if self.comm.bcast(self._far is None or len(wanted) != len(self._far)):
            self._far = self.comm.bcast(wanted)
            self._renew_pattern()

    def forget_contacts(self) -> None:
        """Let the tangent's pattern, and with it rounding, depend on contacts to come alone."""
        self._has_old_contacts = self._has_old_contacts or self._far is not None
        self._far = None

    def _renew_pattern(self) -> None:
        self._has_old_contacts = False
        self._reserve()
        # a new pattern needs a new factor, which needs its settings
        self.ksp.reset()
        self.ksp.setOperators(self.matrix)
        self._configure(self.ksp, self.symmetric)

    # --- tangent ------------------------------------------------------------------------------

    def assemble_tangent(self, cells: CondensedCells, far: Blocks | None = None) -> None:
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

    def _assemble(self, matrix: PETSc.Mat, cells: Array, far: Blocks | None = None) -> None:
        matrix.zeroEntries()
        self.insert(matrix, cells)
        if far is not None:
            self._insert_far(matrix, far)
        for i in self.unknowns.idle_owned:
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

        Idle unknowns count as positive.
        """
        if not self.symmetric:
            return None
        return _inertia(self.ksp)

    def inertia_of_symmetric_part(self, cells: CondensedCells) -> Inertia:
        """Return the inertia of (H + H^T)/2 (collective).

        Where none of its eigenvalues is negative, no eigenvalue of H has a negative real part; the
        converse does not hold.  Idle unknowns count as positive.

        Args:
            cells: The condensed cells that H is assembled from.
        """
        matrix, ksp = self._symmetric_part
        self._assemble(matrix, (cells.hessian + cells.hessian.transpose(0, 2, 1)) / 2)
        ksp.setUp()
        ksp.getPC().setUp()
        return _inertia(ksp)


def _short(numbers: Integers) -> NDArray[np.int32]:
    """Return numbers of unknowns or cells as scipy multiplies them fastest."""
    return numbers.astype(np.int32)


def _inertia(ksp: PETSc.KSP) -> Inertia:
    negative, zero, positive = ksp.getPC().getFactorMatrix().getInertia()
    return Inertia(negative, zero, positive)
