"""A 3D picture of one state: the shell cut open, with true thickness and coloured layers."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from opticcup_fem.compat import outer_surface
from opticcup_fem.fields import VTK_NODES
from opticcup_fem.plots import style
from opticcup_fem.plots.display import draw_apart
from opticcup_fem.records import COLLECTION, SOLID
from opticcup_fem.snapshot import Floats, Integers, subdivide

if TYPE_CHECKING:
    import pyvista as pv

_PARTS = 6
"""Flat pieces along each cell's edge."""


def solid(run_dir: str | Path, t_n: float | None = None, out: str | Path | None = None) -> Path:
    """Draw the cut-open cup from a run's field files, in a process of its own.

    Args:
        run_dir: The run's folder, with fields.pvd.
        t_n: The field file nearest to this time; the last one by default.
        out: The picture; cup.png in the run's folder by default.

    Returns:
        The picture's path.

    Raises:
        OpticCupError: The picture could not be drawn.
    """
    out = Path(out) if out is not None else Path(run_dir) / SOLID
    arguments = [str(run_dir), str(out), *([] if t_n is None else [repr(float(t_n))])]
    draw_apart(__name__, arguments)
    return out


def layer_solids(grid: "pv.UnstructuredGrid") -> "dict[str, pv.UnstructuredGrid]":
    """Return each layer of a field file as wedges of true thickness.

    Args:
        grid: A field file (`opticcup_fem.fields.write_fields`) as PyVista reads it.
    """
    import pyvista as pv

    ours = np.argsort(VTK_NODES)
    points = np.asarray(grid.cells).reshape(-1, 1 + len(ours))[:, 1:][:, ours]
    nodes = np.asarray(grid.point_data["node"])
    boundaries = _boundaries(grid)
    solids = {}
    for name in [key for key in grid.cell_data if key.startswith("inner_face_")]:
        inner = np.asarray(grid.cell_data[name])
        cells = np.flatnonzero(inner >= 0)
        _, welded = np.unique(nodes[points[cells]], return_inverse=True)
        welded = welded.reshape(len(cells), -1)
        pieces = subdivide(welded, _PARTS)
        inside, outside = (
            pieces.matrix @ _mean_at(welded, boundaries[inner[cells, None] + k, points[cells]])
            for k in (0, 1)
        )
        # VTK's wedge starts with the triangle that winds outwards seen from inside the wedge
        wedges = np.hstack([pieces.triangles + len(inside), pieces.triangles])
        solids[name.removeprefix("inner_face_")] = pv.UnstructuredGrid(
            {pv.CellType.WEDGE: wedges}, np.concatenate([inside, outside])
        )
    return solids


def _boundaries(grid: "pv.UnstructuredGrid") -> Floats:
    """Return the layers' faces at the points, shape (n_faces, n_points, 3)."""
    names = sorted(
        (key for key in grid.point_data if key.startswith("boundary_")),
        key=lambda key: int(key.removeprefix("boundary_")),
    )
    return np.stack([grid.points + np.asarray(grid.point_data[name]) for name in names])


def _mean_at(nodes: Integers, values: Floats) -> Floats:
    """Return the mean of cell-node values (m, 10, 3) at each node, shape (n_nodes, 3).

    Faces of neighbouring cells differ by a hair, as their normals do; a solid needs one.
    """
    count = np.bincount(nodes.ravel())
    total = np.zeros((len(count), 3))
    np.add.at(total, nodes, values)
    return total / count[:, None]


def cut_open(layer: "pv.UnstructuredGrid", proud: float = 0.0) -> "pv.PolyData":
    """Return the surface of a layer without the quarter x > 0, y < 0.

    Args:
        layer: Wedges of one layer.
        proud: By how much the layer stands out of the cut.
    """
    edge = (proud, -proud, 0.0)
    left = layer.clip(normal="x", origin=edge)
    right = layer.clip(normal="-x", origin=edge).clip(normal="-y", origin=edge)
    return outer_surface(left.merge(right, merge_points=True))


def draw(run_dir: Path, out: Path, t_n: float | None = None) -> None:
    """Draw the picture in this process; VTK must find a display or draw off-screen."""
    import pyvista as pv

    reader = pv.get_reader(str(run_dir / COLLECTION))
    times = np.array(reader.time_values)
    at = len(times) - 1 if t_n is None else int(np.argmin(np.abs(times - t_n)))
    reader.set_active_time_point(at)
    solids = layer_solids(reader.read()[0])
    plotter = pv.Plotter(off_screen=True, window_size=(1400, 1100), lighting="light kit")
    plotter.set_background("white")
    by_size = sorted(solids, key=lambda layer: -solids[layer].volume)
    for layer, whole in solids.items():
        plotter.add_mesh(
            # walls may overlap where nothing models their contact: no two cuts may coincide, and
            # the thinnest layer must stay visible
            cut_open(whole, 0.002 * by_size.index(layer)),
            color=style.layer_colour(layer, tuple(solids)),
            label=f" {style.LAYER_LABELS.get(layer, layer)}",
            smooth_shading=True,
            split_sharp_edges=True,
            feature_angle=40.0,
            ambient=0.25,
            specular=0.15,
        )
    plotter.add_legend(bcolor=None, face="rectangle", size=(0.1, 0.12), loc="lower right")
    plotter.add_text(f"t_n = {times[at]:.4f}", font_size=12, color=style.INK)
    plotter.camera_position = [(4.0, -4.0, 3.6), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)]
    plotter.reset_camera()
    plotter.camera.zoom(1.35)
    plotter.enable_anti_aliasing("ssaa")
    plotter.screenshot(str(out))
    plotter.close()


if __name__ == "__main__":
    folder, picture, *time = sys.argv[1:]
    draw(Path(folder), Path(picture), float(time[0]) if time else None)
