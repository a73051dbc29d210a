r"""The barrier that keeps surfaces apart, its derivatives, and how far a step may go.

IPC Toolkit's potential: over all pairs of parts nearer than d_hat,

    E_c = sum_i w_i k d_hat b(d_i/d_hat),      b(x) = -(x^2 - 1)^2 ln(x^2),

k a stress and w_i the reference area that a pair stands for.  b is twice continuously
differentiable, 0 from x = 1 on and unbounded as the gap closes.  Pairs of one place add up, more of
them the larger d_hat is against the distance of the vertices: E_c is at least the integral of
k d_hat b over the area that touches, and the gap depends a little on the triangles.  (The
toolkit's "improved max" set corrects for that by negative weights; at single vertices they cancel
the barrier.)
"""

from __future__ import annotations

import ipctk
import numpy as np
from scipy import sparse

from opticcup_fem.contact.surface import ContactSurface
from opticcup_fem.snapshot import Floats

ROOM = 0.5
"""How far vertices may move, over d_hat, before the parts that are near are looked for again."""


class Barrier:
    """Contact potential of a surface's vertices; serial, one thread, so that runs repeat.

    Positions are those of `ContactSurface.vertices`, shape (n_vertices, 3).  Parts that are nearer
    than d_hat somewhere within ``ROOM`` of the present positions are listed once and searched until
    a vertex has gone farther (a Verlet list).

    Attributes:
        surface: The surface.
        distance: d_hat.
        stiffness: k.
    """

    def __init__(self, surface: ContactSurface, distance: float, stiffness: float) -> None:
        """Set the potential up.

        Args:
            surface: What can touch.
            distance: d_hat, the gap at which the barrier begins.
            stiffness: k [stress].
        """
        ipctk.set_num_threads(1)
        self.surface, self.distance, self.stiffness = surface, distance, stiffness
        # every pair is seen from both sides
        self._potential = ipctk.BarrierPotential(distance, stiffness / 2, True)
        self._at: Floats | None = None
        self._pairs = ipctk.NormalCollisions()
        self._listed: Floats | None = None
        self._near = ipctk.Candidates()

    def forget(self) -> None:
        """Drop the list, whose order changes results by rounding: what begins here repeats."""
        self._at = self._listed = None

    def _reaches(self, vertices: Floats) -> bool:
        """Return whether the list holds for these positions."""
        if self._listed is None:
            return False
        moved = np.linalg.norm(vertices - self._listed, axis=1).max()
        return bool(moved <= ROOM * self.distance)

    def _candidates(self, vertices: Floats) -> ipctk.Candidates:
        """Return the list of parts that may be near, made afresh where it does not hold."""
        if not self._reaches(vertices):
            self._near = ipctk.Candidates()
            self._near.build(self.surface.mesh, vertices, (0.5 + ROOM) * self.distance)
            self._listed = vertices.copy(order="F")
        return self._near

    def pairs(self, vertices: Floats) -> ipctk.NormalCollisions | None:
        """Return the pairs nearer than d_hat, None where there are none."""
        if self._at is None or not np.array_equal(self._at, vertices):
            pairs = ipctk.NormalCollisions()
            pairs.use_area_weighting = True
            pairs.build(self._candidates(vertices), self.surface.mesh, vertices, self.distance)
            self._at, self._pairs = vertices.copy(order="F"), pairs
        return self._pairs if len(self._pairs) else None

    def energy(self, vertices: Floats) -> float:
        """Return E_c."""
        pairs = self.pairs(vertices)
        return 0.0 if pairs is None else self._potential(pairs, self.surface.mesh, vertices)

    def gradient(self, vertices: Floats) -> Floats | None:
        """Return dE_c/dx of the faces x at the sites, shape (2, n_sites, 3), inner face first.

        None where nothing touches.
        """
        pairs = self.pairs(vertices)
        if pairs is None:
            return None
        slope = self._potential.gradient(pairs, self.surface.mesh, vertices)
        return self.surface.pull_back(np.asarray(slope).reshape(-1, 3))

    def hessian(self, vertices: Floats, convex: bool = False) -> sparse.csr_array | None:
        """Return d2E_c/dx2, shape (6 n_sites, 6 n_sites), None where nothing touches.

        Args:
            vertices: Positions.
            convex: Without the negative eigenvalues of each pair: those of contact that turns.
        """
        pairs = self.pairs(vertices)
        if pairs is None:
            return None
        method = ipctk.PSDProjectionMethod.CLAMP if convex else ipctk.PSDProjectionMethod.NONE
        hessian = self._potential.hessian(pairs, self.surface.mesh, vertices, method)
        return self.surface.pull_back_matrix(hessian)

    def gap(self, vertices: Floats) -> float:
        """Return the least gap, inf where it exceeds d_hat."""
        pairs = self.pairs(vertices)
        if pairs is None:
            return float("inf")
        return float(np.sqrt(pairs.compute_minimum_distance(self.surface.mesh, vertices)))

    def free_fraction(self, start: Floats, end: Floats, apart: float = 0.0) -> float:
        """Return the share of the straight way from ``start`` that is free of collisions, 0 to 1.

        Args:
            start: Positions without a crossing.
            end: Positions at the end of the way.
            apart: Distance to be kept all the way, below the gap at ``start``.
        """
        # the toolkit's default method takes minutes over edges that move in parallel planes
        method = ipctk.AdditiveCCD()
        mesh, farthest = self.surface.mesh, np.linalg.norm(end - start, axis=1).max()
        if apart <= self.distance and farthest <= ROOM * self.distance:
            near = self._candidates(start)
            if self._reaches(end):
                return near.compute_collision_free_stepsize(mesh, start, end, apart, method)
        return ipctk.compute_collision_free_stepsize(
            mesh, start, end, apart, narrow_phase_ccd=method
        )

    def crosses(self, vertices: Floats) -> bool:
        """Return whether any parts that can collide cross each other."""
        return ipctk.has_intersections(self.surface.mesh, vertices)
