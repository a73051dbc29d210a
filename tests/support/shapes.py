"""Analytic shapes on a triangulated sphere, as snapshots: no solver involved."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from opticcup_fem.snapshot import EDGES, NODES, Snapshot, cell_tangents

ALPHA = np.deg2rad(40.0)
LAYERS = {"cap": ("iov", "ecm"), "oov": ("oov",)}
REGIONS = {"cap": 1, "oov": 2}

Map = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Current position (k, 3) from colatitude and azimuth (k,)."""


def sphere_angles(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return colatitude and azimuth of points (k, 3)."""
    x, y, z = points.T
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)


def sphere_points(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Return points of the unit sphere, shape (k, 3)."""
    return np.column_stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )


def _rings(alpha: float, size: float) -> list[float]:
    """Return the colatitudes of the rings of vertices, both poles and alpha included."""
    cap = np.linspace(0, alpha, max(2, round(alpha / size)) + 1)
    rest = np.linspace(alpha, np.pi, max(3, round((np.pi - alpha) / size)) + 1)
    return [*cap, *rest[1:]]


def _zip(first: np.ndarray, second: np.ndarray) -> list[list[int]]:
    """Return the triangles between two closed rings of vertices."""
    triangles, i, j, n, m = [], 0, 0, len(first), len(second)
    while i < n or j < m:
        forward = m == 1 or (i < n and (i + 0.5) / n <= (j + 0.5) / m) or j == m
        if n > 1 and forward:
            triangles.append([first[i % n], first[(i + 1) % n], second[j % m]])
            i += 1
        elif m > 1:
            triangles.append([first[i % n], second[(j + 1) % m], second[j % m]])
            j += 1
        if (n == 1 and j == m) or (m == 1 and i == n):
            break
    return triangles


def sphere_mesh(size: float = 0.25, alpha: float = ALPHA, seed: int = 1) -> Snapshot:
    """Return the unit sphere as a snapshot: cap and OOV, cells of mixed handedness.

    Args:
        size: Distance between the vertices, roughly.
        alpha: Colatitude of the interface, which lies on edges.
        seed: Of the cells' random order and rotation.
    """
    rng = np.random.default_rng(seed)
    vertices: list[np.ndarray] = []
    rings: list[np.ndarray] = []
    thetas = _rings(alpha, size)
    for k, theta in enumerate(thetas):
        pole = k in (0, len(thetas) - 1)
        count = 1 if pole else max(6, round(2 * np.pi * np.sin(theta) / size))
        phi = 2 * np.pi * (np.arange(count) + 0.3 * (k % 2)) / count
        rings.append(np.arange(count) + sum(len(v) for v in vertices))
        vertices.append(sphere_points(np.full(count, theta), phi))
    corners = np.concatenate(vertices)
    triangles, region = [], []
    for k, pair in enumerate(pairwise(rings)):
        new = _zip(*pair)
        triangles += new
        region += [1 if thetas[k + 1] <= alpha + 1e-12 else 2] * len(new)
    shuffled = rng.permutation(len(triangles))
    cells = np.array([rng.permutation(triangles[t]) for t in shuffled])
    return _cubic(corners, cells, np.array(region)[shuffled], alpha)


def _cubic(corners: np.ndarray, cells: np.ndarray, region: np.ndarray, alpha: float) -> Snapshot:
    """Return the snapshot of the reference sphere with cubic nodes exactly on it."""
    nodes: list[np.ndarray] = list(corners)
    shared: dict[tuple[int, int], tuple[int, int]] = {}
    cubic = np.empty((len(cells), 10), dtype=np.int64)
    cubic[:, :3] = cells
    for c, cell in enumerate(cells):
        for first, second, *between in EDGES:
            low, high = sorted((int(cell[first]), int(cell[second])))
            if (low, high) not in shared:
                shared[low, high] = (len(nodes), len(nodes) + 1)
                ends = corners[[low, high]]
                on_circle = np.allclose(sphere_angles(ends)[0], alpha, rtol=0, atol=1e-12)
                for weight in (1 / 3, 2 / 3):
                    node = (1 - weight) * ends[0] + weight * ends[1]
                    theta, phi = sphere_angles(node[None])
                    nodes.append(sphere_points([alpha] if on_circle else theta, phi)[0])
            pair = shared[low, high]
            cubic[c, between] = pair if cell[first] == low else pair[::-1]
        weights = np.array([1 - NODES[9].sum(), *NODES[9]])
        middle = weights @ corners[cell]
        cubic[c, 9] = len(nodes)
        nodes.append(middle / np.linalg.norm(middle))
    reference = np.array(nodes)
    tangents = cell_tangents(reference, cubic, np.full((len(cells), 2), 1 / 3))
    outward = np.einsum(
        "ki,ki->k", np.cross(tangents[:, 0], tangents[:, 1]), reference[cubic[:, 9]]
    )
    bare = Snapshot(
        t_n=0.0,
        reference=reference,
        position=reference,
        cells=cubic,
        region=region,
        orientation=np.sign(outward),
        region_ids=REGIONS,
        layers=LAYERS,
        thickness_stretch={},
        stress={},
        faces={},
    )
    return with_layers(bare)


def with_layers(bare: Snapshot, thickness: float = 0.2, ecm: float = 0.1) -> Snapshot:
    """Return a snapshot with layers of given thickness, unit stretch, zero stress."""
    faces, stretch, stress = {}, {}, {}
    for name, layers in LAYERS.items():
        cells = bare.cells_of(name)
        heights = np.array([-0.5, 0.5 - ecm, 0.5] if len(layers) == 2 else [-0.5, 0.5]) * thickness
        repeated = np.repeat(bare.cells[cells], 10, axis=0)
        tangents = cell_tangents(bare.position, repeated, np.tile(NODES, (len(cells), 1)))
        normal = np.cross(tangents[:, 0], tangents[:, 1]).reshape(-1, 10, 3)
        normal *= bare.orientation[cells, None, None] / np.linalg.norm(normal, axis=2)[..., None]
        middle = bare.position[bare.cells[cells]]
        faces[name] = middle[:, :, None] + normal[:, :, None] * heights[:, None]
        for layer in layers:
            stretch[layer] = np.full((len(bare.cells), 10), np.nan)
            stress[layer] = np.full((len(bare.cells), 10, 3), np.nan)
            stretch[layer][cells], stress[layer][cells] = 1.0, 0.0
    return replace(bare, faces=faces, thickness_stretch=stretch, stress=stress)


def deformed(sphere: Snapshot, shape: Map, t_n: float = 0.0) -> Snapshot:
    """Return a snapshot whose nodes lie where `shape` puts them."""
    position = shape(*sphere_angles(sphere.reference))
    return with_layers(replace(sphere, position=position, t_n=t_n))


def revolved(r: np.ndarray, z: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Return positions (k, 3) from horizontal radius and height."""
    return np.column_stack([r * np.cos(phi), r * np.sin(phi), z])


def cup_profile(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return radius and height of a smooth cup whose apex lies below its rim."""
    c = np.cos(theta)
    return np.sin(theta) * (1 - 0.3 * ((1 + c) / 2) ** 2), c - 0.45 * (1 + c) ** 2


def cup(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Return the positions of the smooth cup."""
    return revolved(*cup_profile(theta), phi)
