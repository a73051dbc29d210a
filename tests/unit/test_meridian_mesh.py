"""Profiles and meshes of meridians: geometry, grading, tables."""

from __future__ import annotations

import math

import numpy as np
import pytest

from opticcup_fem.errors import CaseError, MeshError
from opticcup_fem.meridian.mesh import Grading, MeridianMesh
from opticcup_fem.meridian.profile import ClosedSphere, Disc, OpenCap, Profile
from tests.support.meridians import PROFILES

ALPHA = math.radians(40)


@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)
def test_profile_is_parametrised_by_arc_length_with_its_own_angle(profile: Profile) -> None:
    end = max(high for _, high in profile.regions.values())
    s, step = np.linspace(0.1 * end, 0.9 * end, 7), 1e-6
    tangent = (profile.position(s + step) - profile.position(s - step)) / (2 * step)
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, atol=1e-9)
    np.testing.assert_allclose(
        np.arctan2(tangent[:, 1], tangent[:, 0]), profile.angle(s), atol=1e-8
    )
    turn = (profile.angle(s + step) - profile.angle(s - step)) / (2 * step)
    np.testing.assert_allclose(turn, profile.curvature, atol=1e-9)


def test_poles_lie_on_the_axis() -> None:
    assert MeridianMesh(PROFILES["closed"]).is_pole[[0, -1]].all()
    assert list(MeridianMesh(PROFILES["open"]).is_pole[[0, -1]]) == [True, False]
    sphere = ClosedSphere(ALPHA, 2.0)
    np.testing.assert_allclose(
        sphere.position(np.array([0, 2 * math.pi])), [[0, 2], [0, -2]], atol=1e-15
    )


def test_the_interface_is_a_vertex_between_fine_cells() -> None:
    mesh = MeridianMesh(ClosedSphere(ALPHA))
    first = mesh.region["oov"][0]
    assert mesh.vertices[first] == pytest.approx(ALPHA, abs=1e-15)
    assert list(mesh.region["cap"]) == list(range(first))
    np.testing.assert_allclose(mesh.sizes[[first - 1, first]], 0.005, rtol=0.3)
    assert mesh.sizes.max() <= 0.12
    ratios = mesh.sizes[1:] / mesh.sizes[:-1]
    assert np.max(np.maximum(ratios, 1 / ratios)) < 1.6


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_tables_differentiate_polynomials_exactly(degree: int) -> None:
    mesh = MeridianMesh(Disc(1.0), degree=degree)
    x = np.array([0.1, 0.6, 1.0])
    table = mesh.tabulate(x, 2)
    points = mesh.points(x)
    for order, exact in enumerate(
        (
            points**degree,
            degree * points ** (degree - 1),
            degree * (degree - 1) * points ** (degree - 2),
        )
    ):
        values = np.einsum("cqn,cn->cq", table[order], mesh.s[mesh.cells] ** degree)
        np.testing.assert_allclose(values, exact, atol=1e-9 * 10**order)


@pytest.mark.parametrize(
    "make", [lambda: ClosedSphere(0.0), lambda: OpenCap(1.0, -1.0), lambda: Disc(math.nan)]
)
def test_profiles_without_meaning_are_refused(make: object) -> None:
    with pytest.raises(CaseError):
        make()  # type: ignore[operator]


def test_meshes_without_meaning_are_refused() -> None:
    with pytest.raises(MeshError, match="make no mesh"):
        Grading(growth=1.0)
    with pytest.raises(MeshError, match="at least 2"):
        MeridianMesh(Disc(1.0), degree=1)
