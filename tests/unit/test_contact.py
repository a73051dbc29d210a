"""Contact of surfaces: geometry, barrier, obstacles.

What matters: the gap is the distance between faces, so the half thicknesses are respected; forces
push apart, balance, and are the derivative of the energy, as the Hessian is theirs; neighbours
along the shell never touch; a finer collision mesh gives the same energy; no step goes through.
"""

import itertools

import numpy as np
import pytest

from opticcup_fem.contact.barrier import Barrier
from opticcup_fem.contact.blocks import Blocks
from opticcup_fem.contact.faces import ShellFaces
from opticcup_fem.contact.obstacles import Box, Obstacle, Plate, Sphere, joined
from opticcup_fem.contact.potential import exempt_distance
from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.snapshot import NODES, Snapshot, lagrange_gradient
from tests.support.blocks import matrix_of
from tests.support.shapes import deformed, revolved, sphere_mesh

H = 0.05
FLAT, ROUND = 0.45, 1.2
"""Colatitude up to which the dimple lies on the bottom, and from which the sphere is as it was."""


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    return sphere_mesh(0.2)


def shell_faces(mesh: Snapshot) -> ShellFaces:
    """Faces of a shell on a mesh, r_,1 and r_,2 along the sides of the cells."""
    gradient = np.tile(lagrange_gradient(NODES), (len(mesh.cells), 1, 1, 1))
    gradient[..., 1] *= mesh.orientation[:, None, None]
    return ShellFaces(mesh.cells, gradient, len(mesh.reference))


def heights_of(mesh: Snapshot, thickness: float = H) -> np.ndarray:
    """Heights of both faces of a shell of constant thickness."""
    return np.tile([-thickness / 2, thickness / 2], (*mesh.cells.shape, 1))


def faces_of(state: Snapshot, thickness: float = H) -> np.ndarray:
    """Both faces of a shell of constant thickness at its nodes, the mean of their cells'."""
    faces = shell_faces(state)
    places = faces.places(state.position, heights_of(state, thickness))
    return faces.at_nodes(places) / np.bincount(state.cells.ravel())[:, None]


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


@pytest.mark.parametrize(("parts", "sag"), [(3, 1.2e-3), (6, 3.6e-4)])
def test_gap_is_the_distance_between_faces(sphere: Snapshot, parts: int, sag: float) -> None:
    """Mid-surfaces apart less half the thickness of each, less what flat triangles sag; cut off."""
    gap = 0.01
    state = dimple(sphere, gap)
    surface = surface_of(sphere, parts)
    vertices = surface.vertices(faces_of(state))
    found = Barrier(surface, 0.02, 1.0).gap(vertices)
    assert gap - sag < found < gap
    assert Barrier(surface, 0.9 * found, 1.0).gap(vertices) == np.inf
    assert Barrier(surface, 0.9 * found, 1.0).energy(vertices) == 0.0
    thinner = surface.vertices(faces_of(state, 0.8 * H))
    assert Barrier(surface, 0.04, 1.0).gap(thinner) == pytest.approx(found + 0.2 * H, abs=sag)


def test_forces_push_apart_and_balance(sphere: Snapshot) -> None:
    """The apex is pushed up and the bottom down: descent of the energy; force and moment vanish."""
    state = dimple(sphere, 0.01)
    surface = surface_of(sphere)
    gradient = Barrier(surface, 0.02, 1.0).gradient(surface.vertices(faces_of(state)))
    assert gradient is not None
    inner, outer = gradient
    assert np.all(outer == 0)
    apex, bottom = (int(np.argmax(side * sphere.reference[:, 2])) for side in (1, -1))
    assert inner[apex, 2] < 0 < inner[bottom, 2]
    largest = np.abs(inner).max()
    assert np.abs(inner.sum(axis=0)).max() < 1e-12 * largest
    moment = np.cross(faces_of(state)[0], inner).sum(axis=0)
    assert np.abs(moment).max() < 1e-12 * np.abs(inner).sum()


def test_gradient_and_hessian_are_derivatives(sphere: Snapshot) -> None:
    """Central differences of energy and gradient along a random motion of the faces."""
    state = dimple(sphere, 0.01)
    surface = surface_of(sphere, parts=4)
    barrier = Barrier(surface, 0.02, 0.7)
    faces = faces_of(state)
    direction = np.random.default_rng(1).normal(size=faces.shape)

    def moved(step: float) -> np.ndarray:
        return surface.vertices(faces + step * direction)

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
    convex = barrier.hessian(moved(0), convex=True)
    assert convex is not None
    touched = np.flatnonzero(np.diff(convex.indptr))
    true, positive = (
        np.linalg.eigvalsh(one.toarray()[np.ix_(touched, touched)]) for one in (hessian, convex)
    )
    assert true.min() < -1e-3 * true.max() and positive.min() > -1e-12 * positive.max()


def test_faces_lie_along_the_normal(sphere: Snapshot) -> None:
    """On a sphere of radius 1.3 those of heights -.1 and .2 are spheres of radius 1.2 and 1.5."""
    heights = np.tile([-0.1, 0.2], (*sphere.cells.shape, 1))
    places = shell_faces(sphere).places(1.3 * sphere.reference, heights)
    for face, radius in zip(places, (1.2, 1.5), strict=True):
        np.testing.assert_allclose(face, radius * sphere.reference[sphere.cells.ravel()], atol=3e-3)


def test_variations_of_the_faces_are_derivatives(sphere: Snapshot) -> None:
    """Central differences of the faces and of forces on them; stiffness works as on the faces."""
    rng = np.random.default_rng(5)
    state, faces = dimple(sphere, 0.01), shell_faces(sphere)
    r, n = state.position, sphere.cells.size
    heights = heights_of(sphere) * rng.uniform(0.5, 1.5, (*sphere.cells.shape, 1))
    direction = rng.normal(size=r.shape)
    top = sphere.reference[sphere.cells][:, :, 2].min(axis=1) > 0.7
    some, moved = np.flatnonzero(top), np.flatnonzero(np.repeat(top, 10))
    step, variations = 1e-6, faces.at(r, heights, some)
    ahead, behind = (faces.places(r + s * step * direction, heights) for s in (1, -1))
    slope = (ahead - behind) / (2 * step)
    for _ in range(3):
        forces = np.zeros((2, n, 3))
        forces[:, moved] = rng.normal(size=(2, len(moved), 3))
        work = np.sum(variations.pulled_back_forces(forces) * direction)
        assert work == pytest.approx(np.sum(forces * slope), rel=1e-7)

    second = matrix_of(variations.second(forces), sphere.cells)
    assert abs(second - second.T).max() < 1e-12 * abs(second).max()
    levers = [
        faces.at(r + s * step * direction, heights, some).pulled_back_forces(forces).ravel()
        for s in (1, -1)
    ]
    bend = (levers[0] - levers[1]) / (2 * step)
    assert np.abs(second @ direction.ravel() - bend).max() < 1e-6 * np.abs(bend).max()

    # stiffness of cells with themselves, with others, and between the faces of one cell
    m = len(sphere.cells)
    first = np.array([some[0], m + some[1], some[2], some[3], some[4]])
    other = np.array([some[0], m + some[1], some[5], m + some[6], m + some[4]])
    values = rng.normal(size=(5, 30, 30))
    values[:2] += np.swapaxes(values[:2], 1, 2)
    stiffness = Blocks(first, other, values)
    pulled = matrix_of(variations.pulled_back(stiffness), sphere.cells)
    whole = matrix_of(stiffness, np.arange(2 * n).reshape(-1, 10))
    assert abs(pulled - pulled.T).max() < 1e-12 * abs(pulled).max()
    bent = direction.ravel() @ pulled @ direction.ravel()
    assert bent == pytest.approx(slope.ravel() @ whole @ slope.ravel(), rel=1e-5)


def test_faces_meet_in_the_middle_of_their_cells(sphere: Snapshot) -> None:
    """Faces of single cells, joined to a mesh: vertices are means, forces are shared evenly."""
    nodes = sphere.cells.ravel()
    sites = np.arange(nodes.size).reshape(sphere.cells.shape)
    surface = ContactSurface(sphere.reference[nodes], sites, sphere.orientation, 0.1, nodes=nodes)
    assert surface.closed
    faces = shell_faces(sphere)
    places = faces.places(sphere.reference, heights_of(sphere))
    expected = surface_of(sphere).vertices(faces_of(sphere))
    np.testing.assert_allclose(surface.vertices(places), expected, atol=1e-14)
    force = np.random.default_rng(7).normal(size=(2 * len(sphere.reference), 3))
    shared = surface.pull_back(force)
    np.testing.assert_allclose(np.concatenate(faces.at_nodes(shared)), force, atol=1e-14)


def test_stiffness_and_distance_enter(sphere: Snapshot) -> None:
    """Energy and forces are proportional to the stiffness; a longer barrier pushes more."""
    state = dimple(sphere, 0.01)
    surface = surface_of(sphere)
    vertices = surface.vertices(faces_of(state))
    one = Barrier(surface, 0.02, 1.0).energy(vertices)
    assert Barrier(surface, 0.02, 3.0).energy(vertices) == pytest.approx(3 * one)
    assert Barrier(surface, 0.04, 1.0).energy(vertices) > 2 * one


def test_vertices_are_linear_in_the_faces(sphere: Snapshot) -> None:
    """With three parts the vertices are nodes; finer ones interpolate them."""
    faces = np.random.default_rng(2).normal(size=(2, *sphere.reference.shape))
    coarse, fine = surface_of(sphere), surface_of(sphere, parts=6)
    vertices = coarse.vertices(faces)
    np.testing.assert_allclose(vertices, np.concatenate(faces))
    halves = 0.5 * fine.vertices(2 * faces)
    np.testing.assert_allclose(fine.vertices(faces), halves, atol=1e-12)
    # both cut the same surface: every vertex of the coarse one is one of the fine one
    places = {tuple(np.round(v, 9)) for v in fine.vertices(faces)}
    assert all(tuple(np.round(v, 9)) in places for v in vertices)


def test_force_is_pulled_back_by_virtual_work(sphere: Snapshot) -> None:
    """Force times velocity is the same at the vertices and at the nodes."""
    rng = np.random.default_rng(3)
    surface = surface_of(sphere, parts=5, obstacles=(Plate((0, 0, -3), (0, 0, 1), 2.0),))
    velocity = rng.normal(size=(2, *sphere.reference.shape))
    at_vertices = surface.vertices(velocity) - surface.vertices(0 * velocity)
    force = rng.normal(size=at_vertices.shape)
    expected = np.sum(force * at_vertices)
    assert np.sum(surface.pull_back(force) * velocity) == pytest.approx(expected, rel=1e-12)


def test_energy_is_an_integral_over_the_surface(sphere: Snapshot) -> None:
    """Pressed surfaces: k d_hat b(gap/d_hat) times the area, and somewhat more; never less."""
    distance, gap, stiffness = 0.02, 0.01, 3.0
    state = dimple(sphere, gap)
    x = (gap / distance) ** 2
    density = -stiffness * distance * (x - 1) ** 2 * np.log(x)
    area = 2 * np.pi * (1 - np.cos(FLAT))
    for parts in (3, 4):
        surface = surface_of(sphere, parts)
        vertices = surface.vertices(faces_of(state))
        energy = Barrier(surface, distance, stiffness).energy(vertices)
        assert area * density < energy < 2 * area * density


def test_neighbours_along_the_shell_do_not_touch(sphere: Snapshot) -> None:
    """A barrier wider than the triangles sees neighbours only where they are not exempt."""
    faces = faces_of(sphere)
    none, near = surface_of(sphere, exempt=-1.0), surface_of(sphere)
    wide = 0.07
    assert Barrier(none, wide, 1.0).gap(none.vertices(faces)) < wide
    assert Barrier(near, wide, 1.0).gap(near.vertices(faces)) == np.inf
    # parts far apart in the reference surface touch as before
    state = dimple(sphere, 0.01)
    vertices = near.vertices(faces_of(state))
    assert Barrier(near, 0.02, 1.0).gap(vertices) < 0.01


def test_steps_end_before_a_collision(sphere: Snapshot) -> None:
    """The apex pushed 5 gaps down may go one; back up there is no bound."""
    gap = 0.05
    surface = surface_of(sphere)
    barrier = Barrier(surface, 0.02, 1.0)
    start = dimple(sphere, gap)
    before = surface.vertices(faces_of(start))
    through = surface.vertices(faces_of(dimple(sphere, -4 * gap)))
    free = barrier.free_fraction(before, through)
    assert 0.7 * 0.2 < free < 0.2
    assert not barrier.crosses(before) and barrier.crosses(through)
    stopped = np.asfortranarray(before + free * (through - before))
    assert not barrier.crosses(stopped)
    assert barrier.free_fraction(before, surface.vertices(faces_of(sphere))) == 1.0


def test_room_that_was_found_is_not_trusted_too_far(sphere: Snapshot) -> None:
    """A barrier that has seen wide states finds the contact of a later one, and forgets it."""
    surface = surface_of(sphere)
    used = Barrier(surface, 0.012, 1.0)
    for gap in (0.3, 0.04, 0.01, 0.014, 0.3, 0.008):
        state = dimple(sphere, gap)
        vertices = surface.vertices(faces_of(state))
        assert used.gap(vertices) == Barrier(surface, 0.012, 1.0).gap(vertices)
        fresh = Barrier(surface, 0.012, 1.0).energy(vertices)
        assert used.energy(vertices) == pytest.approx(fresh, rel=1e-13)
    used.forget()
    assert used.energy(vertices) == fresh


def test_parts_stay_apart_until_they_do_not(sphere: Snapshot) -> None:
    """On ways long and short the barrier's distance is what must be kept, list or no list."""
    surface = surface_of(sphere)
    barrier = Barrier(surface, 0.012, 1.0)
    gaps = (0.3, 0.2, 0.12, 0.07, 0.045, 0.042, 0.039, 0.036, 0.028, 0.021, 0.016)
    places = [surface.vertices(faces_of(dimple(sphere, gap))) for gap in gaps]
    for before, after in itertools.pairwise(places):
        assert barrier.free_fraction(before, after, 0.012) == 1.0
        assert barrier.free_fraction(after, before, 0.012) == 1.0
    near = surface.vertices(faces_of(dimple(sphere, 0.0115)))
    for before in places:
        assert barrier.free_fraction(before, near, 0.012) < 1.0
    # a way that ends where it began, as far as gaps go, may still lead through
    through = surface.vertices(faces_of(dimple(sphere, -0.3)))
    assert barrier.free_fraction(places[0], through, 0.012) < 1.0


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
    vertices = surface.vertices(faces_of(sphere))
    assert barrier.gap(vertices) == pytest.approx(gap, rel=1e-5)
    gradient = barrier.gradient(vertices)
    assert gradient is not None
    inner, outer = gradient
    assert np.all(inner == 0)
    assert outer[:, 2].sum() < -0.9 * np.abs(outer).sum() < 0
    assert barrier.gradient(surface.vertices(faces_of(sphere) + np.array([0.0, 0.0, 0.02]))) is None


@pytest.mark.parametrize(
    ("distance", "exempt"), [(0.05, 0.3), (0.1, 0.3), (0.15, 0.35), (0.2, 0.4)]
)
def test_wide_barriers_exempt_more_of_a_bend(distance: float, exempt: float) -> None:
    """1.5 h up to a gap of h/2, and h and the gap beyond, h = .2."""
    assert exempt_distance(0.2, distance) == pytest.approx(exempt)
