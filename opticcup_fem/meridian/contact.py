"""Whether an axisymmetric mid-surface crosses itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.meridian.shell import MeridianShell, MeridianState

Array = NDArray[np.float64]

_PARTS = 4
"""Chords that stand for a cell."""


def self_crossing(shell: MeridianShell, state: MeridianState) -> Array | None:
    """Return a place (r, z) where the meridian crosses itself or the axis, None if nowhere."""
    mesh = shell.mesh
    points = np.arange(_PARTS) / float(_PARTS)
    basis = mesh.tabulate(points, 0)[0]
    curve = np.einsum("cqn,cni->cqi", basis, state.r[mesh.cells]).reshape(-1, 2)
    curve = np.concatenate([curve, state.r[mesh.cells[-1, 1]][None]])
    beyond = np.flatnonzero(curve[1:, 0] < 0)
    if len(beyond):
        return np.asarray(curve[beyond[0] + 1])
    return crossing_of(curve)


def crossing_of(curve: Array) -> Array | None:
    """Return a point where two chords of an open polyline cross, None if none do.

    Args:
        curve: Corners, shape (n, 2).
    """
    start, run = curve[:-1], np.diff(curve, axis=0)
    i, j = np.triu_indices(len(run), 2)
    offset = start[j] - start[i]
    det = _cross(run[i], run[j])
    with np.errstate(divide="ignore", invalid="ignore"):
        along_i = _cross(offset, run[j]) / det
        along_j = _cross(offset, run[i]) / det
    hit = (det != 0) & (along_i > 0) & (along_i < 1) & (along_j > 0) & (along_j < 1)
    if not hit.any():
        return None
    first = int(np.argmax(hit))
    return np.asarray(start[i[first]] + along_i[first] * run[i[first]])


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
