"""Material meridians.

What matters: they run from the apex to the bottom in the plane of their azimuth, carry each
region's own faces up to the interface, and are at the distance of the layers' thickness.
"""

import numpy as np
import pytest

from opticcup_fem.sections import Meridians, meridian
from opticcup_fem.snapshot import Snapshot
from tests.support.shapes import ALPHA, cup, cup_profile, deformed, sphere_mesh


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    """Return the unit sphere, thickness 0.2, ECM 0.02."""
    return sphere_mesh(0.2)


@pytest.mark.parametrize("phi", [0.0, 1.1, 4.0])
def test_meridian_of_a_cup_follows_its_profile(sphere: Snapshot, phi: float) -> None:
    """Points lie at the profile's radius and height, in the half plane of the azimuth."""
    section = meridian(deformed(sphere, cup), phi)
    assert section.phi == phi
    for part in section.parts.values():
        r, z = cup_profile(part.theta)
        expected = np.column_stack([r * np.cos(phi), r * np.sin(phi), z])
        np.testing.assert_allclose(part.midsurface, expected, atol=2e-4)


def test_parts_meet_at_the_interface_and_end_at_the_poles(sphere: Snapshot) -> None:
    """Colatitudes run 0 .. alpha .. pi and the middle surface is continuous."""
    parts = meridian(sphere, 0.4).parts
    assert list(parts) == ["cap", "oov"]
    cap, oov = parts["cap"], parts["oov"]
    assert (np.diff(cap.theta) > 0).all()
    assert (np.diff(oov.theta) > 0).all()
    assert [cap.theta[0], cap.theta[-1]] == pytest.approx([0, ALPHA], abs=1e-12)
    assert [oov.theta[0], oov.theta[-1]] == pytest.approx([ALPHA, np.pi], abs=1e-12)
    np.testing.assert_allclose(cap.midsurface[-1], oov.midsurface[0], atol=2e-5)


def test_faces_are_the_layers_of_each_region(sphere: Snapshot) -> None:
    """On the sphere faces lie at the radii of the layers, IOV inside, ECM outside."""
    parts = meridian(sphere, 2.0).parts
    assert parts["cap"].layers == ("iov", "ecm")
    assert parts["oov"].layers == ("oov",)
    for region, radii in (("cap", [0.9, 1.08, 1.1]), ("oov", [0.9, 1.1])):
        found = np.linalg.norm(parts[region].faces, axis=-1)
        np.testing.assert_allclose(found, np.tile(radii, (len(found), 1)), atol=2e-4)


def test_several_meridians_are_those_taken_alone(sphere: Snapshot) -> None:
    """A prepared set of azimuths gives the same sections, for every state."""
    azimuths = [0.0, 0.7, 3.0]
    many = Meridians(sphere, azimuths, 20)
    for state in (sphere, deformed(sphere, cup)):
        for phi, section in zip(azimuths, many(state), strict=True):
            alone = meridian(state, phi, 20)
            for region, part in section.parts.items():
                np.testing.assert_array_equal(part.faces, alone.parts[region].faces)
                np.testing.assert_array_equal(part.midsurface, alone.parts[region].midsurface)
