"""The least distance between parts of a shell, thickness counted.

What matters: it is signed and exact for pressed spheres, counts the half thickness of the side that
faces the other part, and names the parts.
"""

import numpy as np
import pytest

from opticcup_fem.contact.touch import TouchMeter
from opticcup_fem.snapshot import Snapshot
from tests.support.shapes import ALPHA, deformed, sphere_mesh, sphere_points, with_layers
from tests.unit.test_contact import H, dimple


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    return sphere_mesh(0.2)


@pytest.fixture(scope="module")
def meter(sphere: Snapshot) -> TouchMeter:
    return TouchMeter(sphere, 0.1)


@pytest.mark.parametrize("gap", [0.02, 0.0, -0.02])
def test_gap_is_signed(sphere: Snapshot, meter: TouchMeter, gap: float) -> None:
    """Apex over bottom, apart or overlapping; both inner faces face each other."""
    found = meter(with_layers(dimple(sphere, gap), H))
    assert found is not None
    assert found.gap == pytest.approx(gap, abs=1.5e-3)
    fields = found.describe(ALPHA)
    assert fields["parts"] in ("apex against bottom", "cap against bottom")
    assert fields["faces"] == ["inner", "inner"]
    assert np.linalg.norm(fields["position"]) == pytest.approx(1 - H / 2 - gap / 2, abs=3e-3)


def test_thickness_counts_on_its_side(sphere: Snapshot, meter: TouchMeter) -> None:
    """Outer faces thicker than inner ones leave the gap between inner faces as it is."""
    state = with_layers(dimple(sphere, 0.02), H)
    for faces in state.faces.values():
        middle = (faces[:, :, :1] + faces[:, :, -1:]) / 2
        faces[:, :, 1:] += 0.5 * (faces[:, :, 1:] - middle)
    assert meter(state).gap == pytest.approx(0.02, abs=1.5e-3)
    for faces in state.faces.values():
        faces[:, :, 0] += 0.2 * (faces[:, :, 0] - faces[:, :, -1])
    assert meter(state).gap == pytest.approx(0.02 - 2 * 0.2 * 1.25 * H, abs=1.5e-3)


def test_nothing_is_near_on_a_sphere(sphere: Snapshot, meter: TouchMeter) -> None:
    assert meter(with_layers(sphere, H)) is None


def test_outer_faces_meet_where_the_surface_turns_back(sphere: Snapshot, meter: TouchMeter) -> None:
    """A bent tube-like sphere, a banana: its outer faces meet at the two ends."""

    def banana(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        points = sphere_points(theta, phi) * [0.35, 0.35, 1.0]
        angle = 3.11 * points[:, 2]
        radius = 1.0 + points[:, 0]
        return np.column_stack([radius * np.cos(angle), points[:, 1], radius * np.sin(angle)])

    found = meter(with_layers(deformed(sphere, banana), H))
    assert found is not None
    assert found.describe(ALPHA)["parts"] == "apex against bottom"
    assert found.inside == (False, False)
