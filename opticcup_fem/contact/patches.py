"""Which parts of a shell's faces may touch, and how far they may go: flat triangles in balls.

Along a line through a closed shell its faces look forth and back in turn, and those that touch
look at each other.  Two patches of one face whose normals are all within a right angle of each
other are neighbours along the shell, or have other parts of it in between.
"""

from __future__ import annotations

import numpy as np

from opticcup_fem.contact.pairs import (
    BULGE,
    balls,
    distances,
    farthest,
    free_share,
    least_distance,
    near_patches,
    normals,
    pieces,
)
from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.snapshot import Floats, Integers


class Patches:
    """Both faces as the triangles of their collision mesh; serial, for closed shells alone.

    Places are those of the vertices of both faces' triangles, shape (2 n_face, 3).  Patches are
    counted over both faces, the inner one first, cell by cell.

    Attributes:
        count: Patches of one face.
        triangles: Vertices of all patches, shape (2 count, 3).
        room: How far vertices may move before patches that are near are looked for again.
        reach: Patches this near are looked for, whoever asks.
    """

    def __init__(
        self, reference: Floats, surface: ContactSurface, room: float, reach: float
    ) -> None:
        """Take the triangles of a surface.

        Args:
            reference: Reference positions of the sites, shape (n_sites, 3).
            surface: The surface.
            room: See above.
            reach: See above.
        """
        self.room, self.reach, self._exempt = room, reach, surface.exempt
        triangles = surface.face_triangles.astype(np.int64)
        self.count = len(triangles)
        self.triangles: Integers = np.concatenate([triangles, triangles + surface.n_face])
        in_cells = triangles.reshape(-1, 3 * surface.parts**2)
        cells = np.stack([np.unique(corners) for corners in in_cells])
        self._cells: Integers = np.concatenate([cells, cells + surface.n_face])
        self._rest = self.balls(np.tile(surface.map @ reference, (2, 1)))[: self.count]
        self._extent = self._rest[:, 3] / BULGE
        self.forget()

    def forget(self) -> None:
        """Drop what was found, whose order changes rounding: what begins here repeats."""
        none = np.empty((0, 2), dtype=np.int64)
        # ends of a way, the distance below which patches were looked for on it, and these
        self._near: tuple[tuple[Floats, ...], float, Integers] = (), -np.inf, none
        self._colliding: tuple[Integers, Integers] = none, none

    def balls(self, vertices: Floats) -> Floats:
        """Return centres and radii of balls around the curved patches, shape (2 count, 4)."""
        return balls(self.triangles, vertices)

    def near(self, *places: Floats, reach: float) -> Integers:
        """Return the pairs of patches of one face that may touch.

        Args:
            places: One, or two between which vertices go straight.
            reach: Distance below which they touch.

        Returns:
            Shape (n, 2), those of the same two cells one after the other.  These are all that come
            nearer than the reach somewhere, but for neighbours along the shell; others as well.
        """
        ends, within, pairs = self._near
        moved = max(min((farthest(x, end) for end in ends), default=np.inf) for x in places)
        if moved > self.room or reach + 2 * BULGE * moved > within:
            within = max(reach, self.reach) + 2 * BULGE * self.room
            pairs = self._looked_for(places[0], places[-1], within)
            self._near = places, within, pairs
        return pairs

    def gap(self, vertices: Floats, most: float) -> float:
        """Return the least distance of triangles that may touch, ``most`` at most."""
        pairs = self._that_collide(self.near(vertices, reach=most))
        return least_distance(pairs, self.triangles, self.balls(vertices), vertices, most)

    def free_fraction(self, start: Floats, end: Floats, apart: float = 0.0) -> float:
        """Return the share of the straight way from ``start`` that is free of collisions, 0 to 1.

        Args:
            start: Places without a crossing.
            end: Places at the end of the way.
            apart: Distance to be kept all the way.
        """
        pairs = self._that_collide(self.near(start, end, reach=apart))
        return free_share(pairs, self.triangles, self.balls(start), start, end, apart)

    def _that_collide(self, near: Integers) -> Integers:
        """Return those of near pairs of which no parts are exempt."""
        if self._colliding[0] is not near:
            rest = near % self.count
            least = self._exempt + self._extent[rest[:, 0]] + self._extent[rest[:, 1]]
            self._colliding = near, near[distances(self._rest[:, :3], rest) > least]
        return self._colliding[1]

    def _looked_for(self, start: Floats, end: Floats, reach: float) -> Integers:
        around = [normals(self.triangles, x) for x in (start, end)]
        cells, patches = (
            pieces(corners, start, end, around) for corners in (self._cells, self.triangles)
        )
        sides = zip(np.split(cells, 2), np.split(patches, 2), strict=True)
        inner, outer = (near_patches(*side, self._rest, reach, self._exempt) for side in sides)
        return np.concatenate([inner, outer + self.count])
