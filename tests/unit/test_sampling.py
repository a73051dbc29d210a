"""Finding material points of the sphere on its mesh.

What matters: a point is found to the accuracy of the cubic cells, on the wanted side of the
interface, and a point outside the mesh is an error.
"""

from dataclasses import replace

import numpy as np
import pytest

from opticcup_fem.errors import MeshError
from opticcup_fem.sampling import (
    SphereSampler,
    azimuths,
    directions,
    interface_circle,
    interface_colatitude,
    interface_edges,
)
from opticcup_fem.snapshot import EDGES, Snapshot, cell_values
from tests.support.shapes import ALPHA, deformed, revolved, sphere_mesh, sphere_points

RNG = np.random.default_rng(3)


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    """Return the unit sphere."""
    return sphere_mesh(0.25)


@pytest.fixture(scope="module")
def sampler(sphere: Snapshot) -> SphereSampler:
    """Return its sampler."""
    return SphereSampler(sphere)


def random_directions(count: int) -> np.ndarray:
    """Return unit vectors, uniform on the sphere, poles included."""
    points = RNG.normal(size=(count, 3))
    points[:2] = [[0, 0, 1], [0, 0, -1]]
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def test_directions_of_colatitude_and_azimuth() -> None:
    """The z axis is theta = 0, the x axis phi = 0, the y axis phi = 90 deg."""
    found = directions([0, np.pi / 2, np.pi / 2, np.pi], [0.3, 0, np.pi / 2, 0])
    np.testing.assert_allclose(found, [[0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, -1]], atol=1e-15)


def test_located_points_lie_on_their_ray(sphere: Snapshot, sampler: SphereSampler) -> None:
    """The reference position at a located point has the direction that was asked for."""
    wanted = random_directions(600)
    located = sampler.locate(wanted)
    found = cell_values(sphere.reference, sphere.cells[located.cell], located.point)
    across = np.linalg.norm(np.cross(found, wanted), axis=1)
    assert across.max() < 1e-12
    assert np.abs(np.linalg.norm(found, axis=1) - 1).max() < 3e-4
    assert located.point.min() > -1e-2
    assert located.point.sum(axis=1).max() < 1 + 1e-2


def test_interpolation_converges_with_the_cells_fourth_power() -> None:
    """Halving the cells divides the error of a smooth field by 16."""
    wanted = random_directions(400)
    errors, sizes = [], []
    for size in (0.3, 0.15, 0.08):
        mesh = sphere_mesh(size)
        field = np.exp(mesh.reference[:, 0]) * np.sin(2 * mesh.reference[:, 2])
        sampler = SphereSampler(mesh)
        found = sampler.matrix(sampler.locate(wanted)) @ field
        exact = np.exp(wanted[:, 0]) * np.sin(2 * wanted[:, 2])
        errors.append(np.sqrt(np.mean((found - exact) ** 2)))
        sizes.append(len(mesh.cells) ** -0.5)
    slope = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    print(f"errors {errors} on cells of relative size {sizes}: order {slope:.3f}")
    assert slope > 3.9, errors


def test_points_of_the_interface_are_taken_on_the_wanted_side(sampler: SphereSampler) -> None:
    """The same circle is found in cells of the cap and in cells of the OOV."""
    circle = directions(ALPHA, azimuths(30))
    for region, number in (("cap", 1), ("oov", 2)):
        assert (sampler.region[sampler.locate(circle, region).cell] == number).all()


def test_points_outside_a_region_are_an_error(sampler: SphereSampler) -> None:
    """The bottom pole is not in the cap."""
    with pytest.raises(MeshError, match="region cap"):
        sampler.locate([[0, 0, 1], [0.1, 0, -1]], "cap")


def test_all_cells_at_a_vertex_are_found(sphere: Snapshot, sampler: SphereSampler) -> None:
    """At the apex these are the cells that have its node as a corner."""
    apex = int(np.argmax(sphere.reference[:, 2]))
    found = sampler.locate_all([0, 0, 1])
    assert set(found.cell) == set(np.flatnonzero((sphere.cells[:, :3] == apex).any(axis=1)))
    values = cell_values(sphere.reference, sphere.cells[found.cell], found.point)
    np.testing.assert_allclose(values, np.tile([0, 0, 1.0], (len(values), 1)), atol=1e-12)
    assert len(sampler.locate_all([0.31, 0.2, 0.4]).cell) == 1


def test_interface_edges_join_both_regions_on_the_circle(sphere: Snapshot) -> None:
    """Both cells name the same nodes, which lie at alpha, and the edges close."""
    edges = interface_edges(sphere)
    nodes = [sphere.cells[edges.cell[:, [k]], EDGES[edges.edge[:, k]]] for k in (0, 1)]
    assert (np.sort(nodes[0]) == np.sort(nodes[1])).all()
    assert (sphere.region[edges.cell] == [1, 2]).all()
    np.testing.assert_allclose(sphere.reference[nodes[0], 2], np.cos(ALPHA), atol=1e-12)
    ends, count = np.unique(nodes[0][:, :2], return_counts=True)
    assert len(ends) == len(edges.cell)
    assert (count == 2).all()
    assert interface_colatitude(sphere) == pytest.approx(ALPHA, abs=1e-12)


def test_interface_circle_is_ordered_by_azimuth(sphere: Snapshot) -> None:
    """On a widened and lifted cup the circle comes back at the azimuths asked for."""
    wide = deformed(sphere, lambda t, p: revolved(2 * np.sin(t), 3 + np.cos(t), p))
    phi, positions = interface_circle(wide, 40)
    np.testing.assert_allclose(phi, 2 * np.pi * np.arange(40) / 40)
    expected = sphere_points(np.full(40, ALPHA), phi) * [2, 2, 1] + [0, 0, 3]
    np.testing.assert_allclose(positions, expected, atol=2e-4)


def test_a_mesh_without_interface_has_no_circle(sphere: Snapshot) -> None:
    """One region alone has no interface."""
    oov = np.full_like(sphere.region, 2)
    alone = replace(sphere, region=oov, faces={}, thickness_stretch={}, stress={})
    with pytest.raises(MeshError, match="share no edge"):
        interface_colatitude(alone)
