"""Named numbers of an axisymmetric state, as ``opticcup_fem.observables`` defines them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.meridian.mesh import MeridianMesh
from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.observables import TOP
from opticcup_fem.shell import closures

Array = NDArray[np.float64]


def extremes(mesh: MeridianMesh, values: Array) -> tuple[float, float]:
    """Return least and largest value of a nodal field along the meridian.

    Args:
        mesh: The mesh.
        values: Field at the nodes, shape (n_nodes,).
    """
    powers = np.arange(mesh.degree + 1)
    to_monomials = np.linalg.inv(mesh.node_points**powers)
    coefficients = values[mesh.cells] @ to_monomials.T
    candidates = [values]
    for cell in coefficients:
        roots = np.roots((powers * cell)[:0:-1])
        roots = roots[np.abs(roots.imag) < 1e-12].real
        inside = roots[(roots > 0) & (roots < 1)]
        candidates.append(inside[:, None] ** powers @ cell)
    found = np.concatenate(candidates)
    return float(found.min()), float(found.max())


def apex_forms(shell: MeridianShell, state: MeridianState) -> Array:
    """Return the fundamental forms at the apex, where both directions are alike, shape (6,)."""
    slope = shell.mesh.tabulate(np.zeros(1), 1)[1, 0, 0] @ state.r[shell.mesh.cells[0]]
    a, b = float(slope @ slope), shell.curvature_at(state, 0, 0.0)
    return np.array([a, a, 0.0, b, b, 0.0])


def apex_stretch(shell: MeridianShell, state: MeridianState, t_n: float, layer: str) -> float:
    """Return the mean of lambda_3 through a layer at the apex."""
    region = next(iter(shell.mesh.region))
    means = closures.mean_stretches(
        shell.closure,
        shell.sections[region],
        shell.growth_at(t_n, region, np.zeros(1)),
        apex_forms(shell, state)[None],
        np.array([[1.0, 1.0, 0.0]]),
        shell.mesh.profile.curvature,
    )
    return float(means[layer][0])


@dataclass(frozen=True)
class CupObserver:
    """Turns states of a closed cup, an open cap or a disk of radius R into numbers.

    Where there is no bottom pole the rim stands in, where there is no interface too.

    Attributes:
        shell: The shell, with a region "cap" from the apex on.
        radius: R.
    """

    shell: MeridianShell
    radius: float = 1.0

    def __call__(self, state: MeridianState, t_n: float) -> dict[str, float]:
        """Return the observables under the names of ``opticcup_fem.observables.Observer``."""
        mesh = self.shell.mesh
        r, z = state.r.T / self.radius
        apex, bottom = float(z[0]), float(z[-1])
        depth = extremes(mesh, z)[1] - apex
        depth = depth if depth > TOP else 0.0
        widest = extremes(mesh, r)[1]
        edge = int(mesh.region["cap"][-1]) + 1
        return {
            "D_over_r": depth / widest,
            "lambda_iov": apex_stretch(self.shell, state, t_n, "iov"),
            "apex_height_over_R": apex - bottom,
            "max_radius_over_R": widest,
            "depth_over_R": depth,
            "tangent_angle_interface": -float(state.angle[edge]),
        }
