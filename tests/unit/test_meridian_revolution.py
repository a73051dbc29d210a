"""A meridian turned about its axis: closed surfaces, layers where the sections have them, modes."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest

from opticcup_fem.fields import write_fields
from opticcup_fem.meridian.layers import sections
from opticcup_fem.meridian.revolution import Revolution, rings
from opticcup_fem.meridian.shell import MeridianShell
from opticcup_fem.snapshot import Snapshot, cell_tangents, subdivide
from tests.support.meridians import PROFILES, bent_state, shell_on

T_N = 0.02


@pytest.fixture(scope="module")
def shell() -> MeridianShell:
    return shell_on(PROFILES["closed"])


@pytest.fixture(scope="module")
def bent(shell: MeridianShell) -> Snapshot:
    return Revolution(shell).snapshot(bent_state(shell, 1), T_N)


@pytest.mark.parametrize(
    ("name", "area", "euler"),
    [("closed", 4 * np.pi, 2), ("open", np.pi, 1), ("disc", np.pi, 1)],
)
def test_cells_cover_the_surface_once_and_wind_outwards(name: str, area: float, euler: int) -> None:
    shell = shell_on(PROFILES[name])
    snapshot = Revolution(shell).snapshot(shell.reference_state(), 0.0)
    pieces = subdivide(snapshot.cells, 3)
    points = pieces.matrix @ snapshot.position
    corners = points[pieces.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    # 54 chords around the axis lose 2e-3 of a circle
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(area, rel=3e-3)
    outwards = corners.mean(axis=1) if name != "disc" else np.array([[0.0, 0.0, 1.0]])
    assert np.all(np.sum(normals * outwards, axis=1) > 0)
    edges = np.sort(pieces.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    n_edges = len(np.unique(edges, axis=0))
    assert len(points) - n_edges + len(pieces.triangles) == euler


def test_rings_hold_the_ends_of_regions_and_keep_their_distance(shell: MeridianShell) -> None:
    s, region = rings(shell.mesh, 0.1)
    interface = shell.mesh.vertices[shell.mesh.region["oov"][0]]
    assert interface in s
    np.testing.assert_array_equal(region, s[1:] > interface)
    assert np.diff(s).min() >= 0.1 - 1e-12


def test_layers_are_those_of_the_sections(shell: MeridianShell, bent: Snapshot) -> None:
    """At phi = 0, where both have nodes: mid-surface and faces."""
    state = bent_state(shell, 1)
    (section,) = sections(shell, state, T_N, [0.0])
    for name, part in section.parts.items():
        cells = bent.cells_of(name)
        for k in (0, -1):
            distance = np.linalg.norm(
                bent.position[bent.cells[cells]] - part.midsurface[k], axis=-1
            )
            hits = np.argwhere(distance < 1e-12)
            assert len(hits)
            for cell, node in hits:
                np.testing.assert_allclose(bent.faces[name][cell, node], part.faces[k], atol=1e-12)
    assert np.isnan(bent.stress["iov"][bent.cells_of("oov")]).all()
    assert np.isfinite(bent.stress["iov"][bent.cells_of("cap")]).all()


def test_faces_lie_along_the_normal_of_the_cubic_surface(bent: Snapshot) -> None:
    """Inside first: the ECM's outer face lies outwards of the IOV's inner one."""
    cells = bent.cells_of("cap")
    third = np.full((len(cells), 2), 1 / 3)
    tangents = cell_tangents(bent.position, bent.cells[cells], third)
    normal = np.cross(tangents[:, 0], tangents[:, 1])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    through = bent.faces["cap"][:, 9, -1] - bent.faces["cap"][:, 9, 0]
    through /= np.linalg.norm(through, axis=1, keepdims=True)
    assert np.sum(normal * through, axis=1).min() > 0.995


def test_rigid_motions_are_rigid_in_space(shell: MeridianShell) -> None:
    """(1, -1, 0) in m = 1 is the translation along x, (0, r, 0) in m = 0 the turn about z."""
    surface = Revolution(shell)
    along_x = np.tile([1.0, -1.0, 0.0], (shell.mesh.n_nodes, 1))
    np.testing.assert_allclose(
        surface.wave(along_x, 1), np.tile([1.0, 0.0, 0.0], (len(surface.s), 1)), atol=1e-12
    )
    position = surface.snapshot(shell.reference_state(), 0.0).position
    radius = shell.reference_state().r[:, 0]
    turned = surface.wave(np.stack([0 * radius, radius, 0 * radius], axis=1), 0)
    np.testing.assert_allclose(turned, np.cross([0.0, 0.0, 1.0], position), atol=1e-12)
    tilt = np.stack([-shell.reference_state().r[:, 1], shell.reference_state().r[:, 1], radius], 1)
    turn = np.cross([0.0, -1.0, 0.0], position)
    np.testing.assert_allclose(surface.wave(tilt, 1), turn, atol=2e-3)


def test_field_files_are_those_of_the_surface_model(bent: Snapshot, tmp_path: Path) -> None:
    mode = np.ones_like(bent.position)
    write_fields(tmp_path / "state.vtu", bent, {"mode": mode})
    grid = meshio.read(tmp_path / "state.vtu")
    assert grid.cells[0].type == "VTK_LAGRANGE_TRIANGLE"
    names = {"position", "displacement", "node", "mode", *(f"boundary_{k}" for k in range(3))}
    for layer in ("iov", "ecm", "oov"):
        names |= {f"lambda_3_{layer}", f"stress_{layer}"}
    assert set(grid.point_data) == names
    np.testing.assert_array_equal(grid.point_data["mode"], 1.0)
    np.testing.assert_allclose(grid.points, bent.position[grid.point_data["node"]])
