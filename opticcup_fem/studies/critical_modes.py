"""The critical modes of a surface run as arrays, for critical.npz and its picture."""

from __future__ import annotations

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


def critical_arrays(one: CriticalMode) -> dict[str, NDArray[Any]]:
    """Return the arrays of critical.npz for one mode; those of k modes are concatenated.

    ``t_n``, ``kind``, ``wavenumber`` and ``purity`` have shape (k,), ``interface`` (k, 9) and
    ``shares`` (k, n_m); the surface is that of ``triangles`` (n_triangles, 3), its vertices at
    ``position`` and moved along ``mode``, each (k, n_vertices, 3).
    """
    snapshot = one.snapshot
    surface = subdivide(snapshot.cells, 3, orientation=snapshot.orientation)
    each = {
        "t_n": one.t_n,
        "kind": one.kind,
        "wavenumber": one.content.wavenumber,
        "purity": one.content.purity,
        "interface": one.content.interface,
        "shares": one.content.shares,
        "position": surface.matrix @ snapshot.position,
        "mode": surface.matrix @ one.motion,
    }
    arrays = {name: np.array([value]) for name, value in each.items()}
    return {**arrays, "triangles": surface.triangles}
