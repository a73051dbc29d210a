"""All that keeps the parts of a shell apart, on one rank: each other, obstacles, and mirrors.

Points of the cubic faces repel each other (``repulsion``); obstacles push flat triangles by the
barrier between pairs (``barrier``), which also keep ways free of collisions.  Where the deformation
keeps mirrors, one part of the shell stands for all of its images, and the mirrors are its walls.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from opticcup_fem.contact.barrier import Barrier
from opticcup_fem.contact.obstacles import Obstacle
from opticcup_fem.contact.repulsion import Repulsion
from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.contact.walls import Walls
from opticcup_fem.snapshot import Floats, Integers

EXEMPT = 1.5
"""Parts nearer than this many thicknesses in the reference surface cannot touch."""


@dataclass(frozen=True)
class ContactSettings:
    """How contact is resisted.

    Attributes:
        distance: Gap at which the barrier begins, unit of length of the mesh.
        stiffness: Stress scale of the barrier.
        parts: Parts of each cell's edge in the collision mesh.
    """

    distance: float
    stiffness: float
    parts: int = 3


class Placed(NamedTuple):
    """Where the faces are.

    Attributes:
        faces: Both faces at the nodes, shape (2, n_nodes, 3).
        vertices: Vertices of their triangles, and of obstacles.
        distances: Distances of points from mirrors, empty without.
    """

    faces: Floats
    vertices: Floats
    distances: Floats


class Potential:
    """Contact potential of both faces of a shell; places of faces have shape (2, n_nodes, 3).

    Attributes:
        distance: Gap at which it begins.
        images: Images of the part that energies and stiffness are computed for, itself included.
    """

    def __init__(
        self,
        reference: Floats,
        cells: Integers,
        orientation: Floats,
        thickness: float,
        settings: ContactSettings,
        obstacles: Sequence[Obstacle] = (),
        mirrors: Sequence[int] = (),
    ) -> None:
        """Build the collision mesh, and what repels.

        Args:
            reference: Reference positions of the nodes, shape (n_nodes, 3).
            cells: Nodes of the cubic cells, shape (m, 10).
            orientation: +1 where a cell's nodes wind as the outside demands, else -1, shape (m,).
            thickness: Thickness of the shell.
            settings: Barrier and collision mesh.
            obstacles: Rigid bodies.
            mirrors: Planes x_i = 0 that the deformation keeps as mirrors.
        """
        self.distance = settings.distance
        part = np.all(reference[cells].mean(axis=1)[:, list(mirrors)] > 0, axis=1)
        barrier = (settings.distance, settings.stiffness)
        shape = (reference, cells[part], orientation[part], EXEMPT * thickness, settings.parts)
        self._surface = ContactSurface(*shape, obstacles, closed=True if mirrors else None)
        self._ways = Barrier(self._surface, *barrier)
        self._itself = Repulsion(reference, cells[part], self._surface, thickness, *barrier)
        self._obstacles: Barrier | None = None
        if obstacles:
            self._obstacles = Barrier(ContactSurface(*shape, obstacles, itself=False), *barrier)
        self._walls: Walls | None = None
        if mirrors:
            self._walls = Walls(reference, cells[part], mirrors, thickness, *barrier)
        self._reflections = _reflections(reference, mirrors)
        self.images = len(self._reflections)

    def placed(self, faces: Floats, time: float) -> Placed:
        """Return where the faces are, and obstacles at a normalised time."""
        distances = np.empty(0) if self._walls is None else self._walls.distances(faces)
        return Placed(faces, self._surface.vertices(faces, time), distances)

    def energy(self, placed: Placed) -> float:
        """Return the energy of all images, inf where a mirror is passed."""
        energy = self._itself.energy(placed.faces)
        if self._obstacles is not None:
            energy += self._obstacles.energy(placed.vertices)
        if self._walls is not None:
            energy += self._walls.energy(placed.distances)
        return self.images * energy

    def gradient(self, placed: Placed) -> Floats | None:
        """Return dE_c/dx of the faces in the energy of the part alone, None without touch."""
        found = [self._itself.gradient(placed.faces)]
        if self._obstacles is not None:
            found.append(self._obstacles.gradient(placed.vertices))
        if self._walls is not None:
            found.append(self._walls.gradient(placed.distances))
        parts = [part for part in found if part is not None]
        return np.sum(parts, axis=0) if parts else None

    def hessian(self, placed: Placed, convex: bool = False) -> sparse.csr_array | None:
        """Return d2E_c/dx2 of the part alone, shape (6 n_nodes, 6 n_nodes), None without touch.

        Args:
            placed: Where the faces are.
            convex: Without negative eigenvalues.
        """
        found = [self._itself.hessian(placed.faces, convex)]
        if self._obstacles is not None:
            found.append(self._obstacles.hessian(placed.vertices, convex))
        if self._walls is not None:
            found.append(self._walls.hessian(placed.distances))
        parts = [part for part in found if part is not None]
        return reduce(operator.add, parts) if parts else None

    def of_all(self, values: Floats) -> Floats:
        """Return the vectors of all images from those of the part, shape (..., n_nodes, 3)."""
        total = np.zeros_like(values)
        for flips, image in self._reflections:
            total[..., image, :] += flips * values
        return total

    def gap(self, placed: Placed) -> float:
        """Return the least gap, inf where it exceeds the distance at which the potential begins."""
        gaps = [self._itself.gap(placed.faces)]
        if self._obstacles is not None:
            gaps.append(self._obstacles.gap(placed.vertices))
        if self._walls is not None:
            gaps.append(self._walls.gap(placed.distances))
        return min(gaps)

    def clearance(self, placed: Placed) -> float:
        """Return the most that ``free_fraction`` can keep from here, up to the distance."""
        walls = np.inf if self._walls is None else self._walls.gap(placed.distances)
        return min(self._ways.gap(placed.vertices), walls, self.distance)

    def free_fraction(self, start: Placed, end: Placed, apart: float = 0.0) -> float:
        """Return the share of the straight way from ``start`` that is free of collisions, 0 to 1.

        Args:
            start: Places without a crossing.
            end: Places at the end of the way.
            apart: Distance that triangles and mirrors keep all the way, below the clearance of
                ``start``.
        """
        share = 1.0
        if self._walls is not None:
            share = self._walls.free_fraction(start.distances, end.distances, apart)
        return min(share, self._ways.free_fraction(start.vertices, end.vertices, apart))

    def passes(self, start: Placed, end: Placed) -> bool:
        """Return whether nothing touches on the straight way from ``start``, nor at its end."""
        if self.free_fraction(start, end, 2 * self.distance) >= 1.0:
            return True
        clear = self.free_fraction(start, end, self.distance) >= 1.0
        return clear and self.gap(end) == np.inf

    def crosses(self, placed: Placed) -> bool:
        """Return whether any parts that can collide cross each other."""
        return self._ways.crosses(placed.vertices)

    def holds_obstacle(self, half: float) -> bool:
        """See ``ContactSurface``."""
        return self._surface.holds_obstacle(half)

    def forget(self) -> None:
        """Let what begins here repeat, see ``Barrier``."""
        self._ways.forget()
        self._itself.forget()
        if self._obstacles is not None:
            self._obstacles.forget()


def _reflections(reference: Floats, mirrors: Sequence[int]) -> list[tuple[Floats, Integers]]:
    """Return the diagonal of every product of reflections, and the image of every node under it."""
    tree = cKDTree(reference)
    found: list[tuple[Floats, Integers]] = []
    for signs in itertools.product((1.0, -1.0), repeat=len(mirrors)):
        flips = np.ones(3)
        flips[list(mirrors)] = signs
        found.append((flips, tree.query(flips * reference)[1]))
    return found
