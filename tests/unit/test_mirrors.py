"""Deformations that keep two mirror planes, on a coarse cup.

What matters: forces of a symmetric state are symmetric, so that signs and images are right for
positions and angles; energy, gradient and tangent over folded unknowns are those over all of them;
the spectrum is the part of the whole one that keeps the mirrors; what is not symmetric is refused.
"""

from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
import pytest

from opticcup_fem.contact.model import Contact
from opticcup_fem.contact.obstacles import Plate
from opticcup_fem.contact.potential import ContactSettings
from opticcup_fem.equilibrium.mass import consistent_mass, lumped_mass
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.equilibrium.spectrum import Spectrum
from opticcup_fem.errors import CaseError, MeshError
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.supports import free
from opticcup_fem.studies import cup
from opticcup_fem.studies.model import shell_of
from tests.support.cups import coarse_case

Array = npt.NDArray[np.float64]

MIRRORS = (0, 1)
T = 0.02


@pytest.fixture(scope="module")
def shell() -> Shell:
    return shell_of(coarse_case(mesh={"symmetry": 4}), MPI.COMM_SELF)


@pytest.fixture(scope="module")
def folded(shell: Shell) -> Problem:
    return Problem(shell, free(shell), mirrors=MIRRORS)


@pytest.fixture(scope="module")
def whole(shell: Shell) -> Problem:
    return Problem(shell, free(shell))


@pytest.fixture(scope="module")
def motion(folded: Problem) -> Array:
    """A rough motion that keeps the mirrors, owned values."""
    values = 1e-4 * np.random.default_rng(3).normal(size=folded.unknowns.owned)
    values[folded.unknowns.idle_owned] = 0.0
    return values


def moved(shell: Shell, folded: Problem, motion: Array, amount: float = 1.0) -> ShellState:
    """Return the reference state moved, in local equilibrium."""
    shell.set_time(T)
    start = shell.reference_state()
    dr, dalpha = folded.unknowns.split(folded.unknowns.to_local(amount * motion))
    state = replace(start, r=start.r + dr, alpha=start.alpha + dalpha)
    return shell.with_local_equilibrium(replace(state, kappa=shell.curvature_of(state)))


def gradient(problem: Problem, shell: Shell, state: ShellState) -> Array:
    out = problem.vector.duplicate()
    problem.assemble_gradient(shell.condensed(state), state, out)
    return np.array(out.array_r)


def test_a_quarter_of_the_unknowns_is_left(folded: Problem, whole: Problem) -> None:
    """And those on the planes, less what would leave them."""
    share = folded.unknowns.owned / whole.unknowns.owned
    assert 0.25 < share < 0.28


def test_positions_are_mirrored(shell: Shell, folded: Problem, motion: Array) -> None:
    """At the image of a node x and y change their sign with the plane, z never."""
    dr, _ = folded.unknowns.split(folded.unknowns.to_local(motion))
    for plane in MIRRORS:
        flip = np.ones(3)
        flip[plane] = -1.0
        distance = np.linalg.norm((shell.reference * flip)[:, None] - shell.reference, axis=2)
        image = np.argmin(distance, axis=1)
        np.testing.assert_allclose(dr[image], dr * flip, rtol=0, atol=1e-18)


def test_forces_of_a_symmetric_state_are_symmetric(
    shell: Shell, folded: Problem, whole: Problem, motion: Array
) -> None:
    """On nodes and on angles: a sign that is wrong anywhere would leave a force across."""
    state = moved(shell, folded, motion)
    every = whole.unknowns.to_local(gradient(whole, shell, state))
    part = folded.unknowns.symmetric_part(*folded.unknowns.split(every))
    assert np.abs(every).max() > 1e-3
    np.testing.assert_allclose(folded.unknowns.to_local(part), every, rtol=0, atol=1e-12)
    for forces in folded.unknowns.split(every):
        assert np.abs(forces).max() > 1e-4


def test_folded_gradient_is_the_slope_of_the_energy(
    shell: Shell, folded: Problem, motion: Array
) -> None:
    """Of the whole shell's energy along the motion: all images count."""
    step = 1e-3
    ends = [folded.energy(moved(shell, folded, motion, 1 + s)) for s in (step, -step)]
    slope = gradient(folded, shell, moved(shell, folded, motion)) @ motion
    assert slope == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-6)


def test_folded_matrices_are_those_of_the_whole(
    shell: Shell, folded: Problem, whole: Problem, motion: Array
) -> None:
    """Tangent and both masses A in u . A u, u the motion over all unknowns."""
    cells = shell.condensed(moved(shell, folded, motion))
    products = []
    for problem in (folded, whole):
        problem.assemble_tangent(cells)
        u, image = problem.vector.duplicate(), problem.vector.duplicate()
        local = folded.unknowns.to_local(motion)
        u.array[:] = problem.unknowns.owned_values(*problem.unknowns.split(local))
        values = []
        for matrix in (problem.matrix, consistent_mass(problem)):
            matrix.mult(u, image)
            values.append(image.dot(u))
        image.pointwiseMult(lumped_mass(problem), u)
        products.append([*values, image.dot(u)])
    np.testing.assert_allclose(*products, rtol=1e-10)


def test_spectrum_is_the_symmetric_part_of_the_whole(shell: Shell) -> None:
    """Each of its eigenvalues is one of the whole shell's; one of each m = 2 pair is left."""
    shell.set_time(T)
    state = shell.with_updated_directors(shell.reference_state())
    few = [mode.eigenvalue for mode in Spectrum(shell, mirrors=MIRRORS).modes(state, 4)]
    many = np.array([mode.eigenvalue for mode in Spectrum(shell).modes(state, 24)])
    for value in few:
        assert np.abs(many - value).min() < 1e-6 * abs(value)
    beside = np.abs(many[:, None] - few).min(axis=1) < 1e-5
    assert 4 <= beside.sum() < 24


def test_contact_is_folded_too(shell: Shell, motion: Array) -> None:
    """Its gradient and stiffness are derivatives of the energy, between two plates."""
    height = 1 + shell.thickness / 2 + 0.021
    plates = [
        Plate((0, 0, side * height), (0, 0, 1), 3.0, velocity=(0, 0, -side)) for side in (1, -1)
    ]
    shell.set_time(0.0)
    contact = Contact(shell, ContactSettings(0.02, 1.0), plates)
    folded = Problem(shell, free(shell), contact, MIRRORS)
    shell.set_time(0.009)  # by which the plates have come nearer, too
    start = folded.with_contact(shell.reference_state())
    assert start.contact is not None and start.contact.touches
    dr, dalpha = folded.unknowns.split(folded.unknowns.to_local(motion))

    def at(amount: float) -> ShellState:
        state = replace(start, r=start.r + amount * dr, alpha=start.alpha + amount * dalpha)
        return shell.with_local_equilibrium(replace(state, kappa=shell.curvature_of(state)))

    step, state = 1e-2, at(1.0)
    pushed = folded._pushed(state, folded.unknowns)
    assert pushed is not None and pushed.norm() > 0
    slope = gradient(folded, shell, state) @ motion
    change = folded.energy(at(1 + step)) - folded.energy(at(1 - step))
    assert slope == pytest.approx(change / (2 * step), rel=1e-5)
    folded.assemble_tangent(shell.condensed(state), folded.contact_stiffness(state))
    u, image = folded.vector.duplicate(), folded.vector.duplicate()
    u.array[:] = motion
    folded.matrix.mult(u, image)
    ends = [gradient(folded, shell, at(1 + s)) for s in (step, -step)]
    expected = (ends[0] - ends[1]) / (2 * step)
    np.testing.assert_allclose(image.array_r, expected, rtol=0, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize(("formula", "limit"), [("1 + cos(2*phi)", 0.0), ("1 + cos(phi)", 1e-5)])
def test_growth_that_is_not_symmetric_pushes_across(formula: str, limit: float) -> None:
    """The force that keeping the mirrors takes up is nought only for symmetric tissue."""
    shell = shell_of(coarse_case(mesh={"symmetry": 4}, growth={"oov": formula}), MPI.COMM_SELF)
    problem = Problem(shell, free(shell), mirrors=MIRRORS)
    shell.set_time(T)
    across = problem.force_across_mirrors(shell.with_local_equilibrium(shell.reference_state()))
    assert across > limit if limit else across < 1e-12


def test_run_with_growth_that_is_not_symmetric_ends_with_a_sentence(tmp_path: Path) -> None:
    """Instead of a path on which the mirrors hold the tissue."""
    keys = {"keep_mirrors": True}
    case = coarse_case(t_end=0.01, run=keys, growth={"oov": "1 + cos(phi)"})
    with pytest.raises(CaseError, match=r"run\.keep_mirrors = true .* layers and growth must be"):
        cup.run(case, tmp_path, quiet=True)


def test_mesh_without_mirrors_is_refused() -> None:
    """In one sentence that says which planes, and what to take."""
    plain = shell_of(coarse_case(), MPI.COMM_SELF)
    with pytest.raises(MeshError, match=r"x = 0 and y = 0.*mesh\.symmetry = 4"):
        Problem(plain, free(plain), mirrors=MIRRORS)
