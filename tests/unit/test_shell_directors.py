"""Directors and numbering of edges: what the two cells of an edge must agree on."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from opticcup_fem.compat import cell_corners
from tests.support.shells import cup_shell, disturbed, strip_shell, wall


@pytest.fixture(scope="module", params=["cup", "strip"])
def shell(request):
    return cup_shell() if request.param == "cup" else strip_shell(wall(), 0.6, 4, 3)


def test_neighbours_see_an_edge_from_opposite_sides(shell):
    spaces = shell.spaces
    total = np.zeros(spaces.n_edges)
    np.add.at(total, spaces.edges, spaces.edge_sign)
    count = np.bincount(spaces.edges.ravel(), minlength=spaces.n_edges)
    assert set(count) <= {1, 2}
    assert np.all(total[count == 2] == 0)
    assert np.all(np.abs(total[count == 1]) == 1)


def test_neighbours_agree_on_gauss_points(shell):
    """The same point of space under the same number, from whichever cell."""
    spaces = shell.spaces
    table = spaces.position_table(spaces.edge_reference_points().reshape(-1, 2))
    seen = np.einsum("qn,cni->cqi", table, shell.reference[spaces.nodes])
    seen = seen.reshape(spaces.n_cells, 3, spaces.degree, 3)
    places = np.full((spaces.n_edges * spaces.degree, 3), np.nan)
    slots = shell.directors.per_cell(
        np.arange(spaces.n_edges * spaces.degree).reshape(spaces.n_edges, -1)
    )
    places[slots] = seen
    np.testing.assert_allclose(places[slots], seen, atol=1e-14)


def test_tangents_run_from_low_to_high_vertex(shell):
    spaces = shell.spaces
    topology = spaces.mesh.topology
    ends = topology.connectivity(1, 0).array.reshape(-1, 2)
    geometry = spaces.mesh.geometry
    vertex_node = np.zeros(topology.index_map(0).size_local, dtype=int)
    vertex_node[topology.connectivity(2, 0).array] = cell_corners(shell.spaces.mesh).ravel()
    run = np.diff(geometry.x[vertex_node[np.sort(ends, axis=1)]], axis=1)
    tangents = shell.directors.tangents(shell.reference)
    assert np.all(np.sum(run * tangents, axis=-1) > 0)
    np.testing.assert_allclose(np.linalg.norm(tangents, axis=-1), 1.0, rtol=1e-14)


def test_mean_normals_are_unit_normal_to_the_edge_and_outside(shell):
    r = disturbed(shell, 3e-4).r
    normals = shell.directors.mean_normals(r)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, rtol=1e-14)
    np.testing.assert_allclose(
        np.sum(normals * shell.directors.tangents(r), axis=-1), 0.0, atol=1e-14
    )
    flat = shell.surface_mesh.surface.curvature == 0
    outside = np.array([0.0, 0.0, 1.0]) if flat else _places(shell)
    assert np.all(np.sum(normals * outside, axis=-1) > 0.9)


def _places(shell):
    spaces = shell.spaces
    table = spaces.position_table(spaces.edge_reference_points().reshape(-1, 2))
    seen = np.einsum("qn,cni->cqi", table, shell.reference[spaces.nodes])
    places = np.zeros((spaces.n_edges, 3))
    np.add.at(places, spaces.edges, seen.reshape(spaces.n_cells, 3, 3, 3).mean(axis=2))
    return (places / np.linalg.norm(places, axis=1, keepdims=True))[:, None, :]


def test_alpha_turns_the_director_about_the_tangent(shell):
    """A state turned about the tangents by -alpha has the directors' angles in its normals."""
    rng = np.random.default_rng(4)
    state = shell.reference_state()
    angle = 0.2 * rng.normal(size=state.alpha.shape)
    tangents = shell.directors.tangents(state.r)
    turn = Rotation.from_rotvec((angle[..., None] * tangents).reshape(-1, 3))
    director = turn.apply(state.director.reshape(-1, 3)).reshape(state.director.shape)
    by_angle = shell.curvature_of(replace(state, alpha=angle))
    by_director = shell.curvature_of(replace(state, director=director))
    np.testing.assert_allclose(by_angle, by_director, atol=1e-11)
    assert np.abs(by_angle - shell.curvature_of(state)).max() > 0.1


@pytest.mark.parametrize("turns", [0.3, 3.0])
def test_re_expressed_angles_give_the_same_curvature(shell, turns):
    """Also where the sum of old angle and turn passes pi."""
    rng = np.random.default_rng(6)
    state = disturbed(shell, 3e-4)
    tangents = shell.directors.tangents(state.r)
    angle = turns * rng.uniform(-1, 1, size=state.alpha.shape)
    turn = Rotation.from_rotvec((angle[..., None] * tangents).reshape(-1, 3))
    # a director that alpha brings back, and that is not quite normal to the edge
    lagged = turn.apply(state.director.reshape(-1, 3)).reshape(state.director.shape)
    lagged = lagged + 0.1 * tangents
    alpha = shell.directors.re_expressed(state.r, state.alpha, state.director, lagged)
    assert np.abs(alpha).max() <= np.pi
    other = replace(state, alpha=alpha, director=lagged)
    np.testing.assert_allclose(
        shell.curvature_of(other), shell.curvature_of(state), rtol=1e-9, atol=1e-10
    )
