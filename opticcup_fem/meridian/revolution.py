"""Axisymmetric states and their modes as snapshots of a surface: a meridian turned about its axis.

Cells of a structured cubic triangulation lie between rings and azimuths, three-cornered at a pole.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.meridian.layers import at_azimuth, evaluate
from opticcup_fem.meridian.mesh import MeridianMesh
from opticcup_fem.meridian.shell import MeridianShell, MeridianState
from opticcup_fem.snapshot import NODES, Snapshot

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SEGMENTS = 18
"""Cells around the axis: cubic ones stray from the circle by less than 1e-5 of its radius."""

LEAST_SPACING = 0.05
"""Least distance of rings, in units of the length of arc; meshes are finer at an interface."""


def rings(mesh: MeridianMesh, least: float = LEAST_SPACING) -> tuple[Array, Indices]:
    """Return vertices of a mesh that are not too near to each other, ends of regions among them.

    Args:
        mesh: The mesh.
        least: Their least distance; the last two of a region may be nearer to each other.

    Returns:
        Arc lengths, shape (n + 1,), and the place of the region of each interval, shape (n,).
    """
    found, region = [float(mesh.vertices[0])], []
    for number, cells in enumerate(mesh.region.values()):
        end = float(mesh.vertices[cells[-1] + 1])
        for s in mesh.vertices[cells + 1]:
            if s == end or min(s - found[-1], end - s) >= least:
                found.append(float(s))
                region.append(number)
    return np.array(found), np.array(region)


class Revolution:
    """The surface that a shell's meridian sweeps, as cubic cells with shared nodes.

    Attributes:
        shell: The shell.
        s: Arc length of every node, shape (n,).
        phi: Its azimuth, 0 on the axis, shape (n,).
    """

    def __init__(self, shell: MeridianShell, segments: int = SEGMENTS) -> None:
        """Number cells and nodes.

        Args:
            shell: The shell.
            segments: Cells around the axis, at least 3.
        """
        self.shell = shell
        vertices, region = rings(shell.mesh)
        is_pole = np.zeros(len(vertices), dtype=bool)
        is_pole[[0, -1]] = shell.mesh.is_pole[[0, -1]]
        corners, interval = _corners(is_pole)
        corners = corners[:, None] + np.array([0, 1]) * np.arange(segments)[:, None, None]
        corners = corners.reshape(-1, 3, 2)
        # whole numbers: thirds of an interval, sixths of a segment
        weights = np.column_stack([1 - NODES.sum(axis=1), NODES])
        place = np.rint(3 * np.einsum("jk,mk->mj", weights, corners[..., 0])).astype(np.int64)
        off_axis = ~is_pole[corners[..., 0]]
        share = np.einsum("jk,mk->mj", weights, off_axis)
        turn = np.einsum("jk,mk->mj", weights, corners[..., 1] * off_axis)
        on_axis = share < 1e-12
        sixth = np.rint(6 * turn / np.where(on_axis, 1.0, share)).astype(np.int64)
        sixth = np.where(on_axis, 0, sixth % (6 * segments))
        nodes, cells = np.unique(
            np.stack([place, sixth], axis=-1).reshape(-1, 2), axis=0, return_inverse=True
        )
        self._cells: Indices = cells.reshape(-1, len(NODES))
        self._place, self._region = nodes[:, 0], np.repeat(region[interval], segments)
        thirds = np.arange(3 * len(vertices) - 2) / 3
        self._s = np.interp(thirds, np.arange(len(vertices)), vertices)
        self.s, self.phi = self._s[self._place], nodes[:, 1] * np.pi / (3 * segments)

    def snapshot(self, state: MeridianState, t_n: float) -> Snapshot:
        """Return a state as a snapshot.

        Args:
            state: The state.
            t_n: Its normalised time.
        """
        shell, m = self.shell, len(self._cells)
        phi = self.phi[self._cells]
        position = np.empty((len(self.s), 3))
        stretch: dict[str, Array] = {}
        stress: dict[str, Array] = {}
        faces: dict[str, Array] = {}
        growth: dict[str, Array] = {}
        for number, name in enumerate(shell.mesh.region):
            cells = np.flatnonzero(self._region == number)
            places, where = np.unique(self._place[self._cells[cells]], return_inverse=True)
            where = where.reshape(len(cells), -1)
            on = evaluate(shell, state, t_n, name, self._s[places])
            position[self._cells[cells]] = at_azimuth(on.position[where], phi[cells])
            faces[name] = at_azimuth(on.faces[where], phi[cells, :, None])
            for layer, fields in on.fields.items():
                stretch.setdefault(layer, np.full((m, len(NODES)), np.nan))
                stress.setdefault(layer, np.full((m, len(NODES), 3), np.nan))
                stretch[layer][cells] = fields.thickness_stretch[where]
                stress[layer][cells] = fields.stress[where]
            for quantity, values in on.growth.items():
                growth.setdefault(quantity, np.full((m, len(NODES)), np.nan))
                growth[quantity][cells] = values[where]
        ids = {name: number + 1 for number, name in enumerate(shell.mesh.region)}
        return Snapshot(
            t_n=t_n,
            reference=at_azimuth(shell.mesh.profile.position(self.s), self.phi),
            position=position,
            cells=self._cells,
            region=self._region + 1,
            orientation=np.ones(m),
            region_ids=ids,
            layers={
                name: tuple(layer.name for layer in shell.sections[name].layers) for name in ids
            },
            thickness_stretch=stretch,
            stress=stress,
            faces=faces,
            growth=growth,
        )

    def wave(self, amplitudes: Array, m: int) -> Array:
        """Return (u_r cos m phi, u_phi sin m phi, u_z cos m phi) in space at the nodes.

        In m = 0 the amplitudes are uniform, u_phi being a torsion.

        Args:
            amplitudes: (u_r, u_phi, u_z) at the nodes of the meridian, shape (n_nodes, 3).
            m: Wavenumber.

        Returns:
            Cartesian components, shape (n, 3).
        """
        mesh = self.shell.mesh
        cell = np.minimum(
            np.searchsorted(mesh.vertices[1:], self.s, side="right"), mesh.n_cells - 1
        )
        x = (self.s - mesh.vertices[cell]) / mesh.sizes[cell]
        table = mesh.basis.tabulate(0, x[:, None])[0, :, :, 0]
        u = np.einsum("kn,kni->ki", table, amplitudes[mesh.cells[cell]])
        cosine = np.cos(m * self.phi)
        sine = np.sin(m * self.phi) if m else np.ones_like(self.phi)
        along = at_azimuth(np.stack([u[:, 0] * cosine, u[:, 2] * cosine], axis=1), self.phi)
        across = np.stack([-np.sin(self.phi), np.cos(self.phi), np.zeros_like(self.phi)], axis=1)
        return np.asarray(along + (u[:, 1] * sine)[:, None] * across)


def _corners(is_pole: NDArray[np.bool_]) -> tuple[Indices, Indices]:
    """Return the triangles of one segment, their corners turning outwards.

    Args:
        is_pole: Whether each ring is a pole, shape (n + 1,).

    Returns:
        Ring and azimuth (0 or 1) of the corners, shape (m, 3, 2), and the interval of each
        triangle, shape (m,).
    """
    triangles, interval = [], []
    for i in range(len(is_pole) - 1):
        if not is_pole[i + 1]:
            triangles.append([(i, 0), (i + 1, 0), (i + 1, 1)])
            interval.append(i)
        if not is_pole[i]:
            triangles.append([(i, 0), (i + 1, 1), (i, 1)])
            interval.append(i)
    return np.array(triangles), np.array(interval)
