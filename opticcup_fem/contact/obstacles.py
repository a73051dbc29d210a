"""Rigid obstacles as triangle meshes that stand still or move evenly with the normalised time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.snapshot import Floats

Vector = tuple[float, float, float]
_STILL: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ObstacleMesh:
    """Vertices, shape (n, 3), and triangles that wind as the outside demands, shape (m, 3)."""

    vertices: Floats
    triangles: NDArray[np.int32]


class Obstacle(Protocol):
    """A rigid body."""

    @property
    def velocity(self) -> Vector:
        """Its velocity per unit of normalised time."""
        ...

    def mesh(self) -> ObstacleMesh:
        """Return its surface at t_n = 0."""
        ...


@dataclass(frozen=True)
class Plate:
    """A flat square plate without thickness.

    Attributes:
        centre: Its centre at t_n = 0.
        normal: A vector normal to it, of any length.
        width: Length of its sides.
        cell_size: Largest side of its triangles, 0 for two triangles.
        velocity: Velocity per unit of normalised time.
    """

    centre: Vector
    normal: Vector
    width: float
    cell_size: float = 0.0
    velocity: Vector = _STILL

    def mesh(self) -> ObstacleMesh:
        """See ``Obstacle``."""
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        first /= np.linalg.norm(first)
        second = np.cross(normal, first)
        n = 1 if self.cell_size <= 0 else int(np.ceil(self.width / self.cell_size))
        side = np.linspace(-self.width / 2, self.width / 2, n + 1)
        across, along = (grid.ravel() for grid in np.meshgrid(side, side, indexing="ij"))
        vertices = np.array(self.centre) + np.outer(across, first) + np.outer(along, second)
        corner = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
        lower = np.column_stack([corner, corner + n + 1, corner + n + 2])
        upper = np.column_stack([corner, corner + n + 2, corner + 1])
        return ObstacleMesh(vertices, np.concatenate([lower, upper]).astype(np.int32))


@dataclass(frozen=True)
class Box:
    """A box with faces normal to the axes.

    Attributes:
        centre: Its centre at t_n = 0.
        sides: Lengths of its sides along x, y and z.
        velocity: Velocity per unit of normalised time.
    """

    centre: Vector
    sides: Vector
    velocity: Vector = _STILL

    def mesh(self) -> ObstacleMesh:
        """See ``Obstacle``."""
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        quads = np.array(
            [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
        )
        triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        vertices = np.array(self.centre) + corners * np.array(self.sides) / 2
        return ObstacleMesh(vertices, triangles.astype(np.int32))


@dataclass(frozen=True)
class Sphere:
    """A sphere, an icosahedron cut finer.

    Attributes:
        centre: Its centre at t_n = 0.
        radius: Its radius; the vertices lie on it.
        refinements: How often every triangle is cut into four.
        velocity: Velocity per unit of normalised time.
    """

    centre: Vector
    radius: float
    refinements: int = 3
    velocity: Vector = _STILL

    def mesh(self) -> ObstacleMesh:
        """See ``Obstacle``."""
        vertices, triangles = _icosahedron()
        for _ in range(self.refinements):
            vertices, triangles = _cut_in_four(vertices, triangles)
        placed: Floats = np.array(self.centre) + self.radius * vertices
        return ObstacleMesh(placed, triangles.astype(np.int32))


def _icosahedron() -> tuple[Floats, NDArray[np.int64]]:
    """Return the corners (on the unit sphere) and triangles of an icosahedron."""
    g = (1 + np.sqrt(5)) / 2
    first = [[-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0]]
    corners = np.array([np.roll(corner, shift) for shift in (0, 1, 2) for corner in first])
    edge = np.linalg.norm(corners[0] - corners[1])
    n = len(corners)
    near = np.isclose(np.linalg.norm(corners[:, None] - corners, axis=2), edge)
    triangles = [
        [i, j, k]
        for i in range(n)
        for j in range(i + 1, n)
        for k in range(j + 1, n)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    found = np.array(triangles)
    a, b, c = (corners[found[:, side]] for side in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c) < 0
    found[inwards] = found[inwards][:, ::-1]
    return corners / np.linalg.norm(corners[0]), found


def _cut_in_four(
    vertices: Floats, triangles: NDArray[np.int64]
) -> tuple[Floats, NDArray[np.int64]]:
    """Cut triangles of the unit sphere at the middles of their edges."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    unique, number = np.unique(edges, axis=0, return_inverse=True)
    middle = vertices[unique].sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    ab, bc, ca = (len(vertices) + number.reshape(-1, 3)).T
    a, b, c = triangles.T
    parts = [[a, ab, ca], [b, bc, ab], [c, ca, bc], [ab, bc, ca]]
    cut = np.concatenate([np.column_stack(part) for part in parts])
    return np.concatenate([vertices, middle]), cut


def joined(obstacles: Sequence[Obstacle], time: float) -> ObstacleMesh:
    """Return all obstacles as one mesh, where they are at a normalised time."""
    vertices: list[Floats] = [np.empty((0, 3))]
    triangles: list[NDArray[np.int32]] = [np.empty((0, 3), dtype=np.int32)]
    start = 0
    for obstacle in obstacles:
        mesh = obstacle.mesh()
        vertices.append(mesh.vertices + time * np.array(obstacle.velocity))
        triangles.append(mesh.triangles + np.int32(start))
        start += len(mesh.vertices)
    return ObstacleMesh(np.concatenate(vertices), np.concatenate(triangles))
