"""Mirrors as walls: the contact of a shell with its own mirror image.

What matters: the energy is that of two flat faces in closed form, force and stiffness are its
derivatives; the part and its images together push as the pairs of the whole do;
what bends across a mirror does not touch it; no step goes through.
"""

from mpi4py import MPI

import numpy as np
import pytest

from opticcup_fem.contact.law import barrier
from opticcup_fem.contact.potential import ContactSettings, Potential
from opticcup_fem.contact.walls import Walls
from opticcup_fem.shell.recovery import capture
from opticcup_fem.snapshot import Snapshot
from opticcup_fem.studies.model import shell_of
from tests.support.cups import coarse_case
from tests.unit.test_contact import faces_of, shell_faces

H = 0.05
D_HAT = 0.02
"""Thickness, and gap at which contact begins."""


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    """A sphere whose mesh has the mirrors x = 0 and y = 0."""
    shell = shell_of(coarse_case(mesh={"symmetry": 4}), MPI.COMM_SELF)
    snapshot = capture(shell, shell.reference_state(), 0.0)
    assert snapshot is not None
    return snapshot


def part_of(sphere: Snapshot, *mirrors: int) -> np.ndarray:
    """Return the cells in x_i > 0."""
    middle = sphere.reference[sphere.cells].mean(axis=1)
    return sphere.cells[np.all(middle[:, list(mirrors)] > 0, axis=1)]


def walls_of(sphere: Snapshot, *mirrors: int, stiffness: float = 0.7) -> Walls:
    return Walls(sphere.reference, part_of(sphere, *mirrors), mirrors, H, D_HAT, stiffness)


def faces_beside(sphere: Snapshot, plane: int, away: float) -> np.ndarray:
    """Both faces of the sphere pressed flat, ``away`` from a plane; the outer one far from it."""
    faces = np.stack([sphere.reference, sphere.reference])
    faces[0][:, plane] = away
    faces[1][:, plane] = 0.5
    return faces


@pytest.mark.parametrize("plane", [0, 1])
def test_energy_of_flat_faces(sphere: Snapshot, plane: int) -> None:
    """k/2 d_hat b(2 d/d_hat) over the hemisphere but for what is near the mirror."""
    walls = walls_of(sphere, plane)
    away = 0.3 * D_HAT
    distances = walls.distances(faces_beside(sphere, plane, away))
    # a band of a sphere has the area of its height; half of the ramp's counts
    area = 2 * np.pi * (1 - 0.75 * H - D_HAT)
    expected = area * 0.7 / 2 * D_HAT * barrier(np.array([0.6]))[0][0]
    assert walls.energy(distances) == pytest.approx(expected, rel=2e-3)
    assert walls.gap(distances) == pytest.approx(2 * away)
    far = walls.distances(faces_beside(sphere, plane, 0.51 * D_HAT))
    assert walls.energy(far) == 0.0
    assert walls.gradient(far) is None and walls.hessian(far) is None
    assert walls.gap(far) == np.inf
    through = walls.distances(faces_beside(sphere, plane, -0.1 * D_HAT))
    assert walls.energy(through) == np.inf


def test_gradient_and_hessian_are_derivatives(sphere: Snapshot) -> None:
    """Central differences along a random motion; pushed off the planes, along their normals."""
    walls = walls_of(sphere, 0, 1)
    faces = np.stack([sphere.reference, 0.9 * sphere.reference])
    faces[..., :2] = 0.2 * D_HAT + 0.02 * np.abs(faces[..., :2])
    direction = np.random.default_rng(2).normal(size=faces.shape)

    def at(step: float) -> np.ndarray:
        return walls.distances(faces + step * direction)

    gradient, hessian, step = walls.gradient(at(0)), walls.hessian(at(0)), 1e-7
    assert gradient is not None and hessian is not None
    assert np.all(gradient[..., 2] == 0)
    assert gradient[0].sum(axis=0)[0] < 0 and gradient[1].sum(axis=0)[1] < 0
    slope = (walls.energy(at(step)) - walls.energy(at(-step))) / (2 * step)
    assert slope == pytest.approx(np.sum(gradient * direction), rel=1e-6)
    after, before = walls.gradient(at(step)), walls.gradient(at(-step))
    assert after is not None and before is not None
    bend, expected = (after - before).ravel() / (2 * step), hessian @ direction.ravel()
    assert np.abs(bend - expected).max() < 1e-5 * np.abs(expected).max()


def test_no_step_goes_through(sphere: Snapshot) -> None:
    """A way ends where the nearest point meets the plane, or the gap that is to be kept."""
    walls = walls_of(sphere, 0)
    start, end = (walls.distances(faces_beside(sphere, 0, away)) for away in (0.03, -0.01))
    assert walls.free_fraction(start, end) == pytest.approx(0.75)
    assert walls.free_fraction(start, end, 0.02) == pytest.approx(0.5)
    assert walls.free_fraction(end + 0.02, start) == 1.0


def test_what_bends_across_a_mirror_does_not_touch_it(sphere: Snapshot) -> None:
    """The sphere itself is nowhere near its image, although it goes through the plane."""
    walls = walls_of(sphere, 0, 1)
    distances = walls.distances(faces_of(sphere, H))
    assert walls.gap(distances) == np.inf and walls.energy(distances) == 0.0
    thick = Walls(sphere.reference, part_of(sphere, 0), (0,), 0.2, 0.2, 1.0)
    assert thick.gap(thick.distances(faces_of(sphere, 0.2))) == np.inf


def test_part_and_images_stand_for_the_whole(sphere: Snapshot) -> None:
    """Forces of all images balance, are mirrored, and add up to those between two flat faces."""
    settings = ContactSettings(D_HAT, 0.7)
    potential = Potential(
        sphere.reference, sphere.cells, sphere.orientation, H, settings, mirrors=(0, 1)
    )
    assert potential.images == 4
    away, n = 0.25 * D_HAT, len(sphere.reference)
    faces = np.stack([sphere.reference, sphere.reference])
    side = np.where(sphere.reference[:, 0] > -1e-9, 1.0, -1.0)
    faces[:, :, 1:] *= np.sqrt(2 / (1 + np.abs(sphere.reference[:, :1])))  # flat, of equal area
    faces[:, :, 0] = np.array([away, 0.5])[:, None] * side
    sites = sphere.cells.ravel()
    placed = potential.placed(faces[:, sites], 0.0)
    at_sites = potential.gradient(placed)
    assert at_sites is not None
    gradient = shell_faces(sphere).at_nodes(at_sites)
    every = potential.of_all(gradient)
    assert every.shape == (2, n, 3)
    total = every.sum(axis=(0, 1))
    assert np.abs(total).max() < 1e-12 * np.abs(every).sum()
    # half a sphere is pressed on each side, but for what is near the mirror
    area, (value, slope, _) = 2 * np.pi * (1 - 0.75 * H - D_HAT), barrier(np.array([0.5]))
    assert -gradient[0, :, 0].sum() == pytest.approx(-area / 2 * 0.7 * slope[0], rel=2e-3)
    assert potential.energy(placed) == pytest.approx(area * 0.7 * D_HAT * value[0], rel=5e-3)
    assert potential.gap(placed) == pytest.approx(2 * away)
