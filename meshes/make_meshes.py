"""Remake the standard meshes of this folder: ``docker/run python3 meshes/make_meshes.py``.

With a folder as argument the files are written there instead.
"""

import math
import sys
from collections.abc import Callable
from pathlib import Path

from opticcup_fem.mesh import (
    SurfaceMesh,
    cup_mesh,
    disk_mesh,
    open_cap_mesh,
    strip_mesh,
    write_msh,
)

ALPHA = math.radians(40.0)

STANDARD: dict[str, Callable[[], SurfaceMesh]] = {
    "cup_40deg_coarse": lambda: cup_mesh(ALPHA, 0.33, 0.18, 0.525),
    "cup_40deg": lambda: cup_mesh(ALPHA, 0.22, 0.12, 0.35),
    "cup_40deg_fine": lambda: cup_mesh(ALPHA, 0.11, 0.06, 0.175),
    "open_cap_40deg": lambda: open_cap_mesh(ALPHA, 0.2, cell_size_rim=0.15),
    "disk": lambda: disk_mesh(1.0, 0.25, cell_size_rim=0.2),
    "strip": lambda: strip_mesh(1.0, 0.25, 12, 4),
}


def main(folder: Path) -> None:
    """Write every standard mesh to ``folder`` and print a line on each."""
    for name, build in STANDARD.items():
        mesh = build()
        write_msh(mesh, folder / f"{name}.msh")
        line = mesh.report()
        if mesh.mesh.comm.rank == 0:
            print(f"{name}: {line}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
