"""Self-crossings of the middle surface.

What matters: a surface that passes through itself is found, with the right places, however finely
it is cut; one that only comes close to itself is not.
"""

import numpy as np
import pytest

from opticcup_fem.crossing import self_crossings, surface_check
from opticcup_fem.snapshot import Snapshot
from tests.support.shapes import cup, deformed, revolved, sphere_mesh, sphere_points


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    """Return the unit sphere."""
    return sphere_mesh(0.2)


def pinched(waist: float) -> object:
    """Return a shape whose y is scaled by 1 - waist exp(-(z/.4)^2): inside out for waist > 1."""

    def shape(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        points = sphere_points(theta, phi)
        points[:, 1] *= 1 - waist * np.exp(-((points[:, 2] / 0.4) ** 2))
        return points

    return shape


@pytest.mark.parametrize("n", [3, 5])
def test_surfaces_without_crossings(sphere: Snapshot, n: int) -> None:
    """The sphere, a deep cup and a narrow waist are free of crossings."""
    assert self_crossings(sphere, n) is None
    assert self_crossings(deformed(sphere, cup), n) is None
    assert self_crossings(deformed(sphere, pinched(0.93)), n) is None


@pytest.mark.parametrize("n", [3, 5])
def test_waist_turned_inside_out_crosses_where_its_scale_is_nought(
    sphere: Snapshot, n: int
) -> None:
    """With waist 1.3 both sides meet at y = 0, z = +-.4 sqrt(ln 1.3)."""
    found = self_crossings(deformed(sphere, pinched(1.3)), n)
    assert found is not None
    height = 0.4 * np.sqrt(np.log(1.3))
    np.testing.assert_allclose(np.abs(found.positions[:, 2]), height, atol=0.04)
    np.testing.assert_allclose(found.positions[:, 1], 0, atol=0.03)
    assert {-1, 1} == set(np.sign(found.positions[:, 2]))
    # both parts were at those heights on the sphere
    np.testing.assert_allclose(np.abs(np.cos(found.colatitudes)), height, atol=0.08)


def test_apex_pushed_through_the_bottom_names_both_colatitudes(sphere: Snapshot) -> None:
    """A dimple through the bottom pole crosses between the cap and the bottom."""

    def through(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        depth = 2.4 * np.exp(-((theta / 0.45) ** 2))
        return revolved(np.sin(theta), np.cos(theta) - depth, phi)

    found = self_crossings(deformed(sphere, through))
    assert found is not None
    theta = np.sort(np.rad2deg(found.colatitudes), axis=1)
    assert (theta[:, 0] < 40).all()
    assert (theta[:, 1] > 140).all()
    assert (found.positions[:, 2] < -0.8).all()
    fields = found.describe()
    assert fields["places"] == len(found.triangles) > 10
    assert len(fields["position"]) == 3
    assert sorted(fields["colatitudes_deg"])[0] < 40 < 140 < sorted(fields["colatitudes_deg"])[1]


def test_places_lie_on_their_edges_and_in_their_triangles(sphere: Snapshot) -> None:
    """Each position is on the named edge and in the plane of the named triangle."""
    state = deformed(sphere, pinched(1.3))
    check, cut = surface_check(sphere)
    vertices = cut.matrix @ state.position
    found = check(vertices)
    assert found is not None
    a, b = vertices[found.edges[:, 0]], vertices[found.edges[:, 1]]
    on_edge = np.linalg.norm(np.cross(found.positions - a, b - a), axis=1)
    corners = vertices[cut.triangles[found.triangles]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    off_plane = np.einsum("ki,ki->k", found.positions - corners[:, 0], normal)
    assert on_edge.max() < 1e-12
    assert np.abs(off_plane).max() < 1e-9
    # an edge of a triangle does not pierce it
    for edge, triangle in zip(found.edges, found.triangles, strict=True):
        assert not set(edge) & set(cut.triangles[triangle])


def test_one_check_serves_many_states(sphere: Snapshot) -> None:
    """The check remembers nothing of earlier states."""
    check, cut = surface_check(sphere)
    crossing = [
        check(cut.matrix @ deformed(sphere, pinched(waist)).position) is not None
        for waist in (0.9, 1.3, 0.9, 1.2)
    ]
    assert crossing == [False, True, False, True]
