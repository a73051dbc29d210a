"""The critical modes of a surface run as arrays, for critical.npz and its picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.snapshot import Floats, Snapshot, subdivide
from opticcup_fem.wavenumbers import AzimuthalContent


@dataclass(frozen=True)
class CriticalMode:
    """A critical mode on the state beside it.

    Attributes:
        t_n: Normalised time of the critical point.
        kind: Its kind as an event.
        snapshot: The state.
        motion: The mode's displacement of the snapshot's nodes, shape (n, 3).
        content: Its azimuthal content.
    """

    t_n: float
    kind: str
    snapshot: Snapshot
    motion: Floats
    content: AzimuthalContent


def critical_arrays(modes: Sequence[CriticalMode]) -> dict[str, NDArray[Any]]:
    """Return the arrays of critical.npz.

    ``t_n``, ``kind``, ``wavenumber`` and ``purity`` have shape (k,), ``interface`` (k, 9) and
    ``shares`` (k, n_m); the surface is that of ``triangles`` (n_triangles, 3), its vertices at
    ``position`` and moved along ``mode``, each (k, n_vertices, 3).
    """
    first = modes[0].snapshot
    surface = subdivide(first.cells, 3, orientation=first.orientation)
    return {
        "t_n": np.array([one.t_n for one in modes]),
        "kind": np.array([one.kind for one in modes]),
        "wavenumber": np.array([one.content.wavenumber for one in modes]),
        "purity": np.array([one.content.purity for one in modes]),
        "interface": np.array([one.content.interface for one in modes]),
        "shares": np.array([one.content.shares for one in modes]),
        "triangles": surface.triangles,
        "position": np.array([surface.matrix @ one.snapshot.position for one in modes]),
        "mode": np.array([surface.matrix @ one.motion for one in modes]),
    }
