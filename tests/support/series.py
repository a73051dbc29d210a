"""The time series of a run folder as ParaView's own reader (VTK) sees them."""

import warnings
from pathlib import Path

import numpy as np
import pyvista

MODES, FIELDS = "modes.pvd", "fields.pvd"


def read_series(folder: Path, name: str) -> dict[float, pyvista.UnstructuredGrid]:
    """Return the data sets of a collection by time, each complete and finite where it should be."""
    reader = pyvista.get_reader(folder / name)
    series = {}
    for t_n in reader.time_values:
        reader.set_active_time_value(t_n)
        (grid,) = reader.read()
        whole = ["position", "displacement", "boundary_0", "node"]
        for field in whole + ["mode"] * (name == MODES):
            assert np.isfinite(grid.point_data[field]).all(), field
        for layer in ("ecm", "iov", "oov"):
            for quantity in ("lambda_3", "stress"):
                values = grid.point_data[f"{quantity}_{layer}"]
                assert np.isfinite(values).any() and (quantity == "stress" or np.nanmin(values) > 0)
        np.testing.assert_array_equal(grid.points, grid.point_data["position"])
        series[t_n] = grid
    return series


def area(grid: pyvista.UnstructuredGrid) -> float:
    """Return the area of the middle surface as VTK draws it, with curved cells."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PyVista announces another default
        return float(grid.extract_surface(nonlinear_subdivision=3).area)
