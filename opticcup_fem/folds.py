"""Whether cells are small enough for a shell's folds: by how much the normal turns within one.

A cubic cell follows an arc of a right angle within a few per cent of its curvature.  Where one
turns by 150 degrees the fold is as sharp as the cell lets it be, and a slit's depth depends on the
mesh (docs/contact.md).
"""

from __future__ import annotations

import numpy as np

from opticcup_fem.snapshot import Snapshot, cell_normals, colatitudes


def fold_columns(snapshot: Snapshot) -> dict[str, float]:
    """Return columns of path.csv about the cell that is bent most.

    Returns:
        ``turn_in_cell_deg``, the largest angle between the normals at two of its nodes, and
        ``turn_colatitude_deg``, the reference colatitude of its middle: where smaller cells are
        needed (``mesh.refinements``).
    """
    normals = cell_normals(snapshot)
    cosines = np.einsum("cni,cmi->cnm", normals, normals).min(axis=(1, 2))
    cell = int(np.argmin(cosines))
    middle = snapshot.reference[snapshot.cells[cell, -1]]  # the interior node
    turn = np.rad2deg(np.arccos(np.clip(cosines[cell], -1.0, 1.0)))
    colatitude = np.rad2deg(colatitudes(middle))
    return {"turn_in_cell_deg": float(turn), "turn_colatitude_deg": float(colatitude)}
