r"""Eigenvalues of the tangent near zero, and the motions that belong to them, by SLEPc.

    H u = lambda M u,    M = int |dr|^2 dA_ref + rotary inertia     (``mass``)

by shift and invert.  The six rigid motions of a shell that floats freely are null vectors of H at
every equilibrium; they are deflated, and are no instabilities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from petsc4py import PETSc
from slepc4py import SLEPc

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.equilibrium.mass import consistent_mass
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.errors import ConvergenceError
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.supports import free

Array = NDArray[np.float64]

SHIFT = -0.05
"""Where H - shift M is factorised, unit mu_IOV/R: beside zero, where rigid motions make H singular,
and nearer to it than a shell's own eigenvalues are before one of them becomes critical."""

TOLERANCE = 1e-10
"""Relative accuracy of 1/(lambda - shift)."""

TURN = 1e-5
"""Angle by which the rigid rotations are differentiated, radians."""

LEAST_MOTION = 1e-6
"""Norm of what is left of a rigid motion, of size 1 at every node, that keeps no mirror."""


@dataclass(frozen=True)
class Mode:
    """A motion of the shell about an equilibrium, and its eigenvalue.

    Attributes:
        eigenvalue: Stiffness against the motion over its mean square, unit mu_IOV/R.
        r: Change of the nodes' positions, shape (n_nodes, 3); the largest over all ranks is 1.
        alpha: Change of the director angles, shape (n_edges, k).
    """

    eigenvalue: float
    r: Array
    alpha: Array

    def moved(self, state: ShellState, amount: float) -> ShellState:
        """Return ``state`` moved along the mode, by ``amount`` where it moves most."""
        return replace(state, r=state.r + amount * self.r, alpha=state.alpha + amount * self.alpha)


class Spectrum:
    """Eigenvalues and modes of a shell's equilibria."""

    def __init__(
        self,
        shell: Shell,
        held: NDArray[np.bool_] | None = None,
        mirrors: Sequence[int] = (),
    ) -> None:
        """Allocate (collective).

        Args:
            shell: The shell.
            held: Mask of held unknowns that leaves no rigid motion (``shell.supports``); None for
                a shell that floats freely.
            mirrors: Planes x_i = 0 that all motions keep as mirrors.
        """
        self.shell, self._floats = shell, held is None
        supports = free(shell) if held is None else held
        self.problem = Problem(shell, supports, mirrors=mirrors)
        self._mass = consistent_mass(self.problem)

    def modes(self, state: ShellState, count: int = 8) -> list[Mode]:
        """Return the modes with the eigenvalues nearest to ``SHIFT``, lowest first (collective).

        Args:
            state: Equilibrium at the shell's present growth.
            count: Number of modes.

        Raises:
            ConvergenceError: The eigensolver failed.
        """
        problem = self.problem
        problem.assemble_tangent(self.shell.condensed(state))
        eps = self._solver(count)
        eps.setDeflationSpace(self._rigid(state))
        eps.solve()
        if eps.getConverged() < count:
            reason = f"{eps.getConverged()} of {count} eigenvalues converged"
            raise ConvergenceError(reason, self.shell.t_n, 0, eps.getIterationNumber(), np.nan)
        found = [self._mode(eps, i) for i in range(count)]
        eps.destroy()
        return sorted(found, key=lambda mode: mode.eigenvalue)

    def cosine(self, state: ShellState, move: Array, mode: Mode) -> float:
        """Return |<u, v>| / |u| |v| of a move of the nodes and a mode in M (collective).

        Args:
            state: The state that both start from.
            move: Displacement of the nodes, shape (n_nodes, 3); its rigid part does not count.
            mode: A mode, which has no rigid part.
        """
        still = np.zeros_like(state.alpha)
        u, v = self._global(move, still), self._global(mode.r, still)
        for motion in self._orthonormal(self._rigid(state)):
            u.axpy(-self._inner(motion, u), motion)
        return abs(self._inner(u, v)) / np.sqrt(self._inner(u, u) * self._inner(v, v))

    def _inner(self, u: PETSc.Vec, v: PETSc.Vec) -> float:
        image = v.duplicate()
        self._mass.mult(v, image)
        return float(u.dot(image))

    def _orthonormal(self, vectors: list[PETSc.Vec]) -> list[PETSc.Vec]:
        """Return the vectors orthonormalised in M (modified Gram-Schmidt)."""
        done: list[PETSc.Vec] = []
        for vector in vectors:
            for other in done:
                vector.axpy(-self._inner(other, vector), other)
            vector.scale(1 / np.sqrt(self._inner(vector, vector)))
            done.append(vector)
        return done

    def _solver(self, count: int) -> SLEPc.EPS:
        problem = self.problem
        eps = SLEPc.EPS().create(problem.comm)
        eps.setOperators(problem.matrix, self._mass)
        kind = SLEPc.EPS.ProblemType
        eps.setProblemType(kind.GHEP if problem.symmetric else kind.PGNHEP)
        eps.setType(SLEPc.EPS.Type.KRYLOVSCHUR)
        eps.setWhichEigenpairs(SLEPc.EPS.Which.TARGET_MAGNITUDE)
        eps.setTarget(SHIFT)
        transformation = eps.getST()
        transformation.setType(SLEPc.ST.Type.SINVERT)
        transformation.setShift(SHIFT)
        ksp = transformation.getKSP()
        ksp.setType(PETSc.KSP.Type.PREONLY)
        # the factor type only: its own settings are made once the operators are there
        ksp.getPC().setType(PETSc.PC.Type.CHOLESKY if problem.symmetric else PETSc.PC.Type.LU)
        ksp.getPC().setFactorSolverType(PETSc.Mat.SolverType.MUMPS)
        eps.setDimensions(count, max(2 * count, count + 16))
        eps.setTolerances(TOLERANCE, 100)
        return eps

    def _mode(self, eps: SLEPc.EPS, i: int) -> Mode:
        vector = self.problem.vector.duplicate()
        value = eps.getEigenpair(i, vector)
        unknowns = self.problem.unknowns
        r, alpha = unknowns.split(unknowns.to_local(vector.array_r.copy()))
        longest = self.problem.largest(np.linalg.norm(r, axis=1))
        return Mode(float(np.real(value)), r / longest, alpha / longest)

    def _global(self, r: Array, alpha: Array) -> PETSc.Vec:
        vector = self.problem.vector.duplicate()
        vector.array[:] = self.problem.unknowns.symmetric_part(r, alpha)
        return vector

    def _rigid(self, state: ShellState) -> list[PETSc.Vec]:
        """Return the rigid motions that keep the mirrors."""
        motions = [self._global(*motion) for motion in self.rigid_motions(state)]
        return [motion for motion in motions if motion.norm() > LEAST_MOTION]

    def rigid_motions(self, state: ShellState) -> list[tuple[Array, Array]]:
        """Return the rigid motions of a floating shell as (dr, dalpha), none of a held one.

        Directors are unknowns of their own: a rotation turns them relative to the lagged d_0.
        """
        if not self._floats:
            return []
        still = np.zeros_like(state.alpha)
        translations = [(np.tile(axis, (len(state.r), 1)), still) for axis in np.eye(3)]
        return translations + [self._rotation(state, axis) for axis in np.eye(3)]

    def _rotation(self, state: ShellState, axis: Array) -> tuple[Array, Array]:
        angles = []
        for turn in (-TURN, TURN):
            cosine, sine = np.cos(turn), np.sin(turn)
            across = np.cross(np.eye(3), -axis)
            rotation = cosine * np.eye(3) + sine * across.T + (1 - cosine) * np.outer(axis, axis)
            angles.append(
                self.shell.directors.re_expressed(
                    state.r @ rotation.T, state.alpha, state.director @ rotation.T, state.director
                )
            )
        turned = np.asarray(np.cross(axis, state.r), dtype=np.float64)
        return turned, np.asarray((angles[1] - angles[0]) / (2 * TURN), dtype=np.float64)
