"""By how much cells turn, against spheres and a rolled sheet."""

from dataclasses import replace

import numpy as np
import pytest

from opticcup_fem.folds import fold_columns
from opticcup_fem.snapshot import NODES, Snapshot
from tests.support.shapes import deformed, revolved, sphere_mesh


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    """Return the unit sphere."""
    return sphere_mesh(0.2)


def sheet(turn: float) -> Snapshot:
    """Return a plane cell of side 1 beside one rolled by an angle over its side along x."""
    first, second = NODES, NODES + np.array([2.0, 0.0])
    flat = np.column_stack([np.concatenate([first, second]), np.full(20, 1.0)])
    x, y, z = flat.T
    s = np.clip(x - 2.0, 0.0, None) * turn
    rolled = np.column_stack([2.0 + np.sin(s) / turn, y, z - (1 - np.cos(s)) / turn])
    position = np.where((x >= 2.0)[:, None], rolled, flat)
    return Snapshot(
        t_n=0.0,
        reference=flat,
        position=position,
        cells=np.arange(20).reshape(2, 10),
        region=np.array([1, 1]),
        orientation=np.ones(2),
        region_ids={"oov": 1},
        layers={"oov": ("oov",)},
        thickness_stretch={},
        stress={},
        faces={},
    )


@pytest.mark.parametrize("degrees", [20.0, 60.0, 90.0])
def test_rolled_sheet_turns_by_its_angle(degrees: float) -> None:
    """A cubic cell follows an arc of a right angle; the flat cell beside it does not turn."""
    columns = fold_columns(sheet(np.deg2rad(degrees)))
    assert columns["turn_in_cell_deg"] == pytest.approx(degrees, rel=0.04)
    x, z = 2.5, 1.0  # the rolled cell was there, a third of its side from y = 0
    assert columns["turn_colatitude_deg"] == pytest.approx(
        np.rad2deg(np.arctan2(np.hypot(x, 1 / 3), z)), abs=3
    )


def test_sphere_turns_by_the_size_of_its_cells(sphere: Snapshot) -> None:
    """Normals are radii: their angles are those between the nodes, wherever it lies."""
    radii = sphere.reference[sphere.cells]
    angles = np.arccos(np.clip(np.einsum("cni,cmi->cnm", radii, radii), -1, 1))
    expected = np.rad2deg(angles.max())
    shrunk = deformed(
        sphere, lambda theta, phi: revolved(0.3 * np.sin(theta), 0.3 * np.cos(theta), phi)
    )
    for snapshot in (sphere, shrunk, replace(shrunk, position=shrunk.position + 1.0)):
        assert fold_columns(snapshot)["turn_in_cell_deg"] == pytest.approx(expected, rel=0.02)


def test_place_is_that_of_the_reference(sphere: Snapshot) -> None:
    """A spheroid a tenth as high as wide is sharpest at its equator, colatitude 90 degrees."""
    flat = deformed(sphere, lambda theta, phi: revolved(np.sin(theta), 0.1 * np.cos(theta), phi))
    columns = fold_columns(flat)
    assert columns["turn_in_cell_deg"] > 60
    assert columns["turn_colatitude_deg"] == pytest.approx(90, abs=8)
