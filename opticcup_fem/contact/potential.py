"""All that keeps the parts of a shell apart, on one rank.

Places and forces of faces are those at the sites of ``faces``, shape (2, n_sites, 3).

The parts of a closed shell repel each other point by point (``repulsion``), and its flat triangles
tell how far it may go (``patches``).  Where the deformation keeps mirrors, one part of the shell
stands for all of its images, and the mirrors are its walls (``walls``).  The triangles of open
shells and of obstacles are kept from each other by a barrier between pairs (``barrier``).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from opticcup_fem.contact.barrier import Barrier
from opticcup_fem.contact.blocks import Blocks
from opticcup_fem.contact.obstacles import Obstacle
from opticcup_fem.contact.patches import Patches
from opticcup_fem.contact.repulsion import REACH, Repulsion
from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.contact.walls import Walls
from opticcup_fem.snapshot import Floats, Integers

EXEMPT = 1.5
"""Parts nearer than this many thicknesses in the reference surface cannot touch."""

AHEAD = 0.35
"""How far parts may move, over the distance at which contact begins, before it is looked anew for
those that are near."""


def exempt_distance(thickness: float, distance: float) -> float:
    """Return below which distance in the reference surface parts do not repel each other.

    It is 1.5 h, and where contact begins at more than h/2 that gap and h: else a bend would
    repel itself.

    Args:
        thickness: Thickness h of the shell.
        distance: Gap at which contact begins.
    """
    return max(EXEMPT * thickness, thickness + distance)


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
        faces: Both faces at the sites, shape (2, n_sites, 3).
        vertices: Vertices of their triangles, and of obstacles.
        distances: Distances of points from mirrors, empty without.
    """

    faces: Floats
    vertices: Floats
    distances: Floats


class Potential:
    """Contact potential of both faces of a shell.

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
        sites: Integers = np.arange(cells.size).reshape(cells.shape)[part]
        there = reference[cells.ravel()]
        self._surface = ContactSurface(
            there,
            sites,
            orientation[part],
            exempt_distance(thickness, settings.distance),
            settings.parts,
            obstacles,
            closed=True if mirrors else None,
            nodes=cells.ravel(),
        )
        self._cells, self._n_cells = np.flatnonzero(part), len(cells)
        self._pairs = Barrier(self._surface, *barrier)
        self._itself: Repulsion | None = None
        self._walls: Walls | None = None
        if mirrors or (self._surface.closed and not obstacles):
            room, reach = AHEAD * settings.distance, REACH * settings.distance
            patches = Patches(there, self._surface, room, reach)
            self._itself = Repulsion(there, sites, self._surface, patches, thickness, *barrier)
        if mirrors:
            self._walls = Walls(there, sites, mirrors, thickness, *barrier)
        self._reflections = _reflections(reference, mirrors)
        self.images = len(self._reflections)

    def placed(self, faces: Floats, time: float) -> Placed:
        """Return where the faces are, and obstacles at a normalised time."""
        distances = np.empty(0) if self._walls is None else self._walls.distances(faces)
        return Placed(faces, self._surface.vertices(faces, time), distances)

    def energy(self, placed: Placed) -> float:
        """Return the energy of all images, inf where a mirror is passed."""
        if self._itself is None:
            return self._pairs.energy(placed.vertices)
        energy = self._itself.energy(placed.faces)
        if self._walls is not None:
            energy += self._walls.energy(placed.distances)
        return self.images * energy

    def gradient(self, placed: Placed) -> Floats | None:
        """Return dE_c/dx of the faces in the energy of the part alone, None without touch."""
        if self._itself is None:
            return self._pairs.gradient(placed.vertices)
        itself = self._itself.gradient(placed.faces)
        walls = None if self._walls is None else self._walls.gradient(placed.distances)
        if itself is None or walls is None:
            return itself if walls is None else walls
        together: Floats = itself + walls
        return together

    def hessian(self, placed: Placed, convex: bool = False) -> Blocks | None:
        """Return d2E_c/dx2 of the part alone, between cells' sites; None without touch.

        Args:
            placed: Where the faces are.
            convex: Without negative eigenvalues.

        Returns:
            Cells are counted over both faces.
        """
        if self._itself is None:
            of_pairs = self._pairs.hessian(placed.vertices, convex)
            return None if of_pairs is None else Blocks.of(of_pairs)
        found = []
        if (itself := self._itself.hessian(placed.faces, convex)) is not None:
            found.append(self._in_whole(itself))
        if self._walls is not None and (walls := self._walls.hessian(placed.distances)) is not None:
            found.append(Blocks.of(walls))
        return Blocks.sum(found) if found else None

    def _in_whole(self, blocks: Blocks) -> Blocks:
        """Return blocks between cells of the part with these counted in the whole mesh."""
        first, second = (
            side * self._n_cells + self._cells[cell]
            for side, cell in (
                np.divmod(cells, len(self._cells)) for cells in (blocks.first, blocks.second)
            )
        )
        return Blocks(first, second, blocks.values)

    def of_all(self, values: Floats) -> Floats:
        """Return nodes' vectors of all images from those of the part, shape (..., n_nodes, 3)."""
        total = np.zeros_like(values)
        for flips, image in self._reflections:
            total[..., image, :] += flips * values
        return total

    def gap(self, placed: Placed) -> float:
        """Return the least gap, inf where it exceeds the distance at which the potential begins."""
        if self._itself is None:
            return self._pairs.gap(placed.vertices)
        return min(self._itself.gap(placed.faces), self._gap_to_walls(placed))

    def _gap_to_walls(self, placed: Placed) -> float:
        return np.inf if self._walls is None else self._walls.gap(placed.distances)

    def _gap_of_triangles(self, placed: Placed) -> float:
        """Return the least distance of triangles, or at most that where the potential begins."""
        if self._itself is None:
            return min(self._pairs.gap(placed.vertices), self.distance)
        return self._itself.patches.gap(placed.vertices, self.distance)

    def clearance(self, placed: Placed) -> float:
        """Return the most that ``free_fraction`` can keep from here, up to the distance."""
        return min(self._gap_of_triangles(placed), self._gap_to_walls(placed))

    def free_fraction(self, start: Placed, end: Placed, apart: float = 0.0) -> float:
        """Return the share of the straight way from ``start`` that is free of collisions, 0 to 1.

        Args:
            start: Places without a crossing.
            end: Places at the end of the way.
            apart: Distance that triangles and mirrors keep all the way, below the clearance of
                ``start``.
        """
        triangles = self._pairs if self._itself is None else self._itself.patches
        share = triangles.free_fraction(start.vertices, end.vertices, apart)
        if self._walls is None:
            return share
        return min(share, self._walls.free_fraction(start.distances, end.distances, apart))

    def passes(self, start: Placed, end: Placed) -> bool:
        """Return whether nothing touches on the straight way from ``start``, nor at its end."""
        self._forget()
        return self.free_fraction(start, end, self.distance) >= 1.0 and self.gap(end) == np.inf

    def crosses(self, placed: Placed) -> bool:
        """Return whether any parts that can collide cross each other."""
        return self._pairs.crosses(placed.vertices)

    def holds_obstacle(self, half: float) -> bool:
        """See ``ContactSurface``."""
        return self._surface.holds_obstacle(half)

    def begin(self, start: Placed) -> None:
        """Let a way from these places depend on nothing that was before, see ``Barrier``."""
        self._forget(start)

    def _forget(self, start: Placed | None = None) -> None:
        """Drop what was found; points are to resolve the gaps of a start from now on."""
        self._pairs.forget()
        if self._itself is not None:
            self._itself.forget(np.inf if start is None else self._gap_of_triangles(start))


def _reflections(reference: Floats, mirrors: Sequence[int]) -> list[tuple[Floats, Integers]]:
    """Return the diagonal of every product of reflections, and the image of every node under it."""
    tree = cKDTree(reference)
    found: list[tuple[Floats, Integers]] = []
    for signs in itertools.product((1.0, -1.0), repeat=len(mirrors)):
        flips = np.ones(3)
        flips[list(mirrors)] = signs
        found.append((flips, tree.query(flips * reference)[1]))
    return found
