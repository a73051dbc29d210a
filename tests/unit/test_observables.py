"""Observables of analytic cups.

What matters: depth, heights and radii of a cup whose profile is known, off the nodes as well; no
rigid motion changes any number; a perturbation in one wavenumber shows in that one alone, with its
amplitude.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from opticcup_fem.observables import Observer, mean_peak
from opticcup_fem.snapshot import Snapshot
from tests.support.shapes import (
    ALPHA,
    cup,
    cup_profile,
    deformed,
    revolved,
    sphere_angles,
    sphere_mesh,
    sphere_points,
    with_layers,
)


@pytest.fixture(scope="module")
def sphere() -> Snapshot:
    """Return the unit sphere on cells of size 0.2."""
    return sphere_mesh(0.2)


@pytest.fixture(scope="module")
def observer(sphere: Snapshot) -> Observer:
    """Return its observer."""
    return Observer(sphere)


def highest(function: Callable[[float], float]) -> float:
    """Return the largest value of a function of the colatitude."""
    found = minimize_scalar(lambda t: -function(t), bounds=(0.5, 2.5), method="bounded")
    return float(-found.fun)


def bulged(m: int, size: float) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return the cup with a radial bulge size sin(theta) cos(m phi)."""

    def shape(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        level = sphere_points(np.full_like(phi, np.pi / 2), phi)
        return cup(theta, phi) + size * (np.sin(theta) * np.cos(m * phi))[:, None] * level

    return shape


def test_sphere(sphere: Snapshot, observer: Observer) -> None:
    """The reference state: no depth, height 2, radius 1, the tangent falls by alpha."""
    numbers = observer(sphere)
    assert numbers["D_over_r"] == 0
    assert numbers["depth_over_R"] == 0
    assert numbers["apex_height_over_R"] == pytest.approx(2, abs=1e-12)
    assert numbers["max_radius_over_R"] == pytest.approx(1, abs=1e-4)
    assert numbers["lambda_iov"] == pytest.approx(1, abs=1e-12)
    assert numbers["tangent_angle_interface"] == pytest.approx(ALPHA, abs=5e-3)
    assert numbers["asymmetry"] < 1e-7


def test_uniformly_grown_sphere(sphere: Snapshot, observer: Observer) -> None:
    """Growth by a factor scales lengths and leaves angles and ratios alone."""
    grown = deformed(sphere, lambda t, p: 1.7 * sphere_points(t, p))
    numbers = observer(grown)
    assert numbers["apex_height_over_R"] == pytest.approx(3.4, abs=1e-12)
    assert numbers["max_radius_over_R"] == pytest.approx(1.7, abs=2e-4)
    assert numbers["D_over_r"] == 0
    # the circle moves outwards along the sphere's radius by 0.7, all of it in m = 0
    assert numbers["interface_m0"] == pytest.approx(0.7, abs=2e-4)


def test_cup_of_known_profile(sphere: Snapshot, observer: Observer) -> None:
    """Depth, radius, height and slope of a smooth cup, whose extremes lie between nodes."""
    numbers = observer(deformed(sphere, cup))
    rim, apex = highest(lambda t: cup_profile(t)[1]), cup_profile(0.0)[1]
    r, bottom = highest(lambda t: cup_profile(t)[0]), cup_profile(np.pi)[1]
    assert numbers["depth_over_R"] == pytest.approx(rim - apex, rel=2e-4)
    assert numbers["max_radius_over_R"] == pytest.approx(r, rel=2e-4)
    assert numbers["D_over_r"] == pytest.approx((rim - apex) / r, rel=3e-4)
    assert numbers["apex_height_over_R"] == pytest.approx(apex - bottom, abs=1e-12)
    step = 1e-6
    (r1, z1), (r2, z2) = cup_profile(ALPHA - step), cup_profile(ALPHA + step)
    slope = np.arctan2(z1 - z2, r2 - r1)
    assert slope < -0.4
    assert numbers["tangent_angle_interface"] == pytest.approx(slope, abs=2e-3)


def test_peaks_lie_between_samples() -> None:
    """The mean of the meridians' tops, each better than its best sample; ends count too."""
    theta = np.linspace(0, np.pi, 41)[:, None]
    tops = np.array([1.013, 1.55, 2.491])
    assert mean_peak(2 - (theta - tops) ** 2) == pytest.approx(2, abs=1e-12)
    assert mean_peak(np.cos(theta - tops)) == pytest.approx(1, abs=1e-6)
    assert mean_peak(np.cos(theta) * np.array([1.0, 3.0])) == pytest.approx(2, abs=1e-12)


def test_small_loss_of_symmetry_counts_in_second_order(
    sphere: Snapshot, observer: Observer
) -> None:
    """A bulge cos(2 phi) of one per cent moves the largest radius by 1e-4, not by 1e-2."""
    round_one, bulgy = (observer(deformed(sphere, bulged(2, size))) for size in (0.0, 0.01))
    assert bulgy["max_radius_over_R"] == pytest.approx(round_one["max_radius_over_R"], rel=3e-4)
    assert bulgy["interface_m2"] > 5e-3


def test_rigid_motion_changes_nothing(sphere: Snapshot, observer: Observer) -> None:
    """Turned by a radian and moved, a bulged cup has the same numbers to rounding."""
    state = deformed(sphere, bulged(2, 0.1))
    turn = Rotation.from_rotvec([0.7, 0.6, 0.4]).as_matrix()
    moved = replace(state, position=state.position @ turn.T + [0.3, -0.2, 0.5])
    before, after = observer(state), observer(moved)
    assert after == pytest.approx(before, rel=1e-10, abs=1e-12)
    assert before["asymmetry"] > 1e-3


def test_axis_of_a_tilted_cup(sphere: Snapshot, observer: Observer) -> None:
    """The fitted axis is the tilted one, apex side up."""
    turn = Rotation.from_rotvec([0.0, 0.4, 0.0]).as_matrix()
    state = deformed(sphere, cup)
    frame = observer.frame(replace(state, position=state.position @ turn.T))
    np.testing.assert_allclose(frame.rotation[2], turn[:, 2], atol=1e-4)


@pytest.mark.parametrize("m", [2, 3, 5, 8])
def test_wavenumbers_on_the_interface(sphere: Snapshot, observer: Observer, m: int) -> None:
    """A bulge a sin(theta) cos(m phi) has amplitude a sin(alpha) in m and none in others."""
    size = 0.05
    numbers = observer(deformed(sphere, bulged(m, size)))
    assert numbers[f"interface_m{m}"] == pytest.approx(size * np.sin(ALPHA), rel=5e-3)
    others = [numbers[f"interface_m{k}"] for k in range(1, 9) if k != m]
    assert max(others) < 2e-3 * size


def test_twist_is_axisymmetric(sphere: Snapshot, observer: Observer) -> None:
    """A rotation about the axis that varies with colatitude is m = 0."""
    twisted = deformed(sphere, lambda t, p: cup(t, p + 0.3 * np.cos(t)))
    assert observer(twisted)["asymmetry"] < 1e-6


@pytest.mark.parametrize("size", [1e-3, 1e-2, 0.1])
def test_asymmetry_is_the_share_of_the_energy(
    sphere: Snapshot, observer: Observer, size: float
) -> None:
    """For the bulge the shares are integrals over the sphere, done here by quadrature."""
    u, w = np.polynomial.legendre.leggauss(60)
    theta = np.arccos(u)
    r, z = cup_profile(theta)
    z = z - (w * z).sum() / 2
    round_energy = (w * (r**2 + z**2)).sum() / 2
    bulge_energy = (w * (size * np.sin(theta)) ** 2).sum() / 2 / 2
    expected = bulge_energy / (round_energy + bulge_energy)
    found = observer(deformed(sphere, bulged(3, size)))["asymmetry"]
    assert found == pytest.approx(expected, rel=2e-3, abs=5e-9)


def test_shift_of_one_half_is_asymmetric_but_a_shift_of_all_is_not(
    sphere: Snapshot, observer: Observer
) -> None:
    """Rigid motion is taken out of m = 1, deformation is not."""
    all_of_it = deformed(sphere, lambda t, p: cup(t, p) + np.array([0.2, 0, 0]))
    sheared = deformed(sphere, lambda t, p: cup(t, p) + np.outer(0.2 * np.cos(t) ** 2, [1, 0, 0]))
    assert observer(all_of_it)["asymmetry"] < 1e-7
    assert observer(sheared)["asymmetry"] > 1e-3


def test_stretch_at_the_apex_is_the_mean_over_its_cells(
    sphere: Snapshot, observer: Observer
) -> None:
    """lambda_iov averages the cells that meet at the apex and looks at no others."""
    apex = int(np.argmax(sphere.reference[:, 2]))
    stretch = sphere.thickness_stretch["iov"].copy()
    at = sphere.cells == apex
    stretch[at] = 1.5 + 0.1 * np.arange(at.sum())
    changed = replace(sphere, thickness_stretch={**sphere.thickness_stretch, "iov": stretch})
    assert observer(changed)["lambda_iov"] == pytest.approx(stretch[at].mean(), abs=1e-9)


def test_depth_is_nought_until_there_is_a_dimple(sphere: Snapshot, observer: Observer) -> None:
    """As the apex sinks the depth is 0, then grows as the profile says."""
    depths = []
    for sink in (0.0, 0.2, 0.24, 0.3, 0.4):
        state = deformed(
            sphere,
            lambda t, p, k=sink: revolved(np.sin(t), np.cos(t) - k * (1 + np.cos(t)) ** 2, p),
        )
        depths.append(observer(state)["depth_over_R"])
        # z = c - k (1 + c)^2 has its top at c = 1/(2k) - 1, if that is below 1
        c = min(1.0, 1 / (2 * sink) - 1) if sink else 1.0
        exact = c - sink * (1 + c) ** 2 - (1 - 4 * sink)
        assert depths[-1] == pytest.approx(exact, abs=2e-4)
    assert depths[:3] == [0, 0, 0]
    assert depths[3] > 0.01


def test_radius_is_in_units_of_the_sphere(observer: Observer, sphere: Snapshot) -> None:
    """A sphere of radius 50 has the numbers of the unit sphere."""
    big = with_layers(
        replace(sphere, reference=50 * sphere.reference, position=50 * sphere.position)
    )
    numbers = Observer(big)(big)
    assert numbers == pytest.approx(observer(sphere), abs=1e-9)


def test_angles_of_the_helper() -> None:
    """The helper's angles invert its points."""
    theta, phi = np.array([0.3, 2.0]), np.array([1.0, -2.0])
    np.testing.assert_allclose(sphere_angles(sphere_points(theta, phi)), [theta, phi])
