"""Mass balance of a layer: against closed forms, on surface and meridian.

Worth reading: `test_harmonics_decay_on_a_sphere_that_grows`, and
`test_mass_is_kept_through_a_jump`, whose mass is measured on the present surface.
"""

import pickle

import numpy as np
import pytest

from opticcup_fem.errors import UnbalancedLayer
from opticcup_fem.shell.balance import BalanceLaw, Geometry, root_of_metric
from opticcup_fem.stimulus import GROWTH, NO_MASS
from tests.support.shells import rate_of
from tests.support.spheres import (
    Sphere,
    meridian_cap,
    meridian_sphere,
    surface_cap,
    surface_sphere,
)

D = 0.3
DIFFUSION = BalanceLaw(NO_MASS, lambda t_n, points, rho: 0 * rho, lambda t_n, points: D)
SOURCES = {
    "specific": lambda t_n, points, rho: 10 / (1 + 5 * t_n) * rho,
    "logistic": lambda t_n, points, rho: 4 * rho * (1 - rho / 3),
}


def legendre(degree: int, z):
    return np.polynomial.legendre.Legendre.basis(degree)(z)


@pytest.fixture(scope="module")
def meridian() -> Sphere:
    return meridian_sphere(DIFFUSION, 0.15)


@pytest.fixture(scope="module")
def surface() -> Sphere:
    return surface_sphere(DIFFUSION, 0.6)


def still(source) -> Sphere:
    return meridian_sphere(BalanceLaw(GROWTH, source), 0.5)


def test_root_of_a_metric():
    a = np.array([[2.0, 1.5, 0.3], [1.0, 1.0, 0.0], [0.5, 4.0, -1.2]])
    for (u, v, w), (p, q, r) in zip(root_of_metric(a), a, strict=True):
        root = np.array([[u, w], [w, v]])
        np.testing.assert_allclose(root @ root, [[p, r], [r, q]], atol=1e-14)


def test_quadratic_growth_is_found_exactly_whatever_the_shell_does():
    """S proportional to rho: J drops out, and M = (1 + 5 t)^2, so that e = 1 + 5 t."""
    sphere = still(SOURCES["specific"])
    for t_n, radius in ((0.05, 1.3), (0.3, 0.7), (1.0, 2.0)):
        sphere.balance.commit(t_n, sphere.rest(radius))
        np.testing.assert_allclose(sphere.balance.mass["wall"], (1 + 5 * t_n) ** 2, rtol=1e-12)
    between = sphere.balance.mass_at("wall", 0.4)
    np.testing.assert_allclose(between, 9.0, rtol=1e-12)


def test_source_is_per_present_volume():
    """dM/dt = J S with J = (1 + t)^2 and S = 2: M = 1 + 2/3 ((1 + t)^3 - 1)."""
    sphere = still(lambda t_n, points, rho: 2 + 0 * rho)
    J = sphere.layer.sites.volume_ratio(sphere.start)  # 1 but for the interpolation of the mesh
    for steps in (1, 4):
        sphere.begin(np.ones(len(sphere.x)))
        found = sphere.advance(1.0, steps, lambda t: 1 + t)
        np.testing.assert_allclose(found, 1 + 2 / 3 * 7 * J, rtol=1e-12)


def test_nonlinear_source():
    """D rho/dt = 4 rho (1 - rho/3) at rest, order 3."""
    sphere, errors = still(SOURCES["logistic"]), []
    J = sphere.layer.sites.volume_ratio(sphere.start)
    exact = 3 / (1 + 2 * np.exp(-4 * 0.5)) * J
    for steps in (4, 8, 16):
        sphere.begin(J)
        errors.append(np.abs(sphere.advance(0.5, steps) - exact).max())
    assert errors[-1] < 2e-5
    assert 2.8 < rate_of([1 / 4, 1 / 8, 1 / 16], errors) < 3.4


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("model", ["surface", "meridian"])
def test_harmonics_decay_at_their_rates(model, degree, request):
    """On the unit sphere, exp(-l(l+1) D t)."""
    sphere: Sphere = request.getfixturevalue(model)
    wave = 0.2 * legendre(degree, sphere.x[:, 2])
    sphere.begin(1 + wave)
    found = sphere.advance(0.2, 6)
    exact = 1 + wave * np.exp(-degree * (degree + 1) * D * 0.2)
    assert np.sqrt(np.mean((found - exact) ** 2)) < (1e-4 if model == "surface" else 2e-6)
    assert np.abs(found - 1 - wave).max() > 100 * np.abs(found - exact).max()


@pytest.mark.parametrize(
    ("model", "size", "bound"), [(surface_cap, 0.3, 2e-4), (meridian_cap, 0.15, 2e-6)]
)
def test_what_leaves_through_the_edge(model, size, bound):
    """Source S and q = S tan(alpha/2) keep the mass of a cap; rho becomes (2 S/D) ln cos(theta/2).

    That solves D Lap rho + S = 0 with -D rho' = q at the edge, up to the mean.
    """
    S, alpha = 0.5, np.radians(60)
    law = BalanceLaw(
        NO_MASS,
        lambda t_n, points, rho: S + 0 * rho,
        lambda t_n, points: D,
        lambda t_n, places: S * np.tan(alpha / 2) + 0 * places[:, 0],
    )
    cap = model(law, size)
    before = cap.layer.sites.total(np.ones(len(cap.x)))
    cap.begin(np.ones(len(cap.x)))
    found = cap.advance(20.0, 40)
    assert cap.layer.sites.total(found) == pytest.approx(before, rel=bound)
    shape = 2 * S / D * np.log(np.cos(np.arccos(cap.x[:, 2]) / 2))
    mean = cap.layer.sites.total(shape) / before
    np.testing.assert_allclose(found, 1 + shape - mean, atol=20 * bound)
    assert np.ptp(shape) > 0.4


@pytest.mark.parametrize(
    ("model", "sizes"), [(surface_sphere, (0.6, 0.4)), (meridian_sphere, (0.6, 0.3, 0.15))]
)
def test_order_in_space(model, sizes):
    errors = []
    for size in sizes:
        sphere = model(DIFFUSION, size)
        wave = 0.2 * legendre(3, sphere.x[:, 2])
        sphere.begin(1 + wave)
        exact = 1 + wave * np.exp(-12 * D * 0.05)
        errors.append(np.sqrt(np.mean((sphere.advance(0.05, 8) - exact) ** 2)))
    assert rate_of(sizes, errors) > 3.4, errors


def test_order_in_time(meridian):
    wave = 0.2 * legendre(2, meridian.x[:, 2])

    def found(steps):
        meridian.begin(1 + wave)
        return meridian.advance(0.5, steps).copy()

    fine = found(128)
    errors = [np.abs(found(steps) - fine).max() for steps in (4, 8, 16)]
    assert 2.8 < rate_of([1 / 4, 1 / 8, 1 / 16], errors) < 3.2


@pytest.mark.parametrize(("model", "bound"), [("surface", 3e-4), ("meridian", 1e-5)])
def test_harmonics_decay_on_a_sphere_that_grows(model, bound, request):
    """R = 1 + t, of constant thickness: d M/dt = D/R^2 Lap M, and int dt/R^2 = t/(1 + t)."""
    sphere: Sphere = request.getfixturevalue(model)
    wave = 0.2 * legendre(2, sphere.x[:, 2])
    sphere.begin(1 + wave)
    found = sphere.advance(1.0, 8, lambda t: 1 + t)
    exact = 1 + wave * np.exp(-6 * D * 0.5)
    assert np.abs(found - exact).max() < bound
    wrong = 1 + wave * np.exp(-6 * D)  # without the metric
    assert np.abs(found - wrong).max() > 10 * bound


@pytest.mark.parametrize("model", ["surface", "meridian"])
def test_mass_is_kept_through_a_jump(model, request):
    """Whatever the layer's place, and with flux: the integral of rho over the present volume."""
    sphere: Sphere = request.getfixturevalue(model)
    layer = sphere.layer
    sites = layer.sites
    wave = 0.3 * legendre(2, sphere.x[:, 2])
    sphere.begin(1 + wave)
    before = sites.total(1 + wave)
    z = sphere.x[:, 2]
    skew = 0.5 * np.sqrt(sites.area_ref)[:, None] * np.stack([z, -z, z * z], axis=1)
    torn = Geometry(2 * sphere.start.stretch + skew, 0.8 + 0.5 * z)
    sphere.balance.commit(0.02, {"wall": torn})
    step = sphere.balance.past[-1]["wall"]
    assert step.error < 1e-12
    U = torn.stretch
    present = (U[:, 0] * U[:, 1] - U[:, 2] ** 2) / sites.area_ref * torn.thickness
    rho = layer._at_points(step.nodal[1])
    assert sites.total(rho * present) == pytest.approx(before, rel=1e-12)
    assert np.abs(sphere.balance.mass["wall"] - 1 - wave).max() > 1e-3


def test_source_that_takes_all_mass_is_reported_with_its_place():
    sphere = still(lambda t_n, points, rho: -20 * (points.x[:, 2] > 0.9) + 0 * rho)
    sphere.balance.commit(0.04, sphere.rest())
    with pytest.raises(UnbalancedLayer, match=r"wall leaves no mass at t_n = 0\.06") as caught:
        sphere.balance.mass_at("wall", 0.06)
    assert caught.value.position[2] > 0.9
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
    assert sphere.balance.t_n == 0.04
    assert sphere.balance.mass["wall"].min() == pytest.approx(0.2, rel=1e-4)


def test_source_that_grows_beyond_all_bounds_has_no_solution():
    sphere = still(lambda t_n, points, rho: 5 * rho**2)
    sphere.balance.commit(0.1, sphere.rest())
    with pytest.raises(UnbalancedLayer, match="has no solution"):
        sphere.balance.mass_at("wall", 0.4)


def test_a_trial_is_not_the_past(meridian):
    meridian.begin(1 + 0.2 * legendre(2, meridian.x[:, 2]))
    balance = meridian.balance
    start = balance.mass["wall"].copy()
    moved = meridian.rest(1.4)
    trial = balance.mass_at("wall", 0.1)  # at the last known place
    assert balance.settle(0.1, moved)
    turns = 0
    while balance.settle(0.1, moved):
        turns += 1
    assert turns <= 2
    settled = balance.mass_at("wall", 0.1)
    assert np.abs(settled - trial).max() > 1e-3
    np.testing.assert_array_equal(balance.mass_at("wall", 0.0), start)
    balance.forget()
    np.testing.assert_allclose(balance.mass_at("wall", 0.1), trial, rtol=1e-12)
    balance.commit(0.1, moved)
    np.testing.assert_allclose(balance.mass_at("wall", 0.1), settled, rtol=1e-9)


def test_before_the_start_mass_is_carried_on():
    sphere = still(SOURCES["specific"])
    rate = (sphere.balance.mass_at("wall", 1e-6) - sphere.balance.mass_at("wall", -1e-6)) / 2e-6
    np.testing.assert_allclose(rate, 10, rtol=1e-5)
