"""Which parts of a shell's faces may touch, and how far they may go.

What matters: no parts that come near each other are missed, at a place or on a way between two,
whatever was seen before; neighbours along the shell are left out; gaps and free ways are those of
the flat triangles, which the IPC Toolkit finds too.
"""

import itertools

import numpy as np
import pytest
from scipy.spatial import cKDTree

from opticcup_fem.contact.barrier import Barrier
from opticcup_fem.contact.patches import Patches
from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.snapshot import Floats, Integers, Snapshot
from tests.support.shapes import sphere_mesh
from tests.unit.test_contact import dimple, faces_of, surface_of

REACH = 0.05


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    return sphere_mesh(0.25)


def patches_of(mesh: Snapshot, exempt: float = 0.1) -> tuple[Patches, ContactSurface]:
    surface = surface_of(mesh, exempt=exempt)
    return Patches(mesh.reference, surface, 0.01, 0.0), surface


def vertices_of(surface: ContactSurface, state: Snapshot) -> Floats:
    return np.ascontiguousarray(surface.vertices(faces_of(state)))


def corners_near(patches: Patches, vertices: Floats, rest: Floats) -> Integers:
    """Pairs of patches of one face with corners nearer than the reach, from all pairs of these."""
    found = [np.empty((0, 2), dtype=np.int64)]
    for side, face in enumerate(np.split(vertices, 2)):
        pairs = cKDTree(face).query_pairs(REACH, output_type="ndarray")
        pairs = pairs[np.linalg.norm(rest[pairs[:, 0]] - rest[pairs[:, 1]], axis=1) > 0.5]
        for one, other in pairs:
            corners = (vertex + side * len(face) for vertex in (one, other))
            at = [np.flatnonzero((patches.triangles == corner).any(axis=1)) for corner in corners]
            found.append(np.stack(np.meshgrid(*at), axis=2).reshape(-1, 2))
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


def test_what_was_found_is_not_trusted_too_far(sphere: Snapshot) -> None:
    """Patches that have seen other states find at least what fresh ones do."""
    used, surface = patches_of(sphere)
    for gap in (0.3, 0.06, 0.055, 0.052, 0.03, 0.028, 0.2):
        vertices = vertices_of(surface, dimple(sphere, gap))
        fresh, _ = patches_of(sphere)
        found, expected = (
            {tuple(sorted(pair)) for pair in one.near(vertices, reach=REACH).tolist()}
            for one in (used, fresh)
        )
        near = {
            tuple(pair) for pair in corners_near(used, vertices, surface.map @ sphere.reference)
        }
        assert near <= found and near <= expected
    used.forget()
    assert np.array_equal(used.near(vertices, reach=REACH), fresh.near(vertices, reach=REACH))


@pytest.mark.parametrize("parts", [3, 4])
def test_gaps_are_those_of_the_triangles(sphere: Snapshot, parts: int) -> None:
    """Against the toolkit's, where no fold is near itself; no more than asked for."""
    surface = surface_of(sphere, parts, exempt=0.4)
    patches, most = Patches(sphere.reference, surface, 0.01, 0.0), 0.05
    for gap in (0.01, 0.02, 0.04, 0.2):
        vertices = surface.vertices(faces_of(dimple(sphere, gap)))
        expected = min(most, Barrier(surface, most, 1.0).gap(vertices))
        assert patches.gap(vertices, most) == pytest.approx(expected, rel=1e-9)


def test_free_ways_are_those_of_the_triangles(sphere: Snapshot) -> None:
    """Up, down and askew, near and far: nothing crosses up to the share, and soon behind it."""
    patches, surface = patches_of(sphere, exempt=0.4)
    barrier = Barrier(surface, 0.02, 1.0)
    gaps = (0.3, 0.15, 0.05, 0.045, 0.02, 0.018)
    places = [surface.vertices(faces_of(dimple(sphere, gap))) for gap in gaps]
    top = np.tile(sphere.reference[:, 2] > 0, 2)[:, None]
    slid, through = (
        surface.vertices(faces_of(dimple(sphere, 0.02))) + 0.1 * top,
        surface.vertices(faces_of(dimple(sphere, -0.2))),
    )
    shares = []
    for before, after in itertools.product(places, [*places, slid, through]):
        for apart in (0.0, 0.005):
            share = patches.free_fraction(before, after, apart)
            for part in np.linspace(0, share, 4):
                moved = np.asfortranarray(before + part * (after - before))
                assert not barrier.crosses(moved)
                assert patches.gap(moved, 0.02) >= apart * (1 - 1e-9)
            if share < 1:
                beyond = np.asfortranarray(before + 1.05 * share * (after - before))
                assert barrier.crosses(beyond) or patches.gap(beyond, 0.02) < apart + 1e-3
            shares.append(share)
    assert min(shares) < 0.1 and max(shares) == 1.0
