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


class Barrier:
    """Contact potential of a surface's vertices; serial, one thread, so that runs repeat.

    Positions are those of `ContactSurface.vertices`, shape (n_vertices, 3).

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

    def pairs(self, vertices: Floats) -> ipctk.NormalCollisions | None:
        """Return the pairs nearer than d_hat, None where there are none."""
        if self._at is None or not np.array_equal(self._at, vertices):
            pairs = ipctk.NormalCollisions()
            pairs.use_area_weighting = True
            pairs.build(self.surface.mesh, vertices, self.distance)
            self._at, self._pairs = vertices.copy(order="F"), pairs
        return self._pairs if len(self._pairs) else None

    def energy(self, vertices: Floats) -> float:
        """Return E_c."""
        pairs = self.pairs(vertices)
        return 0.0 if pairs is None else self._potential(pairs, self.surface.mesh, vertices)

    def gradient(self, vertices: Floats) -> Floats | None:
        """Return dE_c/dr at the nodes, shape (n_nodes, 3), None where nothing touches."""
        pairs = self.pairs(vertices)
        if pairs is None:
            return None
        forces = self._potential.gradient(pairs, self.surface.mesh, vertices)
        return self.surface.pull_back(np.asarray(forces).reshape(-1, 3))

    def hessian(self, vertices: Floats) -> sparse.csr_array | None:
        """Return d2E_c/dr2, shape (3 n_nodes, 3 n_nodes), None where nothing touches.

        It is the true one, with its negative eigenvalues: those of contact that turns.
        """
        pairs = self.pairs(vertices)
        if pairs is None:
            return None
        hessian = self._potential.hessian(pairs, self.surface.mesh, vertices)
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
        return ipctk.compute_collision_free_stepsize(
            self.surface.mesh, start, end, apart, narrow_phase_ccd=ipctk.AdditiveCCD()
        )

    def crosses(self, vertices: Floats) -> bool:
        """Return whether any parts that can collide cross each other."""
        return ipctk.has_intersections(self.surface.mesh, vertices)
