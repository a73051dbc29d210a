r"""Second variation of the energy of an axisymmetric state in every azimuthal wavenumber.

A perturbation (u_r cos m phi, u_phi sin m phi, u_z cos m phi), with vertex rotations
beta cos m phi, has a second variation whose density is quadratic in cos m phi and sin m phi: its
mean over phi is the mean of its values at phi = 0 and pi/(2m), without error.  In m = 0 the
amplitudes are uniform, u_phi being a torsion.  Theory: docs/theory.md, "Loss of axisymmetry".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from mpi4py import MPI

import numpy as np
import ufl
from numpy.typing import NDArray

from opticcup_fem.errors import OpticCupError
from opticcup_fem.meridian.forms import WaveForms
from opticcup_fem.meridian.pencils import Motions, Pencil
from opticcup_fem.meridian.pressure import PressureWork
from opticcup_fem.meridian.problem import assemble_dense, cell_unknowns
from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.shell import condensation
from opticcup_fem.shell.kernels import Kernel, compile_kernels

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Spectrum:
    """What is known of the eigenvalues of one wavenumber, rigid motions aside.

    Attributes:
        negative: How many are negative, exactly.
        nearest: The one nearest to zero, unit mu_IOV/R: where none is negative, the lowest.  NaN if
            it was not found.
    """

    negative: int
    nearest: float


@dataclass(frozen=True)
class Mode:
    """A mode of one wavenumber.

    Attributes:
        wavenumber: m.
        eigenvalue: Of the second variation against the mean square move, unit mu_IOV/R.
        u: Amplitudes (u_r, u_phi, u_z) at the nodes, shape (n_nodes, 3), largest 1.
        rotation: Amplitude of the vertex rotations, shape (n_cells + 1,), radians.
    """

    wavenumber: int
    eigenvalue: float
    u: Array
    rotation: Array


@dataclass(frozen=True)
class _Azimuth:
    """One azimuth of one wavenumber, and its weight in the mean over phi."""

    m: int
    cosine: float
    sine: float
    weight: float


def _azimuths(m: int) -> list[_Azimuth]:
    if m == 0:
        return [_Azimuth(0, 1.0, 1.0, 1.0)]
    return [_Azimuth(m, 1.0, 0.0, 0.5), _Azimuth(m, 0.0, 1.0, 0.5)]


class Waves:
    """Second variations of the states of one shell.

    Attributes:
        shell: The axisymmetric shell.
        wavenumbers: The wavenumbers m.
        n_u: Number of amplitudes and rotations in each of them.
    """

    def __init__(self, shell: MeridianShell, wavenumbers: Sequence[int] = tuple(range(9))) -> None:
        """Compile the kernels.

        Args:
            shell: The axisymmetric shell.
            wavenumbers: Wavenumbers m >= 0, each once.

        Raises:
            ValueError: A wavenumber is negative or given twice.
        """
        if min(wavenumbers, default=0) < 0 or len(set(wavenumbers)) != len(wavenumbers):
            raise ValueError(f"wavenumbers must be different and not negative: {wavenumbers}")
        self.shell, self.wavenumbers = shell, tuple(wavenumbers)
        self.mesh = shell.mesh
        self.forms = WaveForms(self.mesh)
        self._azimuths = [azimuth for m in self.wavenumbers for azimuth in _azimuths(m)]
        corners = np.tile(self.mesh.corners(), (len(self._azimuths), 1, 1))
        self.kernels: dict[str, Kernel] = compile_kernels(
            MPI.COMM_SELF, self.forms.integrals, corners
        )
        self.n_u = 3 * self.mesh.n_nodes + self.mesh.n_cells + 1
        self._cell_unknowns = cell_unknowns(self.mesh.cells, 3, self.mesh.n_nodes)

    # --- matrices -----------------------------------------------------------------------------

    def data(
        self,
        state: MeridianState,
        t_n: float,
        u: Array | None = None,
        rotation: Array | None = None,
    ) -> dict[ufl.Coefficient, Array]:
        """Return the coefficients of the blocks for all azimuths, one after the other.

        Args:
            state: Axisymmetric state.
            t_n: Normalised time.
            u: Amplitudes at the nodes, shape (n_nodes, 3); zero by default.
            rotation: Rotations of the vertices, shape (n_cells + 1,); zero by default.
        """
        shell, forms, mesh = self.shell, self.forms, self.mesh
        result = shell.resultants_of(shell.forms_at_points(state), t_n)
        u = np.zeros((mesh.n_nodes, 3)) if u is None else u
        rotation = np.zeros(mesh.n_cells + 1) if rotation is None else rotation
        once = {
            forms.base: state.r[mesh.cells],
            forms.r: u[mesh.cells],
            forms.alpha: shell.of_ends(rotation),
            forms.angle: shell.of_ends(state.angle),
            forms.pole: shell.pole,
            forms.sigma: state.sigma,
            forms.radius: shell.radius_ref,
            forms.stress: result.stress * shell.circumference[..., None],
        }
        assert result.tangent is not None
        once[forms.tangent] = result.tangent * shell.circumference[..., None, None]
        count = len(self._azimuths)
        data = {
            field: np.tile(values, (count,) + (1,) * (values.ndim - 1))
            for field, values in once.items()
        }
        waves = np.array([[a.m, a.cosine, a.sine] for a in self._azimuths])
        data[forms.wave] = np.repeat(waves, mesh.n_cells, axis=0)
        return data

    def cell_matrices(self, state: MeridianState, t_n: float) -> dict[int, Array]:
        """Return the condensed second variation of the cells in each wavenumber.

        Exact where ``state`` solves the local equations, as every equilibrium does.

        Returns:
            For each m shape (n_cells, n_c, n_c), of the amplitudes of a cell's nodes and the
            rotations of its ends.
        """
        pressure = None
        if self.shell.pressure is not None:
            pressure = PressureWork(self.kernels, self.shell.pressure(t_n))
        count = len(self._azimuths)
        cells = condensation.condense(
            self.kernels,
            self.data(state, t_n),
            np.tile(self.mesh.sizes, count),
            np.tile(state.kappa, (count, 1)),
            self.shell.has_energy,
            pressure,
        )
        parts = cells.hessian.reshape(count, self.mesh.n_cells, *cells.hessian.shape[1:])
        sums: dict[int, Array] = {}
        for azimuth, part in zip(self._azimuths, parts, strict=True):
            sums[azimuth.m] = sums.get(azimuth.m, np.zeros_like(part)) + azimuth.weight * part
        return sums

    def matrices(self, state: MeridianState, t_n: float) -> dict[int, Array]:
        """Return the second variation over all unknowns in each wavenumber, (n_u, n_u)."""
        return {
            m: assemble_dense(self._cell_unknowns, cells, self.n_u)
            for m, cells in self.cell_matrices(state, t_n).items()
        }

    @cached_property
    def masses(self) -> Array:
        """Mean over phi of |u|^2, integrated over the reference area of each cell, in m = 0.

        Vertex rotations count with the small rotary inertia of the section.  In m >= 1 it is half
        of this.

        Returns:
            Shape (n_cells, n_c, n_c).
        """
        shell, mesh = self.shell, self.mesh
        basis = mesh.tabulate(shell.forms.quadrature_points, 0)[0]
        scalar = np.einsum("cqi,cqj,cq->cij", basis, basis, shell.weights)
        n = mesh.degree + 1
        cells = np.zeros((mesh.n_cells, 3 * n + 2, 3 * n + 2))
        for i in range(3):
            cells[:, i : 3 * n : 3, i : 3 * n : 3] = scalar
        thickness = max(section.thickness for section in shell.sections.values())
        inertia = thickness**2 / 12 * shell.weights.sum(axis=1) / 2
        cells[:, [-2, -1], [-2, -1]] = inertia[:, None]
        return cells

    # --- unknowns -----------------------------------------------------------------------------

    def _rotation_index(self, vertices: Indices) -> Indices:
        return 3 * self.mesh.n_nodes + vertices

    def motions(self, m: int, pinned: bool = False) -> Motions:
        """Return the admissible motions of a wavenumber.

        At a pole a smooth displacement has no (r, phi) part in m = 0, no axial part in m = 1, where
        u_r = -u_phi, and none at all from m = 2 on; the pole turns in m = 1 only.

        Args:
            m: Wavenumber.
            pinned: Whether as many unknowns are held as there are rigid motions, so that none is
                left; the number of negative eigenvalues at an equilibrium is not changed by it.
        """
        poles = np.flatnonzero(self.mesh.is_pole)
        first = 3 * self.mesh.degree * poles
        if m == 1:
            held = [first + 1, first + 2]
        else:
            held = [first, first + 1, self._rotation_index(poles)]
            held += [first + 2] if m > 1 else []
        if pinned and m < 2:
            widest = 3 * int(np.argmax(self.mesh.profile.position(self.mesh.s)[:, 0]))
            held += [np.array([widest + 1, widest + 2])]
        free = np.ones(self.n_u, dtype=bool)
        free[np.concatenate(held)] = False
        column = np.where(free, np.cumsum(free) - 1, -1)
        sign = np.ones(self.n_u)
        if m == 1:
            column[first + 1], sign[first + 1] = column[first], -1.0
        return Motions(column, sign)

    def rigid_motions(self, state: MeridianState, m: int) -> Array:
        """Return the rigid motions of a state in wavenumber m as rows, shape (n_rigid, n_u).

        Axial translation and rotation in m = 0, translation and tilting in m = 1: six in all, with
        the twins sin m phi of m = 1.
        """
        mesh = self.mesh
        r, z = state.r.T
        zero, one = np.zeros_like(r), np.ones_like(r)
        still, turn = np.zeros(mesh.n_cells + 1), np.ones(mesh.n_cells + 1)
        motions = {
            0: [((zero, zero, one), still), ((zero, r, zero), still)],
            1: [((one, -one, zero), still), ((-z, z, r), turn)],
        }
        rows = [
            np.concatenate([np.stack(u, axis=1).ravel(), rotation])
            for u, rotation in motions.get(m, [])
        ]
        return np.array(rows).reshape(len(rows), self.n_u)

    # --- spectra ------------------------------------------------------------------------------

    @cached_property
    def _pencils(self) -> dict[int, Pencil]:
        return {m: self._pencil(m, pinned=False) for m in self.wavenumbers}

    @cached_property
    def _pinned(self) -> dict[int, Pencil]:
        """The same without rigid motions, for counts and signs of eigenvalues."""
        return {m: self._pencil(m, True) if m < 2 else self._pencils[m] for m in self.wavenumbers}

    def _pencil(self, m: int, pinned: bool) -> Pencil:
        masses = self.masses * (1.0 if m == 0 else 0.5)
        motions = self.motions(m, pinned)
        return Pencil(motions, self._cell_unknowns, masses, self.shell.has_energy)

    def spectra(self, state: MeridianState, t_n: float) -> dict[int, Spectrum]:
        """Return for each wavenumber the number of negative eigenvalues and the one nearest zero.

        Of a closure without an energy, whose second variation is not symmetric, real parts count.

        Args:
            state: Equilibrium.
            t_n: Its normalised time.
        """
        found = {}
        for m, cells in self.cell_matrices(state, t_n).items():
            self._pinned[m].set(cells)
            values, _ = self._nearest(state, m, cells, 1)
            found[m] = Spectrum(
                self._pinned[m].negative(), float(values[0]) if len(values) else np.nan
            )
        return found

    def _nearest(
        self, state: MeridianState, m: int, cells: Array, count: int
    ) -> tuple[Array, Array]:
        """Return eigenvalues nearest to zero, rigid motions left out, and their vectors."""
        pencil = self._pencils[m]
        pencil.set(cells)
        rigid = [pencil.motions.free(row) for row in self.rigid_motions(state, m)]
        return pencil.nearest(count, rigid)

    def eigenvalue(self, state: MeridianState, t_n: float, m: int, index: int) -> float:
        """Return the eigenvalue of place ``index``, of a sign that agrees with the count.

        Its size has no meaning in m = 0 and 1, where unknowns are held against rigid motions.

        Raises:
            OpticCupError: It is not found.
        """
        pencil = self._pinned[m]
        pencil.set(self.cell_matrices(state, t_n)[m])
        return pencil.eigenvalue(index)

    def modes(self, state: MeridianState, t_n: float, m: int, count: int = 1) -> list[Mode]:
        """Return the modes of a wavenumber whose eigenvalues are nearest to zero, in their order.

        Args:
            state: Equilibrium.
            t_n: Its normalised time.
            m: One of the wavenumbers.
            count: Number of modes; rigid motions are none of them.

        Raises:
            OpticCupError: Not so many are found.
        """
        values, vectors = self._nearest(state, m, self.cell_matrices(state, t_n)[m], count)
        if len(values) < count:
            raise OpticCupError(f"SLEPc finds {len(values)} of {count} modes in m = {m}")
        return [self._mode(m, value, vectors[:, i]) for i, value in enumerate(values)]

    def _mode(self, m: int, eigenvalue: float, vector: Array) -> Mode:
        u = vector[: 3 * self.mesh.n_nodes].reshape(-1, 3)
        scale = u.ravel()[np.argmax(np.abs(u))]
        rotation = vector[3 * self.mesh.n_nodes :]
        return Mode(m, float(eigenvalue), u / scale, rotation / scale)
