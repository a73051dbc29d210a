"""Contact of surfaces: geometry, barrier, obstacles.

What matters: the gap is the distance between faces, so the half thicknesses are respected; forces
push apart, balance, and are the derivative of the energy, as the Hessian is theirs; neighbours
along the shell never touch; a finer collision mesh gives the same energy; no step goes through.
"""

import numpy as np
import pytest

from opticcup_fem.contact.barrier import Barrier
from opticcup_fem.contact.faces import nodal_means
from opticcup_fem.contact.obstacles import Box, Obstacle, Plate, Sphere, joined
from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.snapshot import Snapshot
from tests.support.shapes import deformed, revolved, sphere_mesh, with_layers

H = 0.05
FLAT, ROUND = 0.45, 1.2
"""Colatitude up to which the dimple lies on the bottom, and from which the sphere is as it was."""


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    return sphere_mesh(0.2)


def offsets_of(state: Snapshot, thickness: float = H) -> np.ndarray:
    """Vectors from the nodes to both faces of a shell of constant thickness."""
    layered = with_layers(state, thickness)
    vectors = np.empty((len(state.cells), 10, 2, 3))
    for region, faces in layered.faces.items():
        cells = state.cells_of(region)
        middle = state.position[state.cells[cells]]
        vectors[cells] = faces[:, :, [0, -1]] - middle[:, :, None]
    return nodal_means(vectors, state.cells, len(state.position))


def dimple(sphere: Snapshot, gap: float) -> Snapshot:
    """The sphere with its top pushed down until it lies evenly over the bottom.

    Up to ``FLAT`` the top's inner face is a sphere concentric with the bottom's, ``gap`` away.
    """
    radius = 1 - H - gap

    def shape(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        x = np.clip((theta - FLAT) / (ROUND - FLAT), 0, 1)
        blend = x**3 * (10 - 15 * x + 6 * x**2)
        r = (radius * (1 - blend) + blend) * np.sin(theta)
        return revolved(r, (blend - radius * (1 - blend)) * np.cos(theta), phi)

    return deformed(sphere, shape)


def surface_of(
    sphere: Snapshot, parts: int = 3, exempt: float = 0.1, obstacles: tuple[Obstacle, ...] = ()
) -> ContactSurface:
    return ContactSurface(
        sphere.reference, sphere.cells, sphere.orientation, exempt, parts, obstacles
    )


@pytest.mark.parametrize(("parts", "sag"), [(3, 1.2e-3), (6, 3e-4)])
def test_gap_is_the_distance_between_faces(sphere: Snapshot, parts: int, sag: float) -> None:
    """Mid-surfaces apart less half the thickness of each, less what flat triangles sag; cut off."""
    gap = 0.01
    state = dimple(sphere, gap)
    surface = surface_of(sphere, parts)
    vertices = surface.vertices(state.position, offsets_of(state))
    found = Barrier(surface, 0.02, 1.0).gap(vertices)
    assert gap - sag < found < gap
    assert Barrier(surface, 0.9 * found, 1.0).gap(vertices) == np.inf
    assert Barrier(surface, 0.9 * found, 1.0).energy(vertices) == 0.0
    thinner = surface.vertices(state.position, 0.8 * offsets_of(state))
    assert Barrier(surface, 0.04, 1.0).gap(thinner) == pytest.approx(found + 0.2 * H, abs=sag)


def test_forces_push_apart_and_balance(sphere: Snapshot) -> None:
    """The apex is pushed up and the bottom down: descent of the energy; force and moment vanish."""
    state = dimple(sphere, 0.01)
    surface = surface_of(sphere)
    gradient = Barrier(surface, 0.02, 1.0).gradient(
        surface.vertices(state.position, offsets_of(state))
    )
    assert gradient is not None
    apex, bottom = (int(np.argmax(side * sphere.reference[:, 2])) for side in (1, -1))
    assert gradient[apex, 2] < 0 < gradient[bottom, 2]
    largest = np.abs(gradient).max()
    assert np.abs(gradient.sum(axis=0)).max() < 1e-12 * largest
    # the inner faces that touch lie between the mid-surfaces
    moment = np.cross(state.position, gradient).sum(axis=0)
    assert np.abs(moment).max() < 1e-2 * np.abs(gradient).sum()


def test_gradient_and_hessian_are_derivatives(sphere: Snapshot) -> None:
    """Central differences of energy and gradient along a random motion."""
    state = dimple(sphere, 0.01)
    surface = surface_of(sphere, parts=4)
    barrier = Barrier(surface, 0.02, 0.7)
    offsets = offsets_of(state)
    direction = np.random.default_rng(1).normal(size=state.position.shape)

    def moved(step: float) -> np.ndarray:
        return surface.vertices(state.position + step * direction, offsets)

    gradient, hessian = barrier.gradient(moved(0)), barrier.hessian(moved(0))
    assert gradient is not None and hessian is not None
    assert abs(hessian - hessian.T).max() < 1e-12 * abs(hessian).max()
    step = 1e-7
    slope = (barrier.energy(moved(step)) - barrier.energy(moved(-step))) / (2 * step)
    assert slope == pytest.approx(np.sum(gradient * direction), rel=1e-6)
    after, before = barrier.gradient(moved(step)), barrier.gradient(moved(-step))
    assert after is not None and before is not None
    bend = (after - before).ravel() / (2 * step)
    expected = hessian @ direction.ravel()
    assert np.abs(bend - expected).max() < 1e-5 * np.abs(expected).max()


def test_stiffness_and_distance_enter(sphere: Snapshot) -> None:
    """Energy and forces are proportional to the stiffness; a longer barrier pushes more."""
    state = dimple(sphere, 0.01)
    surface = surface_of(sphere)
    vertices = surface.vertices(state.position, offsets_of(state))
    one = Barrier(surface, 0.02, 1.0).energy(vertices)
    assert Barrier(surface, 0.02, 3.0).energy(vertices) == pytest.approx(3 * one)
    assert Barrier(surface, 0.04, 1.0).energy(vertices) > 2 * one


def test_vertices_are_linear_in_the_nodes(sphere: Snapshot) -> None:
    """With three parts the vertices are nodes; finer ones interpolate nodes and offsets alike."""
    rng = np.random.default_rng(2)
    r, offsets = (
        rng.normal(size=sphere.reference.shape),
        rng.normal(size=(2, *sphere.reference.shape)),
    )
    offsets = np.moveaxis(offsets, 0, 1)
    coarse, fine = surface_of(sphere), surface_of(sphere, parts=6)
    vertices = coarse.vertices(r, offsets)
    np.testing.assert_allclose(vertices[: len(r)], r + offsets[:, 0])
    np.testing.assert_allclose(vertices[len(r) :], r + offsets[:, 1])
    halves = 0.5 * fine.vertices(2 * r, 2 * offsets)
    np.testing.assert_allclose(fine.vertices(r, offsets), halves, atol=1e-12)
    # both cut the same surface: every vertex of the coarse one is one of the fine one
    places = {tuple(np.round(v, 9)) for v in fine.vertices(r, offsets)}
    assert all(tuple(np.round(v, 9)) in places for v in vertices)


def test_force_is_pulled_back_by_virtual_work(sphere: Snapshot) -> None:
    """Force times velocity is the same at the vertices and at the nodes."""
    rng = np.random.default_rng(3)
    surface = surface_of(sphere, parts=5, obstacles=(Plate((0, 0, -3), (0, 0, 1), 2.0),))
    none = np.zeros((len(sphere.reference), 2, 3))
    velocity = rng.normal(size=sphere.reference.shape)
    at_vertices = surface.vertices(velocity, none) - surface.vertices(0 * velocity, none)
    force = rng.normal(size=at_vertices.shape)
    expected = np.sum(force * at_vertices)
    assert np.sum(surface.pull_back(force) * velocity) == pytest.approx(expected, rel=1e-12)


def test_energy_is_an_integral_over_the_surface(sphere: Snapshot) -> None:
    """Pressed surfaces: k d_hat b(gap/d_hat) times the area, and somewhat more; never less."""
    distance, gap, stiffness = 0.02, 0.01, 3.0
    state = dimple(sphere, gap)
    offsets = offsets_of(state)
    x = (gap / distance) ** 2
    density = -stiffness * distance * (x - 1) ** 2 * np.log(x)
    area = 2 * np.pi * (1 - np.cos(FLAT))
    for parts in (3, 4):
        surface = surface_of(sphere, parts)
        vertices = surface.vertices(state.position, offsets)
        energy = Barrier(surface, distance, stiffness).energy(vertices)
        assert area * density < energy < 2 * area * density


def test_neighbours_along_the_shell_do_not_touch(sphere: Snapshot) -> None:
    """A barrier wider than the triangles sees neighbours only where they are not exempt."""
    offsets = offsets_of(sphere)
    none, near = surface_of(sphere, exempt=-1.0), surface_of(sphere)
    wide = 0.07
    assert Barrier(none, wide, 1.0).gap(none.vertices(sphere.reference, offsets)) < wide
    assert Barrier(near, wide, 1.0).gap(near.vertices(sphere.reference, offsets)) == np.inf
    # parts far apart in the reference surface touch as before
    state = dimple(sphere, 0.01)
    vertices = near.vertices(state.position, offsets_of(state))
    assert Barrier(near, 0.02, 1.0).gap(vertices) < 0.01


def test_steps_end_before_a_collision(sphere: Snapshot) -> None:
    """The apex pushed 5 gaps down may go one; back up there is no bound."""
    gap = 0.05
    surface = surface_of(sphere)
    barrier = Barrier(surface, 0.02, 1.0)
    start = dimple(sphere, gap)
    offsets = offsets_of(start)
    before = surface.vertices(start.position, offsets)
    through = surface.vertices(dimple(sphere, -4 * gap).position, offsets)
    free = barrier.free_fraction(before, through)
    assert 0.7 * 0.2 < free < 0.2
    assert not barrier.crosses(before) and barrier.crosses(through)
    stopped = np.asfortranarray(before + free * (through - before))
    assert not barrier.crosses(stopped)
    assert barrier.free_fraction(before, surface.vertices(sphere.reference, offsets)) == 1.0


def test_room_that_was_found_is_not_trusted_too_far(sphere: Snapshot) -> None:
    """A barrier that has seen wide states finds the contact of a later one, and forgets it."""
    surface = surface_of(sphere)
    used = Barrier(surface, 0.012, 1.0)
    for gap in (0.3, 0.04, 0.01, 0.014, 0.3, 0.008):
        state = dimple(sphere, gap)
        vertices = surface.vertices(state.position, offsets_of(state))
        assert used.gap(vertices) == Barrier(surface, 0.012, 1.0).gap(vertices)
        assert used.energy(vertices) == Barrier(surface, 0.012, 1.0).energy(vertices)


BODIES = [
    (Box((1.0, 2.0, 3.0), (0.5, 1.0, 2.0)), 1.0),
    (Sphere((0.0, 1.0, 0.0), 2.0, refinements=4), 4 / 3 * np.pi * 8),
]


@pytest.mark.parametrize(("body", "volume"), BODIES)
def test_bodies_are_closed_and_wind_outwards(body: Obstacle, volume: float) -> None:
    """The volume inside, by the theorem of Gauss, is that of the body."""
    mesh = body.mesh()
    edges = mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert {tuple(e) for e in edges.tolist()} == {tuple(e[::-1]) for e in edges.tolist()}
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    inside = np.einsum("ij,ij->", np.cross(a, b), c) / 6
    assert inside == pytest.approx(volume, rel=1e-2)


def test_plate_faces_along_its_normal() -> None:
    """Right area, in its plane, triangles wound about the normal and no larger than asked."""
    plate = Plate((1.0, 0.0, -1.0), (0.0, 1.0, 1.0), 2.0, cell_size=0.3)
    mesh = plate.mesh()
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    area = np.cross(b - a, c - a).sum(axis=0) / 2
    np.testing.assert_allclose(area, 4 * np.array([0, 1, 1]) / np.sqrt(2), atol=1e-12)
    np.testing.assert_allclose((mesh.vertices - plate.centre) @ plate.normal, 0, atol=1e-12)
    assert min(np.ptp(corners, axis=0).max() for corners in (a, b, c)) > 1.5
    assert np.linalg.norm(b - a, axis=1).min() < 0.3 < 2 * np.linalg.norm(b - a, axis=1).min()


def test_obstacles_move_evenly(sphere: Snapshot) -> None:
    """Two bodies as one mesh; each moves with its own velocity."""
    plate = Plate((0, 0, -2), (0, 0, 1), 1.0, velocity=(0.0, 0.0, 0.5))
    ball = Sphere((0, 0, 3), 0.5, refinements=0)
    start, later = joined([plate, ball], 0.0), joined([plate, ball], 0.4)
    moved = later.vertices - start.vertices
    np.testing.assert_allclose(moved[:4], np.tile([0, 0, 0.2], (4, 1)), atol=1e-15)
    np.testing.assert_allclose(moved[4:], 0)
    assert start.triangles[:2].max() == 3 and start.triangles[2:].min() == 4


def test_a_plate_pushes_the_nearest_face(sphere: Snapshot) -> None:
    """Below the bottom: the gap is that to the outer face, the bottom is pushed up."""
    gap = 0.003
    plate = Plate((0, 0, -1 - H / 2 - gap), (0, 0, 1), 4.0)
    surface = surface_of(sphere, obstacles=(plate,))
    barrier = Barrier(surface, 0.02, 1.0)
    vertices = surface.vertices(sphere.reference, offsets_of(sphere))
    assert barrier.gap(vertices) == pytest.approx(gap, rel=1e-5)
    gradient = barrier.gradient(vertices)
    assert gradient is not None
    assert gradient[:, 2].sum() < -0.9 * np.abs(gradient).sum() / 3 < 0
    raised = sphere.reference + np.array([0.0, 0.0, 0.02])
    assert barrier.gradient(surface.vertices(raised, offsets_of(sphere))) is None
