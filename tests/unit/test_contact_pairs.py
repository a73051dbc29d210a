"""Loops over pairs of triangles and points, against what shares no code with them."""

import itertools

import ipctk
import numpy as np
import pytest
from scipy.spatial import cKDTree

from opticcup_fem.contact.pairs import (
    free_share,
    least_distance,
    near_points,
    stiffness,
    within,
)

CORNERS = np.arange(6).reshape(2, 3)
PAIR = np.array([[0, 1]])


def balls_of(x: np.ndarray) -> np.ndarray:
    """Balls around triangles with three vertices each."""
    corners = x.reshape(-1, 3, 3)
    centres = corners.mean(axis=1)
    radii = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    return np.column_stack([centres, radii])


def by_toolkit(x: np.ndarray) -> float:
    """Least distance of two triangles, from points to triangles and from edges to edges."""
    a, b = x[:3], x[3:]
    squares = [ipctk.point_triangle_distance(p, *t) for one, t in ((a, b), (b, a)) for p in one] + [
        ipctk.edge_edge_distance(a[i], a[i - 1], b[j], b[j - 1]) for i in range(3) for j in range(3)
    ]
    return float(np.sqrt(min(squares)))


def crosses(x: np.ndarray) -> bool:
    """Whether an edge of one of two triangles passes through the other."""
    return any(
        ipctk.is_edge_intersecting_triangle(one[k], one[k - 1], *other)
        for one, other in ((x[:3], x[3:]), (x[3:], x[:3]))
        for k in range(3)
    )


def test_distance_of_triangles() -> None:
    """Triangles in any position: beside, above, in one plane, parallel edges, large and tiny."""
    rng = np.random.default_rng(3)
    compared = 0
    for kind in range(600):
        x = rng.normal(size=(6, 3)) * np.repeat([1.0, 10.0 ** rng.uniform(-2, 1)], 3)[:, None]
        x[3:] += rng.normal(size=3) * 2
        if kind % 4 == 1:
            x[:, 2] = 0.0
        if kind % 4 == 2:
            x[3:] = x[:3] + rng.normal(size=3)
        if crosses(x) or (kind % 4 == 1 and by_toolkit(x) == 0):
            continue
        compared += 1
        found = least_distance(PAIR, CORNERS, balls_of(x), x, 50.0)
        assert found == pytest.approx(by_toolkit(x), abs=1e-9)
    assert compared > 400
    assert least_distance(PAIR, CORNERS, balls_of(x), x, 1e-3) == 1e-3
    assert least_distance(PAIR[:0], CORNERS, balls_of(x), x, 0.7) == 0.7


@pytest.mark.parametrize("apart", [0.0, 0.05])
def test_free_share_of_straight_ways(apart: float) -> None:
    """No crossing up to it, nor nearer; a bit farther there is, or it is the whole way."""
    rng = np.random.default_rng(8)
    stopped = 0
    for _ in range(400):
        start, end = (rng.normal(size=(6, 3)) for _ in range(2))
        start[3:, 2] += 3.0
        end[3:, 2] += rng.uniform(-4, 3)
        if crosses(start) or by_toolkit(start) < 2 * apart:
            continue
        share = free_share(PAIR, CORNERS, balls_of(start), start, end, apart)
        ways = np.linspace(0, share, 30)[:, None, None]
        for x in (1 - ways) * start + ways * end:
            assert not crosses(x) and by_toolkit(x) >= apart * (1 - 1e-9)
        if share < 1.0:
            stopped += 1
            x = (1 - share) * start + share * end
            speed = np.linalg.norm(end - start, axis=1).max()
            # what is left to go is not much more than a thousandth of the way
            assert by_toolkit(x) - apart < 0.05 * speed * max(share, 0.1)
    assert 50 < stopped < 350


def test_free_share_where_it_is_known() -> None:
    """A triangle that falls flat onto another, and past it; the least of all pairs counts."""
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    above = np.array([[0.1, 0.1, 0.8], [0.1, 0.1, 0.3]])
    start = np.concatenate([flat, *(flat + away for away in above)])
    triangles, falls = np.arange(9).reshape(3, 3), start - [0, 0, 1.0]
    falls[:3] = flat
    for other, height in ((1, 0.8), (2, 0.3)):
        pairs = np.array([[0, other]])
        assert free_share(pairs, triangles, balls_of(start), start, falls, 0.0) == pytest.approx(
            height, rel=2e-3
        )
        kept = free_share(pairs, triangles, balls_of(start), start, falls, 0.1)
        assert kept == pytest.approx(height - 0.1, rel=2e-3) and kept <= height - 0.1 + 1e-12
    both = np.array([[0, 1], [0, 2]])
    assert free_share(both, triangles, balls_of(start), start, falls, 0.0) == pytest.approx(
        0.3, rel=2e-3
    )
    beside = falls + np.repeat([[0.0], [5.0], [5.0]], 3, axis=0)
    # a triangle without an area has no plane
    start[3:6], falls[3:6] = start[3:6].mean(axis=0), falls[3:6].mean(axis=0)
    needle = free_share(both[:1], triangles, balls_of(start), start, falls, 0.0)
    assert needle == pytest.approx(0.8, rel=2e-3)
    assert free_share(both, triangles, balls_of(start), start, beside, 0.0) == 1.0
    # nearer than what is to be kept already
    assert free_share(both, triangles, balls_of(start), start, falls, 0.4) == 0.0


def test_points_that_are_near() -> None:
    """Against all pairs by trees; those within the reach now against all that are listed."""
    rng = np.random.default_rng(4)
    first = np.array([0, 40, 40, 100, 150])  # one patch has no points
    x, rest = rng.random((150, 3)), rng.random((150, 3))
    centres = np.stack(
        [x[a:b].mean(axis=0) if b > a else x[0] for a, b in itertools.pairwise(first)]
    )
    radii = [
        np.linalg.norm(x[a:b] - c, axis=1).max(initial=0)
        for (a, b), c in zip(itertools.pairwise(first), centres)
    ]
    balls, patches = np.column_stack([centres, radii]), np.array([[0, 2], [0, 1], [3, 0]])
    found = near_points(patches, first, x, rest, balls, 0.2, 0.3)
    expected = set()
    for a, b in patches:
        one, other = (np.arange(first[k], first[k + 1]) for k in (a, b))
        for i, near in zip(one, cKDTree(x).query_ball_point(x[one], 0.2)):
            expected |= {(i, j) for j in near if j in other}
    expected = {(i, j) for i, j in expected if np.linalg.norm(rest[i] - rest[j]) > 0.3}
    assert len(found) == len(expected) > 50
    assert {tuple(pair) for pair in found.tolist()} == expected
    moved = x + 0.05 * rng.random(x.shape)
    which, apart = within(found, moved, 0.15)
    way = moved[found[:, 0]] - moved[found[:, 1]]
    assert np.array_equal(which, np.flatnonzero(np.linalg.norm(way, axis=1) < 0.15))
    np.testing.assert_array_equal(apart, way[which])


def test_more_pairs_than_there_is_room_for_at_first() -> None:
    """A search that overflows its room is repeated with as much as it needs."""
    n = 500
    x = np.zeros((2 * n, 3))
    rest = np.repeat([[0.0, 0, 0], [1.0, 0, 0]], n, axis=0)
    balls = np.zeros((2, 4))
    pairs = near_points(np.array([[0, 1]]), np.array([0, n, 2 * n]), x, rest, balls, 0.1, 0.5)
    assert len(np.unique(pairs, axis=0)) == len(pairs) == n * n


def test_stiffness_between_cells() -> None:
    """Against the dense matrix of springs between points of three cells."""
    rng = np.random.default_rng(6)
    basis, cell = rng.normal(size=(12, 10)), np.repeat([0, 1, 2], 4)
    pairs = np.array([[0, 4], [0, 5], [1, 4], [2, 8], [3, 9], [3, 10]])
    block_of_pair = np.array([0, 0, 0, 1, 1, 1])
    springs = rng.normal(size=(len(pairs), 6))
    touched = np.unique(pairs)
    block_of_point = np.full(12, -1)
    block_of_point[touched] = 2 + cell[touched]
    blocks = stiffness(pairs, springs, block_of_pair, basis, block_of_point, 5)
    for c in range(6):
        whole = np.zeros((30, 30))
        for (i, j), spring in zip(pairs, springs[:, c]):
            row = np.zeros(30)
            row[10 * cell[i] : 10 * cell[i] + 10] += basis[i]
            row[10 * cell[j] : 10 * cell[j] + 10] -= basis[j]
            whole += spring * np.outer(row, row)
        found = np.zeros((30, 30))
        for block, one, other in ((0, 0, 1), (1, 0, 2), (2, 0, 0), (3, 1, 1), (4, 2, 2)):
            part = blocks[block, :, c]
            found[10 * one : 10 * one + 10, 10 * other : 10 * other + 10] += part
            if one != other:
                found[10 * other : 10 * other + 10, 10 * one : 10 * one + 10] += part.T
        np.testing.assert_allclose(found, whole, atol=1e-13)
