"""Supports: what they hold, and that they are refused where the mesh has no such place."""

import numpy as np
import pytest

from opticcup_fem.errors import MeshError
from opticcup_fem.mesh import open_cap_mesh, strip_mesh
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.supports import (
    clamped,
    free,
    held_components,
    hinged,
    rigid_modes,
    rigid_modes_of_cup,
)
from tests.support.shells import COMM, cup_shell, strip_shell, wall

ANGLE = 0.9


@pytest.fixture(scope="module")
def cap():
    mesh = open_cap_mesh(ANGLE, 0.45, comm=COMM)
    return Shell(mesh, {"cap": wall()}, {"wall": LinearGrowth(0.0)})


def parts(shell, mask):
    """Held components of the nodes (n, 3), and of the angles (n_edges, k)."""
    n = 3 * shell.spaces.n_nodes
    return mask[:n].reshape(-1, 3), mask[n:].reshape(-1, shell.spaces.degree)


def test_free_holds_nothing(cap):
    mask = free(cap)
    assert mask.size == 3 * cap.spaces.n_nodes + 3 * cap.spaces.n_edges
    assert not mask.any()


def test_hinge_holds_the_nodes_of_the_curve(cap):
    nodes, angles = parts(cap, hinged(cap, "rim"))
    on_rim = np.abs(cap.reference[:, 2] - np.cos(ANGLE)) < 1e-12
    np.testing.assert_array_equal(nodes, np.repeat(on_rim[:, None], 3, axis=1))
    assert not angles.any()


def test_clamp_holds_its_directors_too(cap):
    nodes, angles = parts(cap, clamped(cap, "rim"))
    rim_nodes, _ = parts(cap, hinged(cap, "rim"))
    np.testing.assert_array_equal(nodes, rim_nodes)
    rim = cap.surface_mesh.facet_tags.find(cap.surface_mesh.curves["rim"])
    np.testing.assert_array_equal(np.flatnonzero(angles.all(axis=1)), np.sort(rim))
    assert np.count_nonzero(angles) == 3 * len(rim)
    # every node between two vertices of the rim: a cubic edge has two of its own
    assert np.count_nonzero(nodes.all(axis=1)) == 3 * len(rim)


def test_curves_of_a_strip_are_told_apart():
    shell = strip_shell(wall(), 0.5, 4, 2)
    for curve, axis, value in (("left", 0, 0), ("right", 0, 1), ("bottom", 1, 0), ("top", 1, 0.5)):
        nodes, _ = parts(shell, hinged(shell, curve))
        expected = np.abs(shell.reference[:, axis] - value) < 1e-12
        np.testing.assert_array_equal(nodes[:, 0], expected)


def test_supports_combine(cap):
    apex = held_components(cap, [((0.0, 0.0, 1.0), "xz")])
    nodes, _ = parts(cap, apex)
    top = np.argmax(cap.reference[:, 2])
    assert np.count_nonzero(apex) == 2
    np.testing.assert_array_equal(nodes[top], [True, False, True])
    both = parts(cap, apex | hinged(cap, "rim"))[0]
    assert both[top, 0] and both.sum() == 2 + parts(cap, hinged(cap, "rim"))[0].sum()


def test_cup_is_held_in_six_components():
    shell = cup_shell()
    nodes, angles = parts(shell, rigid_modes_of_cup(shell))
    assert nodes.sum() == 6 and not angles.any()
    held = {tuple(np.round(x, 6)): "".join(np.array(list("xyz"))[row])
            for x, row in zip(shell.reference, nodes, strict=True) if row.any()}  # fmt: skip
    side = (round(np.sin(np.radians(40)), 6), 0.0, round(np.cos(np.radians(40)), 6))
    assert held == {(0.0, 0.0, -1.0): "xyz", (0.0, 0.0, 1.0): "xy", side: "y"}


def test_missing_places_are_refused(cap):
    with pytest.raises(MeshError, match=r"no curve 'interface'.*rim"):
        hinged(cap, "interface")
    with pytest.raises(MeshError, match="mesh the shell with a vertex there"):
        held_components(cap, [((0.0, 0.0, -1.0), "z")])
    flat = Shell(strip_mesh(1.0, 1.0, 2, 2, COMM), {"strip": wall()}, {"wall": LinearGrowth(0.0)})
    with pytest.raises(MeshError, match="no curve"):
        clamped(flat, "rim")


def test_rigid_modes_of_any_shell_are_held_by_long_levers(cap):
    """The six held components of the rigid motions are a matrix far from singular."""
    nodes, angles = parts(cap, rigid_modes(cap))
    assert nodes.sum() == 6 and not angles.any()
    node, component = np.nonzero(nodes)
    arms = cap.reference[node] - cap.reference.mean(axis=0)
    turns = np.stack([np.cross(axis, arms) for axis in np.eye(3)], axis=-1)
    shifts = np.broadcast_to(np.eye(3), turns.shape)
    motions = np.concatenate([shifts, turns], axis=-1)[np.arange(6), component]
    assert np.linalg.cond(motions) < 10
