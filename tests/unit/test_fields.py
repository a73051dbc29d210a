"""Field files for ParaView.

What matters: VTK reads them as cubic cells, in its own order of nodes (checked by what it makes of
them: areas, normals, values between nodes), whatever the handedness of our cells.
"""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from scipy.integrate import quad
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import reference, vtkIdList, vtkPoints
from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid
from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

from opticcup_fem.fields import write_collection, write_fields
from opticcup_fem.records import RunFolder
from opticcup_fem.snapshot import Snapshot, cell_values
from tests.support.series import FIELDS, MODES, area, read_series
from tests.support.shapes import cup, cup_profile, deformed, sphere_mesh


@pytest.fixture(scope="module")
def state() -> Snapshot:
    """Return a cup with layers."""
    return deformed(sphere_mesh(0.25), cup, t_n=0.25)


@pytest.fixture(scope="module")
def grid(state: Snapshot, tmp_path_factory: pytest.TempPathFactory) -> vtkUnstructuredGrid:
    """Return the written file as VTK reads it."""
    path = tmp_path_factory.mktemp("fields") / "state.vtu"
    write_fields(path, state)
    assert [file.name for file in path.parent.iterdir()] == ["state.vtu"]
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    return reader.GetOutput()


def point_data(grid: vtkUnstructuredGrid, name: str) -> np.ndarray:
    """Return a point field by name."""
    return vtk_to_numpy(grid.GetPointData().GetArray(name))


def triangles_of(grid: vtkUnstructuredGrid, cell: int) -> np.ndarray:
    """Return the flat triangles into which VTK cuts a cell, shape (k, 3, 3)."""
    ids, points = vtkIdList(), vtkPoints()
    grid.GetCell(cell).Triangulate(0, ids, points)
    return vtk_to_numpy(points.GetData()).reshape(-1, 3, 3)


def test_cells_are_cubic_lagrange_triangles(grid: vtkUnstructuredGrid, state: Snapshot) -> None:
    """Cell type 69, ten points a cell, degree three."""
    assert grid.GetNumberOfCells() == len(state.cells)
    assert grid.GetNumberOfPoints() == 10 * len(state.cells)
    assert {grid.GetCellType(k) for k in range(grid.GetNumberOfCells())} == {69}
    assert grid.GetCell(0).GetOrder() == 3


def test_area_is_the_cups(grid: vtkUnstructuredGrid) -> None:
    """The flat triangles between VTK's nodes have the area of the surface of revolution."""

    def ring(theta: float) -> float:
        step = 1e-5
        (r1, z1), (r2, z2) = cup_profile(theta - step), cup_profile(theta + step)
        return float(2 * np.pi * cup_profile(theta)[0] * np.hypot(r2 - r1, z2 - z1) / (2 * step))

    exact = quad(ring, 0, np.pi)[0]
    pieces = np.concatenate([triangles_of(grid, k) for k in range(grid.GetNumberOfCells())])
    sides = pieces[:, 1:] - pieces[:, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum() / 2
    assert len(pieces) == 9 * grid.GetNumberOfCells()
    # nodes in a wrong order fold triangles over and double the area
    assert area == pytest.approx(exact, rel=6e-3)
    assert area < exact


def test_cells_wind_outwards(grid: vtkUnstructuredGrid) -> None:
    """Every small triangle's normal points away from the shell's inner face."""
    outward = point_data(grid, "boundary_2")
    for cell in range(0, grid.GetNumberOfCells(), 7):
        pieces = triangles_of(grid, cell)
        normals = np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0])
        assert (normals @ outward[10 * cell + 9] > 0).all()


def test_vtk_interpolates_as_we_do(grid: vtkUnstructuredGrid, state: Snapshot) -> None:
    """VTK's position at a parametric point of a cell lies on our cubic surface."""
    for k in (0, 5, 40):
        cell = grid.GetCell(k)
        found = [0.0] * 3
        cell.EvaluateLocation(reference(0), [0.2, 0.3, 0.0], found, [0.0] * 10)
        # VTK's second and third corner are ours, or exchanged
        point = [[0.2, 0.3]] if state.orientation[k] > 0 else [[0.3, 0.2]]
        expected = cell_values(state.position, state.cells[[k]], point)[0]
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_fields_belong_to_their_nodes(grid: vtkUnstructuredGrid, state: Snapshot) -> None:
    """Values at a point are those of the cell's node that lies there."""
    node = point_data(grid, "node")
    np.testing.assert_array_equal(vtk_to_numpy(grid.GetPoints().GetData()), state.position[node])
    np.testing.assert_array_equal(point_data(grid, "position"), state.position[node])
    moved = state.position[node] - state.reference[node]
    np.testing.assert_allclose(point_data(grid, "displacement"), moved, atol=1e-15)
    region = vtk_to_numpy(grid.GetCellData().GetArray("region"))
    np.testing.assert_array_equal(region, state.region)


def test_layers_are_where_they_are(state: Snapshot, tmp_path: Path) -> None:
    """Stretch and stress of a layer at each point, NaN elsewhere; faces as offsets."""
    rng = np.random.default_rng(0)
    stretch = {k: v * rng.uniform(1, 2, v.shape) for k, v in state.thickness_stretch.items()}
    stress = {k: v + rng.normal(size=v.shape) for k, v in state.stress.items()}
    write_fields(tmp_path / "a.vtu", replace(state, thickness_stretch=stretch, stress=stress))
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(tmp_path / "a.vtu"))
    reader.Update()
    grid = reader.GetOutput()
    node = point_data(grid, "node").reshape(-1, 10)
    for layer in ("iov", "ecm", "oov"):
        found = point_data(grid, f"lambda_3_{layer}").reshape(-1, 10)
        found_stress = point_data(grid, f"stress_{layer}").reshape(-1, 10, 3)
        for k in range(0, len(node), 11):
            place = [list(state.cells[k]).index(n) for n in node[k]]
            np.testing.assert_array_equal(found[k], stretch[layer][k, place])
            np.testing.assert_array_equal(found_stress[k], stress[layer][k, place])
        inner = vtk_to_numpy(grid.GetCellData().GetArray(f"inner_face_{layer}"))
        np.testing.assert_array_equal(inner >= 0, np.isfinite(stretch[layer]).all(axis=1))
    # thickness .2 in all, ECM .02 of it outside
    sizes = [np.linalg.norm(point_data(grid, f"boundary_{k}"), axis=1) for k in range(3)]
    cap = np.repeat(state.region == 1, 10)
    np.testing.assert_allclose(sizes[0], 0.1, atol=1e-12)
    np.testing.assert_allclose(sizes[1][cap], 0.08, atol=1e-12)
    np.testing.assert_allclose(sizes[2], 0.1, atol=1e-12)


def test_collection_lists_times_and_files(tmp_path: Path) -> None:
    """Times survive to the last digit."""
    times = [(0.0, "fields/a.vtu"), (0.1 + 0.2, "fields/b & c.vtu")]
    write_collection(tmp_path / "x.pvd", times)
    root = ET.parse(tmp_path / "x.pvd").getroot()
    found = [(float(d.get("timestep")), d.get("file")) for d in root.iter("DataSet")]
    assert found == times


def test_time_series_open_as_in_paraview(state: Snapshot, tmp_path: Path) -> None:
    """Positions, layers and modes of every time, read by the reader that ParaView uses."""
    grown = deformed(state, lambda t, p: 1.5 * cup(t, p), t_n=0.5)
    mode = np.random.default_rng(1).normal(size=state.position.shape)
    with RunFolder(tmp_path, "") as folder:
        folder.write_fields(state)
        folder.write_fields(grown)
        folder.write_mode_fields(grown, mode)
    series = read_series(tmp_path, FIELDS)
    assert list(series) == [0.25, 0.5]
    areas = [area(grid) for grid in series.values()]
    assert areas[1] == pytest.approx(1.5**2 * areas[0], rel=1e-6)
    ((t_n, modes),) = read_series(tmp_path, MODES).items()
    assert t_n == 0.5
    np.testing.assert_array_equal(modes.point_data["mode"], mode[modes.point_data["node"]])
