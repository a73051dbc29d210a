"""Second variations in each wavenumber.

The two tests worth reading: the kinematics against finite differences of the surface in space, and
the six rigid motions of a deformed, grown, stressed cup.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from scipy import linalg

from opticcup_fem.equilibrium.continuation import Continuation
from opticcup_fem.meridian.forms import WaveForms
from opticcup_fem.meridian.problem import MeridianProblem, assemble_dense
from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.meridian.waves import Waves
from opticcup_fem.shell.forms import Integral
from opticcup_fem.shell.kernels import Kernel
from tests.support.meridians import PROFILES, bent_state, shell_on

T_N = 0.03


@pytest.fixture(scope="module")
def shell() -> MeridianShell:
    return shell_on(PROFILES["closed"])


@pytest.fixture(scope="module")
def problem(shell: MeridianShell) -> MeridianProblem:
    return MeridianProblem(shell)


@pytest.fixture(scope="module")
def waves(shell: MeridianShell) -> Waves:
    return Waves(shell, (0, 1, 2, 3))


@pytest.fixture(scope="module")
def equilibrium(problem: MeridianProblem) -> MeridianState:
    continuation = Continuation(problem)
    x = problem.pack(problem.shell.reference_state())
    for state in continuation.follow(x, 0.0, T_N):
        x = state.x
    return problem.unpack(x)


# --- kinematics ---------------------------------------------------------------------------------


def placed(position: np.ndarray, u: np.ndarray, m: int, phi: float) -> np.ndarray:
    """Return the perturbed positions in space at an azimuth, shape (n, 3)."""
    radial = position[:, 0] + u[:, 0] * np.cos(m * phi)
    turn = u[:, 1] * np.sin(m * phi)
    return np.stack(
        [
            radial * np.cos(phi) - turn * np.sin(phi),
            radial * np.sin(phi) + turn * np.cos(phi),
            position[:, 1] + u[:, 2] * np.cos(m * phi),
        ],
        axis=1,
    )


def forms_in_space(
    shell: MeridianShell, position: np.ndarray, u: np.ndarray, m: int, phi: float
) -> dict[int, np.ndarray]:
    """Return the fundamental forms at the quadrature points by differences in phi."""
    mesh, step = shell.mesh, 1e-4
    tables = mesh.tabulate(shell.forms.quadrature_points, 2)

    def along(order: int, azimuth: float) -> np.ndarray:
        nodes = placed(position, u, m, azimuth)[mesh.cells]
        return np.einsum("cqn,cni->cqi", tables[order], nodes)

    def differences(order: int) -> tuple[np.ndarray, np.ndarray]:
        low, middle, high = (along(order, phi + k * step) for k in (-1, 0, 1))
        return (high - low) / (2 * step), (high - 2 * middle + low) / step**2

    x_s, x_ss = along(1, phi), along(2, phi)
    x_phi, x_phiphi = differences(0)
    x_sphi, _ = differences(1)
    n = np.cross(x_s, x_phi)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    radius = shell.radius_ref
    return {
        0: np.sum(x_s * x_s, -1),
        1: np.sum(x_phi * x_phi, -1) / radius**2,
        2: np.sum(x_s * x_phi, -1) / radius,
        3: np.sum(n * x_ss, -1),
        4: np.sum(n * x_phiphi, -1) / radius**2,
        5: np.sum(n * x_sphi, -1) / radius,
    }


@pytest.mark.parametrize("m", [0, 1, 2, 5])
def test_forms_are_those_of_the_surface_in_space(shell: MeridianShell, m: int) -> None:
    """Integrals over each cell away from the poles, at the azimuths phi = 0 and pi/(2m)."""
    rng = np.random.default_rng(5)
    forms = WaveForms(shell.mesh)
    position = bent_state(shell, 4).r
    s = shell.mesh.s[:, None]
    u = (
        0.05
        * np.sin(s) ** 2
        * np.concatenate([np.cos(k * s) * rng.normal(size=3) for k in (0,)], 1)
    )
    strains = forms._strains()
    components = [*zip(strains.components, strains.direct, strict=True), (3, strains.curvature)]
    for phi in (0.0,) if m == 0 else (0.0, np.pi / (2 * m)):
        # in m = 0 both factors are one: the torsion is uniform
        cosine, sine = (1.0, 1.0) if m == 0 else (np.cos(m * phi), np.sin(m * phi))
        if m == 0:
            u = u * np.array([1.0, 0.0, 1.0])
        exact = forms_in_space(shell, position, u, m, phi)
        cells = np.ones((shell.mesh.n_cells, 1))
        data: dict[ufl.Coefficient, np.ndarray] = {
            forms.base: position[shell.mesh.cells],
            forms.r: u[shell.mesh.cells],
            forms.radius: shell.radius_ref,
            forms.wave: cells * np.array([m, cosine, sine]),
        }
        for component, expression in components:
            kernel = Kernel(
                MPI.COMM_SELF, Integral(expression * forms.dx, False), shell.mesh.corners()
            )
            weights = forms.quadrature_weights * shell.mesh.sizes[:, None]
            found = kernel(data) / shell.mesh.sizes
            mean = np.sum(exact[component] * weights, axis=1) / shell.mesh.sizes
            np.testing.assert_allclose(found[1:-1], mean[1:-1], atol=2e-6, err_msg=str(component))


# --- second variation ---------------------------------------------------------------------------


def test_m_0_without_torsion_is_the_axisymmetric_tangent(
    shell: MeridianShell, problem: MeridianProblem, waves: Waves, equilibrium: MeridianState
) -> None:
    matrix = waves.matrices(equilibrium, T_N)[0]
    cells = problem.linearise(problem.pack(equilibrium), T_N).cells.hessian
    axisymmetric = assemble_dense(problem.cell_unknowns, cells, problem.n_u)
    n = shell.mesh.n_nodes
    positions = np.stack([3 * np.arange(n), 3 * np.arange(n) + 2], axis=1).ravel()
    kept = np.concatenate([positions, 3 * n + np.arange(shell.mesh.n_cells + 1)])
    scale = np.abs(axisymmetric).max()
    np.testing.assert_allclose(matrix[np.ix_(kept, kept)], axisymmetric, atol=1e-10 * scale)
    # rotations of the poles, which m = 0 holds, would tilt them
    kept = kept[:-1][kept[:-1] != 3 * n]
    torsion = 3 * np.arange(n) + 1
    assert np.abs(matrix[np.ix_(torsion, kept)]).max() < 1e-10 * scale


@pytest.mark.parametrize("m", [0, 1])
def test_rigid_motions_cost_nothing(
    shell: MeridianShell, waves: Waves, equilibrium: MeridianState, m: int
) -> None:
    """All six: two in m = 0, two in m = 1 with their twins; in units of the stiffness."""
    matrix, admissible = waves.matrices(equilibrium, T_N)[m], waves.motions(m)
    basis = admissible.whole(np.eye(admissible.size))
    mass = assemble_dense(waves._cell_unknowns, waves.masses, waves.n_u)
    motions = waves.rigid_motions(equilibrium, m)
    assert len(motions) == 2
    for motion in motions:
        assert abs(motion @ matrix @ motion) / (motion @ mass @ motion) < 1e-8
        force = basis.T @ matrix @ motion
        assert np.abs(force).max() < 1e-8 * np.abs(matrix).max()
        np.testing.assert_allclose(admissible.whole(admissible.free(motion)), motion, atol=1e-12)


def test_second_variations_are_symmetric(waves: Waves, equilibrium: MeridianState) -> None:
    for matrix in waves.matrices(equilibrium, T_N).values():
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())


@pytest.mark.parametrize("m", [0, 1, 2, 3])
def test_spectra_are_those_of_lapack(waves: Waves, equilibrium: MeridianState, m: int) -> None:
    """Rigid motions are no modes; counts, signs and single eigenvalues agree."""
    admissible = waves.motions(m)
    basis = admissible.whole(np.eye(admissible.size))
    masses = waves.masses * (1.0 if m == 0 else 0.5)
    mass = basis.T @ assemble_dense(waves._cell_unknowns, masses, waves.n_u) @ basis
    stiffness = basis.T @ waves.matrices(equilibrium, T_N)[m] @ basis
    dense, vectors = linalg.eigh(stiffness, mass)
    rigid = np.argsort(np.abs(dense))[: len(waves.rigid_motions(equilibrium, m))]
    np.testing.assert_allclose(dense[rigid], 0.0, atol=1e-7)
    elastic = np.delete(dense, rigid)
    spectrum = waves.spectra(equilibrium, T_N)[m]
    assert spectrum.negative == np.sum(elastic < 0)
    nearest = elastic[np.argsort(np.abs(elastic))][:4]
    assert spectrum.nearest == pytest.approx(nearest[0], rel=1e-6)
    modes = waves.modes(equilibrium, T_N, m, 4)
    np.testing.assert_allclose([mode.eigenvalue for mode in modes], np.sort(nearest), rtol=1e-6)
    for mode in modes:
        assert np.abs(mode.u).max() == pytest.approx(1.0)
        shape = admissible.free(np.concatenate([mode.u.ravel(), mode.rotation]))
        theirs = vectors[:, np.argmin(np.abs(dense - mode.eigenvalue))]
        assert abs(theirs @ mass @ shape) ** 2 == pytest.approx(shape @ mass @ shape, rel=1e-8)
    for index in range(3):
        pinned = waves.eigenvalue(equilibrium, T_N, m, index)
        assert np.sign(pinned) == np.sign(elastic[index])
        if m > 1:
            assert pinned == pytest.approx(elastic[index], rel=1e-6)


@pytest.mark.parametrize("wavenumbers", [(-1, 2), (2, 2)])
def test_wavenumbers_without_meaning_are_refused(
    shell: MeridianShell, wavenumbers: tuple[int, ...]
) -> None:
    with pytest.raises(ValueError, match="wavenumbers"):
        Waves(shell, wavenumbers)
