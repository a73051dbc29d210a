"""The critical modes of a surface run: each on its state, and its spectrum on the interface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from opticcup_fem.plots import style
from opticcup_fem.records import CRITICAL, CRITICAL_PICTURE

Array = NDArray[np.float64]

_BUMP = 0.12
"""Largest displacement of the drawn mode, over the largest extent of the state."""

_ROW = 3.0
"""Height of one mode's row, inches."""


@style.styled
def critical(run_dir: str | Path) -> Path:
    """Draw critical.png from the critical.npz of a run, one row a critical point; return its path.

    Args:
        run_dir: The run's folder.
    """
    run_dir = Path(run_dir)
    with np.load(run_dir / CRITICAL) as file:
        arrays = dict(file)
    count = len(arrays["t_n"])
    figure = Figure(figsize=(7.5, _ROW * count), layout="constrained")
    grid = figure.add_gridspec(count, 2, width_ratios=(1.2, 1.0))
    for i in range(count):
        shape = figure.add_subplot(grid[i, 0], projection="3d", computed_zorder=False)
        _draw_mode(shape, arrays["position"][i], arrays["mode"][i], arrays["triangles"])
        m, t_n = int(arrays["wavenumber"][i]), float(arrays["t_n"][i])
        kind = style.EVENT_MARKERS[str(arrays["kind"][i])][1]
        shape.set_title(f"{kind}, $t_n$ = {t_n:.4f}: critical mode m = {m}")
        _draw_spectrum(figure.add_subplot(grid[i, 1]), arrays["interface"][i])
    return style.save(figure, run_dir / CRITICAL_PICTURE)


def _draw_mode(axes: Any, position: Array, mode: Array, triangles: NDArray[np.int32]) -> None:
    """Draw the state moved along its mode, coloured by the displacement, seen from above."""
    scale = _BUMP * np.ptp(position, axis=0).max() / np.linalg.norm(mode, axis=1).max()
    moved = position + scale * mode
    size = scale * np.linalg.norm(mode, axis=1)[triangles].mean(axis=1)
    corners = moved[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light = LightSource(azdeg=315, altdeg=50).shade_normals(normals, fraction=0.8)
    colours = colormaps["viridis"](Normalize(0.0, float(size.max()))(size))
    colours[:, :3] *= (0.45 + 0.55 * light)[:, None]
    axes.add_collection3d(Poly3DCollection(corners, facecolors=colours, edgecolors="none"))
    low, high = moved.min(axis=0), moved.max(axis=0)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_box_aspect(high - low, zoom=1.3)
    axes.view_init(elev=45, azim=-60)
    axes.set_axis_off()


def _draw_spectrum(axes: Axes, amplitudes: Array) -> None:
    """Draw the mode's amplitudes on the interface circle against the wavenumber."""
    axes.bar(np.arange(len(amplitudes)), amplitudes, color=style.CURVES[0], width=0.6)
    axes.set_xticks(np.arange(len(amplitudes)))
    axes.set_xlabel("azimuthal wavenumber m")
    axes.set_ylabel("amplitude on the interface")
    axes.set_ylim(0.0, 1.05)
