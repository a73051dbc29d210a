"""A shell's contact with itself: points of its faces that repel each other.

What matters: the laws and their derivatives; two flat faces have the energy of their gap; force and
stiffness are derivatives of the energy, push apart and balance; faces that slide on each other feel
nothing of the points; neighbours along the shell never touch.
"""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad

from opticcup_fem.contact import repulsion as repulsion_module
from opticcup_fem.contact.barrier import Barrier
from opticcup_fem.contact.law import barrier, repulsion
from opticcup_fem.contact.patches import Patches
from opticcup_fem.contact.repulsion import RAMP, Repulsion
from opticcup_fem.snapshot import Floats, Integers, Snapshot
from tests.support.blocks import matrix_of
from tests.support.shapes import deformed, revolved, sphere_mesh
from tests.unit.test_contact import FLAT, ROUND, H, dimple, faces_of, surface_of

D_HAT, GAP, EXEMPT = 0.12, 0.06, 0.27
STIFFNESS = 0.7


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    return sphere_mesh(0.25)


def repulsion_of(mesh: Snapshot, distance: float = D_HAT) -> Repulsion:
    surface = surface_of(mesh, exempt=EXEMPT)
    patches = Patches(mesh.reference, surface, 0.35 * distance, 1.2 * distance)
    return Repulsion(mesh.reference, mesh.cells, surface, patches, H, distance, STIFFNESS)


@pytest.mark.parametrize("law", [barrier, repulsion])
def test_derivatives_of_the_laws(law: Callable[[Floats], tuple[Floats, Floats, Floats]]) -> None:
    """By central differences; they push apart, and are nought from 1 on."""
    x, step = np.linspace(0.05, 0.99, 40), 1e-6
    _, slope, bend = law(x)
    up, down = law(x + step), law(x - step)
    np.testing.assert_allclose(slope, (up[0] - down[0]) / (2 * step), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(bend, (up[1] - down[1]) / (2 * step), rtol=1e-6, atol=1e-9)
    assert (bend > 0).all() and (slope < 0).all()
    assert [list(one) for one in law(np.array([1.0, 1.5]))] == [[0, 0]] * 3


def test_laws() -> None:
    """The barrier is unbounded, and known at a half; psi is -b'(x)/x."""
    assert barrier(np.array([1e-9]))[0][0] > 40
    assert barrier(np.array([0.5]))[0][0] == pytest.approx(0.5625 * np.log(4))
    x = np.linspace(0.1, 0.99, 9)
    np.testing.assert_allclose(repulsion(x**2)[0], -barrier(x)[1] / x)


@pytest.mark.parametrize("gap", [0.1, 0.5, 0.9])
def test_a_plane_of_points_repels_by_the_barrier(gap: float) -> None:
    """The integral of psi/(2 pi) over a plane at a distance is b of the distance."""
    total, _ = quad(lambda r: float(repulsion(np.array([gap**2 + r**2]))[0][0]) * r, 0, 1)
    assert total == pytest.approx(float(barrier(np.array([gap]))[0][0]), rel=1e-6)


def pressed_flat(mesh: Snapshot, gap: float) -> Floats:
    """The sphere pressed flat without change of area: its halves lie on each other, a gap apart."""
    x, y, z = mesh.reference.T
    stretch = np.sqrt(2 / (1 + np.abs(z)))
    return np.column_stack([stretch * x, stretch * y, gap / 2 * np.sign(z)])


def expected_energy(gap: float) -> float:
    """The double integral over both halves: rings of one, and a lattice on the other around them.

    A flat point at the distance rho from the axis is the sphere's at |z| = 1 - rho^2/2.
    """
    z = ((np.arange(800) + 0.5) / 800)[:, None, None]
    u, v = np.meshgrid(*2 * [D_HAT * (np.arange(-40, 40) + 0.5) / 40])
    x = np.sqrt(2 * (1 - z)) + u
    square = x**2 + v**2
    shrink = np.sqrt(np.maximum(1 - square / 4, 0))
    apart = np.stack([np.sqrt(1 - z**2) - shrink * x, shrink * v, z + 1 - square / 2])
    ramp = np.clip((np.linalg.norm(apart, axis=0) - EXEMPT) / (RAMP * H), 0, 1)
    far = np.sqrt(gap**2 + u**2 + v**2) / D_HAT
    psi = -barrier(np.minimum(far, 1))[1] / far
    inner = np.where(square < 2, ramp**2 * (3 - 2 * ramp) * psi, 0).sum(axis=(1, 2))
    return float(STIFFNESS / D_HAT * inner.mean() * (D_HAT / 40) ** 2)


@pytest.mark.parametrize("distance", [0.3 * D_HAT, D_HAT])
def test_no_patches_that_touch_are_left_out(
    sphere: Snapshot, monkeypatch: pytest.MonkeyPatch, distance: float
) -> None:
    """In a dimple, against the points of all patches whose balls are near; most have none."""
    faces = faces_of(dimple(sphere, 0.5 * distance))
    counts, energies = [], []
    for keeps_all in (False, True):
        if keeps_all:
            monkeypatch.setattr(repulsion_module, "near_curved", lambda pairs, *_: pairs)
        points = []
        whole = Repulsion._points
        potential = repulsion_of(sphere, distance)

        def counted(self: Repulsion, pairs: Integers) -> object:
            points.append(len(pairs))
            return whole(self, pairs)

        with monkeypatch.context() as patch:
            patch.setattr(Repulsion, "_points", counted)
            energies.append(potential.energy(faces))
        counts.append(sum(points))
    assert energies[0] == pytest.approx(energies[1], rel=1e-12) and energies[0] > 0
    assert 0 < counts[0] < 0.7 * counts[1]


@pytest.mark.parametrize("gap", [0.3 * D_HAT, 0.6 * D_HAT])
def test_energy_of_flat_faces(sphere: Snapshot, gap: float) -> None:
    """Parts of one face touch; the other face is far."""
    flat = pressed_flat(sphere, gap)
    expected = expected_energy(gap)
    for side in (0, 1):
        faces = np.stack([flat, flat])
        faces[1 - side] = sphere.reference + 5.0
        potential = repulsion_of(sphere)
        assert potential.energy(faces) == pytest.approx(expected, rel=0.01)
        assert gap <= potential.gap(faces) * (1 + 1e-12) < 1.2 * gap + 0.05 * D_HAT
    apart = np.stack([pressed_flat(sphere, 1.01 * D_HAT)] * 2)
    assert potential.energy(apart) == 0 and potential.gap(apart) == np.inf
    assert potential.gradient(apart) is None and potential.hessian(apart) is None


def test_narrow_gaps_have_finer_points(sphere: Snapshot) -> None:
    """Points that are told of a narrow gap give its energy; those that are not feel each other."""
    gap = 0.12 * D_HAT
    faces = np.stack([pressed_flat(sphere, gap), sphere.reference + 5.0])
    potential, expected = repulsion_of(sphere), expected_energy(gap)
    errors = []
    for known in (gap, np.inf):
        potential.forget(known)
        errors.append(abs(potential.energy(faces) / expected - 1))
    assert errors[0] < 0.02 and errors[1] > 2 * errors[0]


def test_gradient_and_hessian_are_derivatives(sphere: Snapshot) -> None:
    """Central differences along a random motion; the convex part has no negative eigenvalue."""
    potential, faces = repulsion_of(sphere), faces_of(dimple(sphere, GAP))
    direction = np.random.default_rng(1).normal(size=faces.shape)
    gradient = potential.gradient(faces)
    parts = potential.hessian(faces), potential.hessian(faces, convex=True)
    assert gradient is not None and parts[0] is not None and parts[1] is not None
    of_both = np.concatenate([sphere.cells, sphere.cells + len(sphere.reference)])
    hessian, convex = (matrix_of(part, of_both) for part in parts)
    assert abs(hessian - hessian.T).max() < 1e-12 * abs(hessian).max()
    step = 1e-7
    up, down = faces + step * direction, faces - step * direction
    slope = (potential.energy(up) - potential.energy(down)) / (2 * step)
    assert slope == pytest.approx(np.sum(gradient * direction), rel=1e-6)
    after, before = potential.gradient(up), potential.gradient(down)
    assert after is not None and before is not None
    bend, expected = (after - before).ravel() / (2 * step), hessian @ direction.ravel()
    assert np.abs(bend - expected).max() < 1e-3 * np.abs(expected).max()
    touched = np.flatnonzero(np.diff(convex.indptr))
    true, positive = (
        np.linalg.eigvalsh(one.toarray()[np.ix_(touched, touched)]) for one in (hessian, convex)
    )
    assert true.min() < -1e-3 * true.max() and positive.min() > -1e-12 * positive.max()
    # where faces approach each other the two are much the same
    assert positive.max() == pytest.approx(true.max(), rel=0.1)


def test_forces_push_apart_and_balance(sphere: Snapshot) -> None:
    """The apex is pushed up and the bottom down: descent of the energy; force and moment vanish."""
    faces = faces_of(dimple(sphere, GAP))
    gradient = repulsion_of(sphere).gradient(faces)
    assert gradient is not None
    inner, outer = gradient
    assert np.all(outer == 0)
    apex, bottom = (int(np.argmax(side * sphere.reference[:, 2])) for side in (1, -1))
    assert inner[apex, 2] < 0 < inner[bottom, 2]
    assert np.abs(inner.sum(axis=0)).max() < 1e-12 * np.abs(inner).sum()
    assert np.abs(np.cross(faces[0], inner).sum(axis=0)).max() < 1e-12 * np.abs(inner).sum()


def test_sliding_faces_feel_no_points(sphere: Snapshot) -> None:
    """Turned about the axis on the bottom, the top keeps its energy; on flat triangles it rolls."""

    def turned(angle: float) -> Floats:
        def shape(theta: Floats, phi: Floats) -> Floats:
            x = np.clip((theta - FLAT) / (ROUND - FLAT), 0, 1)
            blend = x**3 * (10 - 15 * x + 6 * x**2)
            radius = (1 - H - GAP) * (1 - blend) + blend
            height = blend - (1 - H - GAP) * (1 - blend)
            turn = angle * (1 - blend)
            return revolved(radius * np.sin(theta), height * np.cos(theta), phi + turn)

        return faces_of(deformed(sphere, shape))

    angles, surface = np.linspace(0, 0.2, 3), surface_of(sphere)
    smooth, rough = repulsion_of(sphere), Barrier(surface, D_HAT, STIFFNESS)
    ripples = []
    for energy in (smooth.energy, lambda faces: rough.energy(surface.vertices(faces))):
        energies = np.array([energy(turned(angle)) for angle in angles])
        ripples.append(float(np.ptp(energies) / energies.mean()))
    assert ripples[0] < 0.002
    assert ripples[0] < 0.6 * ripples[1]


def test_neighbours_along_the_shell_do_not_touch(sphere: Snapshot) -> None:
    """Nor does a barrier wider than the shell is thick see them."""
    faces = faces_of(sphere)
    assert repulsion_of(sphere, distance=1.4 * H).gap(faces) == np.inf


def test_points_are_looked_for_where_the_faces_are(sphere: Snapshot) -> None:
    """What has seen other states finds the contact of a later one, and forgets the others."""
    used = repulsion_of(sphere)
    used.energy(faces_of(dimple(sphere, GAP)))
    for gap in (0.1, 0.3, 0.06):
        faces, fresh = faces_of(dimple(sphere, gap)), repulsion_of(sphere)
        assert used.energy(faces) == pytest.approx(fresh.energy(faces), rel=0.01)
    used.forget()
    assert used.energy(faces) == fresh.energy(faces)
