"""Which parts of a shell's faces may touch.

What matters: no parts that come near each other are missed, at a place or on a way between two;
neighbours along the shell are left out; a quick look says that nothing is near only where that is
so, whatever was seen before.
"""

import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree

from opticcup_fem.contact.patches import Patches, balls_near, nearest
from opticcup_fem.contact.repulsion import Repulsion
from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.snapshot import Floats, Integers, Snapshot
from tests.support.shapes import sphere_mesh
from tests.unit.test_contact import H, dimple, faces_of, surface_of

REACH = 0.05


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    return sphere_mesh(0.25)


def patches_of(mesh: Snapshot, exempt: float = 0.1) -> tuple[Patches, ContactSurface]:
    surface = surface_of(mesh, exempt=exempt)
    return Patches(mesh.reference, surface), surface


def vertices_of(surface: ContactSurface, state: Snapshot) -> Floats:
    return surface.vertices(faces_of(state))


def corners_near(patches: Patches, vertices: Floats, rest: Floats) -> Integers:
    """Pairs of patches of one face with corners nearer than the reach, from all pairs of these."""
    count, found = len(patches.triangles), []
    for side, face in enumerate(np.split(vertices, 2)):
        pairs = cKDTree(face).query_pairs(REACH, output_type="ndarray")
        pairs = pairs[np.linalg.norm(rest[pairs[:, 0]] - rest[pairs[:, 1]], axis=1) > 0.5]
        for one, other in pairs:
            at = [
                np.flatnonzero((patches.triangles == vertex).any(axis=1)) for vertex in (one, other)
            ]
            found.append(np.stack(np.meshgrid(*at), axis=2).reshape(-1, 2) + side * count)
    return np.unique(np.sort(np.concatenate(found), axis=1), axis=0)


def test_all_that_are_near_are_found(sphere: Snapshot) -> None:
    """Against all pairs of corners that are far apart in the reference position."""
    patches, surface = patches_of(sphere)
    vertices = vertices_of(surface, dimple(sphere, 0.03))
    found = np.unique(np.sort(patches.near(vertices, reach=REACH), axis=1), axis=0)
    expected = corners_near(patches, vertices, surface.map @ sphere.reference)
    assert len(expected) > 1000
    together, counts = np.unique(np.concatenate([found, expected]), axis=0, return_counts=True)
    assert len(together) == len(found) and (counts == 2).sum() == len(expected)


def test_neighbours_look_the_same_way(sphere: Snapshot) -> None:
    """No two patches of a sphere may touch, whether neighbours are exempt or not."""
    for exempt in (0.1, -1.0):
        patches, surface = patches_of(sphere, exempt)
        vertices = vertices_of(surface, sphere)
        assert len(patches.near(vertices, reach=REACH)) == 0
        # turned inside out it is a sphere still
        assert len(patches.near(-vertices, reach=REACH)) == 0


def test_what_is_near_on_the_way_only(sphere: Snapshot) -> None:
    """The apex pushed through the bottom is far from it before and behind."""
    patches, surface = patches_of(sphere)
    before, behind = (vertices_of(surface, dimple(sphere, gap)) for gap in (0.4, -0.4))
    top, bottom = (np.argmax(side * surface.map @ sphere.reference[:, 2]) for side in (1, -1))

    def meets(pairs: Integers) -> bool:
        at = [np.flatnonzero((patches.triangles == vertex).any(axis=1)) for vertex in (top, bottom)]
        return bool((np.isin(pairs, at[0]).any(axis=1) & np.isin(pairs, at[1]).any(axis=1)).any())

    assert not meets(patches.near(before, reach=REACH))
    assert not meets(patches.near(behind, reach=REACH))
    assert meets(patches.near(before, behind, reach=REACH))


def test_nearest_on_straight_ways() -> None:
    """Points that pass each other at right angles, that stay apart, and that part."""
    start = np.array([[0.0, 0, 0], [1, -1, 0], [5, 0, 0], [5, 3, 0]])
    end = np.array([[2.0, 0, 0], [1, 1, 0], [6, 0, 0], [6, 4, 0]])
    pairs = np.array([[0, 1], [2, 3]])
    np.testing.assert_allclose(nearest(np.stack([start, end]), pairs), [0, 3], atol=1e-12)
    np.testing.assert_allclose(nearest(start[None], pairs), [np.sqrt(2), 3])


def test_balls_of_any_size_are_found() -> None:
    """Against all pairs, in groups."""
    rng = np.random.default_rng(6)
    x, radius, group = rng.random((300, 3)), 0.1 * rng.random(300) ** 3, rng.integers(0, 2, 300)
    found = {tuple(sorted(pair)) for pair in balls_near(x, radius, 0.03, group).tolist()}
    i, j = np.triu_indices(300, 1)
    near = np.linalg.norm(x[i] - x[j], axis=1) < radius[i] + radius[j] + 0.03
    expected = set(zip(*(one[near & (group[i] == group[j])].tolist() for one in (i, j))))
    assert expected <= found
    assert all(group[one] == group[other] for one, other in found)


def test_quick_look(sphere: Snapshot) -> None:
    """Clear where nothing comes near; not on the way through; small steps are no less safe."""
    surface = surface_of(sphere, exempt=0.27)

    def fresh() -> Repulsion:
        return Repulsion(sphere.reference, sphere.cells, surface, H, 0.01, 1.0)

    used = fresh()
    gaps = [0.8, 0.6, 0.599, 0.598, 0.5, 0.3, 0.299, 0.2, 0.1999, 0.1, 0.0999, 0.06, 0.005, 0.2]
    states = [faces_of(dimple(sphere, gap)) for gap in gaps]
    clear = [used.is_clear(*way) for way in itertools.pairwise(states)]
    assert clear == [fresh().is_clear(*way) for way in itertools.pairwise(states)]
    assert clear == [True] * 10 + [False] * 3
    assert not fresh().is_clear(faces_of(dimple(sphere, 0.4)), faces_of(dimple(sphere, -0.4)))
