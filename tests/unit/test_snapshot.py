"""Cubic interpolation and subdivision of snapshots.

What matters: the basis reproduces every cubic and its derivatives, cells that share an edge share
its vertices in every subdivision, and triangles wind outwards whatever the cells' handedness.
"""

from dataclasses import replace

import numpy as np
import pytest

from opticcup_fem.snapshot import (
    EDGES,
    NODES,
    Snapshot,
    cell_tangents,
    cell_values,
    lagrange_basis,
    lagrange_gradient,
    lattice,
    subdivide,
)
from tests.support.shapes import sphere_mesh

RNG = np.random.default_rng(7)
POINTS = RNG.dirichlet([1, 1, 1], size=20)[:, 1:]


def cubic(p: np.ndarray) -> np.ndarray:
    """Return a complete cubic polynomial at points (k, 2)."""
    x, y = p.T
    return 1 + 2 * x - y + x * y - 3 * y**2 + x**3 - 2 * x**2 * y + 0.5 * x * y**2 + y**3


def cubic_gradient(p: np.ndarray) -> np.ndarray:
    """Return its derivatives, shape (k, 2)."""
    x, y = p.T
    dx = 2 + y + 3 * x**2 - 4 * x * y + 0.5 * y**2
    return np.column_stack([dx, -1 + x - 6 * y - 2 * x**2 + x * y + 3 * y**2])


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    """Return the unit sphere."""
    return sphere_mesh(0.3)


def test_basis_is_one_at_its_node_and_nought_at_the_others() -> None:
    """Phi_j(node_i) is the unit matrix."""
    np.testing.assert_allclose(lagrange_basis(NODES), np.eye(10), atol=1e-13)


def test_basis_reproduces_cubics_and_their_derivatives() -> None:
    """Interpolation of a cubic is exact, inside and outside the triangle."""
    points = np.vstack([POINTS, [[1.2, -0.3]]])
    np.testing.assert_allclose(lagrange_basis(points) @ cubic(NODES), cubic(points), atol=1e-12)
    gradient = np.einsum("kjd,j->kd", lagrange_gradient(points), cubic(NODES))
    np.testing.assert_allclose(gradient, cubic_gradient(points), atol=1e-12)


def test_edge_nodes_lie_between_their_vertices_in_basix_order() -> None:
    """The nodes of edge (a, b) are at a third and two thirds of the way from a to b."""
    for first, second, near, far in EDGES:
        np.testing.assert_allclose(NODES[near], (2 * NODES[first] + NODES[second]) / 3)
        np.testing.assert_allclose(NODES[far], (NODES[first] + 2 * NODES[second]) / 3)


def test_cell_values_and_tangents_of_a_field_on_cells(sphere: Snapshot) -> None:
    """A field that is cubic in each cell is interpolated with its derivatives."""
    cells = sphere.cells[:20]
    field = np.empty(len(sphere.reference))
    for cell, point in zip(cells, POINTS, strict=True):
        field[cell] = cubic(NODES)
        value = cell_values(field, cell[None], point[None])
        tangent = cell_tangents(field, cell[None], point[None])
        np.testing.assert_allclose(value, cubic(point[None]), atol=1e-12)
        np.testing.assert_allclose(tangent, cubic_gradient(point[None]), atol=1e-12)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 6])
def test_lattice_fills_the_triangle_once(n: int) -> None:
    """The n^2 triangles are counter-clockwise and equal."""
    points, triangles = lattice(n)
    a, b, c = (points[triangles[:, k]] / n for k in range(3))
    area = np.linalg.det(np.stack([b - a, c - a], axis=1)) / 2
    np.testing.assert_allclose(area, 0.5 / n**2)
    assert len(points) == (n + 1) * (n + 2) // 2


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
def test_subdivision_is_closed_and_winds_outwards(sphere: Snapshot, n: int) -> None:
    """Each directed edge occurs once and once reversed; the enclosed volume is positive."""
    cut = subdivide(sphere.cells, n, orientation=sphere.orientation)
    edges = np.concatenate([cut.triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    forward, backward = ({tuple(e) for e in x} for x in (edges, edges[:, ::-1]))
    assert len(forward) == len(edges)
    assert forward == backward
    corners = (cut.matrix @ sphere.reference)[cut.triangles]
    volume = np.linalg.det(corners).sum() / 6
    # flat triangles of size d lose a share of d^2
    assert volume == pytest.approx(4 * np.pi / 3, rel=0.07 / n**2)


def test_subdivision_by_three_has_the_nodes_as_vertices(sphere: Snapshot) -> None:
    """With n = 3 vertices are nodes, in their order."""
    cut = subdivide(sphere.cells)
    np.testing.assert_array_equal((cut.matrix @ sphere.reference), sphere.reference)
    assert cut.matrix.nnz == len(sphere.reference)
    # every small triangle lies in the cell that it says
    assert all(set(t) <= set(sphere.cells[c]) for t, c in zip(cut.triangles, cut.cell, strict=True))


def test_vertices_come_from_the_places_that_the_subdivision_names(sphere: Snapshot) -> None:
    """The map and (source_cell, source_point) agree, for a position field."""
    position = RNG.normal(size=sphere.position.shape)
    cut = subdivide(sphere.cells, 5)
    values = cell_values(position, sphere.cells[cut.source_cell], cut.source_point)
    np.testing.assert_allclose(cut.matrix @ position, values, atol=1e-12)


def test_vertices_on_shared_edges_agree_for_any_nodal_field(sphere: Snapshot) -> None:
    """Each triangle's vertices are the field at its own cell's lattice points."""
    position, n = RNG.normal(size=sphere.position.shape), 4
    points, triangles = lattice(n)
    cut = subdivide(sphere.cells, n)
    vertices = (cut.matrix @ position)[cut.triangles].reshape(len(sphere.cells), n * n, 3, 3)
    own = np.einsum("pj,cji->cpi", lagrange_basis(points / n), position[sphere.cells])
    np.testing.assert_allclose(vertices, own[:, triangles], atol=1e-12)


def test_cells_of_a_region_alone_can_be_cut(sphere: Snapshot) -> None:
    """A part of the mesh keeps the numbering of all nodes."""
    cap = sphere.cells[sphere.cells_of("cap")]
    cut = subdivide(cap, 2, n_nodes=len(sphere.reference))
    heights = (cut.matrix @ sphere.reference)[:, 2]
    assert heights.min() == pytest.approx(np.cos(np.deg2rad(40)), abs=1e-3)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"cells": np.zeros((4, 6), dtype=int)}, "ten nodes"),
        ({"position": np.zeros((3, 3))}, "same shape"),
        ({"faces": {"oov": np.zeros((2, 10, 2, 3))}}, "faces of oov"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(
    sphere: Snapshot, wrong: dict[str, object], said: str
) -> None:
    """A snapshot says which array has the wrong shape."""
    with pytest.raises(ValueError, match=said):
        replace(sphere, **wrong)
