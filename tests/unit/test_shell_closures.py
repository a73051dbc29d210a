"""Resultants of a layered section under every closure.

What matters: `test_reference_state_is_free_of_stress` fails when a sign of n, b or xi flips, and
`test_stress_varies_the_energy` compares with Psi_0 as it is printed, written here a second time.
"""

import pickle
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import brentq

from opticcup_fem.errors import CaseError
from opticcup_fem.shell import closures
from opticcup_fem.shell.closures import resultants
from opticcup_fem.shell.fibres import GrowthState, LostFibre, fibres, invariants
from opticcup_fem.shell.section import Layer, Section
from tests.support.shells import ENERGY_CLOSURES, OTHER_CLOSURES, cup_sections, wall

Array = npt.NDArray[np.float64]
ALL = tuple(closures.CLOSURES)
K_REF = -1.0  # the unit sphere, n outward
GROWTH = [GrowthState(1.4, 1.96), GrowthState(1.1, 1.21)]
STEP = 1e-6
DIFFERENCES = 1e-8  # error of central differences with STEP, in numbers of order one


def state(n: int = 5, seed: int = 3) -> tuple[Array, Array]:
    """Forms (n, 6) and reference metrics (n, 3), away from any symmetric state."""
    rng = np.random.default_rng(seed)
    a_ref = np.array([1.1, 0.9, 0.1]) + 0.1 * rng.normal(size=(n, 3))
    a = 1.4 * a_ref + 0.1 * rng.normal(size=(n, 3))
    b = K_REF * a_ref + np.array([1.0, -0.4, 0.3]) + 0.2 * rng.normal(size=(n, 3))
    return np.hstack([a, b]), a_ref


def matrix(components: Array) -> Array:
    """(11, 22, 12) as a 2x2 matrix."""
    return np.array([[components[0], components[2]], [components[2], components[1]]])


def psi_0(
    layer: Layer, e: float, xi: float, l_metric: float, l_3: float, form: Array, ref: Array
) -> float:
    """(S8) at height xi of one point, with l_metric in g and l_3 in J and I_1."""
    mu, nu = layer.shear_modulus, layer.poisson_ratio
    lame = 2 * mu * nu / (1 - 2 * nu)
    g = matrix(form[:3]) - 2 * l_metric * xi * matrix(form[3:])
    natural = e**2 * (matrix(ref) - 2 * xi * K_REF * matrix(ref))
    J = np.sqrt(np.linalg.det(g) / np.linalg.det(natural)) * l_3
    I_1 = np.trace(np.linalg.inv(natural) @ g) + l_3**2
    return lame / 4 * (J**2 - 1 - 2 * np.log(J)) + mu / 2 * (I_1 - 3 - 2 * np.log(J))


def plane_stress(
    layer: Layer, e: float, xi: float, l_metric: float, form: Array, ref: Array
) -> float:
    """lambda_3 of Sigma^33 = 0 at height xi, by a root of it."""
    mu, nu = layer.shear_modulus, layer.poisson_ratio
    lame = 2 * mu * nu / (1 - 2 * nu)
    g = matrix(form[:3]) - 2 * l_metric * xi * matrix(form[3:])
    area = np.linalg.det(g) / np.linalg.det(e**2 * (1 - 2 * xi * K_REF) * matrix(ref))
    return brentq(lambda s: lame / 2 * (area * s - 1 / s) + mu * (s - 1 / s), 1e-3, 1e3, xtol=1e-15)


def stretches(closure: str, layer: Layer, e: float, xi: float, form: Array, ref: Array):
    """lambda_3 of a closure at height xi, in the metric and in J and I_1."""
    if closure == "condensed":
        l_metric = 1.0
    elif closure == "layer-stretch":
        l_metric = plane_stress(layer, e, 0.0, 1.0, form, ref)
    elif closure == "closed-form":
        l_metric = plane_stress(layer, e, xi, 1.0, form, ref)
    else:

        def implicit(s: float) -> float:
            return plane_stress(layer, e, xi, s, form, ref) - s

        l_metric = brentq(implicit, 0.2, 4.0, xtol=1e-15)
    held = closure in OTHER_CLOSURES
    return l_metric, l_metric if held else plane_stress(layer, e, xi, l_metric, form, ref)


def density(closure: str, section: Section, form: Array, ref: Array, at: Array | None = None):
    """Energy per reference area at one point; `at`: forms at which lambda_3 is held."""
    total = 0.0
    for layer, (heights, weights), (e, rho, *_) in zip(
        section.layers, section.gauss_points, GROWTH, strict=True
    ):
        for xi, w in zip(heights, weights, strict=True):
            l_metric, l_3 = stretches(closure, layer, e, xi, form if at is None else at, ref)
            total += w * rho * psi_0(layer, e, xi, l_metric, l_3, form, ref)
    return total


@pytest.mark.parametrize("closure", ALL)
def test_reference_state_is_free_of_stress(closure):
    """Energy and stress vanish for a = a_ref, b = k a_ref; flipped signs cost energy."""
    section = cup_sections()["cap"]
    ungrown = [GrowthState(1.0, 1.0)] * 2
    _, a_ref = state()
    for k in (K_REF, 0.0):
        rest = resultants(closure, section, ungrown, np.hstack([a_ref, k * a_ref]), a_ref, k)
        assert np.abs(rest.energy).max() < 1e-14
        assert np.abs(rest.stress).max() < 1e-14
    turned = resultants(closure, section, ungrown, np.hstack([a_ref, -K_REF * a_ref]), a_ref, K_REF)
    assert turned.energy.min() > 0.1


def test_growing_inner_layer_bends_towards_the_normal():
    """Only with the inner layer at xi < 0 and g = a - 2 xi b does its growth ask for b > 0."""
    section = cup_sections()["cap"]
    a_ref = np.array([[1.0, 1.0, 0.0]])
    grown = [GrowthState(1.1, 1.0), GrowthState(1.0, 1.0)]
    flat = resultants("layer-stretch", section, grown, np.hstack([a_ref, 0 * a_ref]), a_ref, 0.0)
    assert flat.stress[0, 3] < 0  # M: the energy falls as b grows
    assert flat.stress[0, 4] == pytest.approx(flat.stress[0, 3], rel=1e-12)


@pytest.mark.parametrize("closure", ALL)
def test_energy_is_the_integral_of_psi_0(closure):
    forms, a_ref = state()
    section = cup_sections()["cap"]
    energy = resultants(closure, section, GROWTH, forms, a_ref, K_REF).energy
    expected = [density(closure, section, f, r) for f, r in zip(forms, a_ref, strict=True)]
    np.testing.assert_allclose(energy, expected, rtol=1e-11)  # roots found to 1e-15


@pytest.mark.parametrize("closure", ALL)
def test_stress_varies_the_energy(closure):
    """The whole energy where there is one; elsewhere with every lambda_3 held (S7)."""
    forms, a_ref = state()
    section = cup_sections()["cap"]
    stress = resultants(closure, section, GROWTH, forms, a_ref, K_REF).stress
    form, ref = forms[0], a_ref[0]
    at = None if closure in ENERGY_CLOSURES else form
    for i, change in enumerate(STEP * np.eye(6)):
        ahead = density(closure, section, form + change, ref, at)
        behind = density(closure, section, form - change, ref, at)
        assert stress[0, i] == pytest.approx((ahead - behind) / (2 * STEP), abs=DIFFERENCES)


@pytest.mark.parametrize("closure", ALL)
def test_tangent_varies_the_stress(closure):
    forms, a_ref = state()
    section = cup_sections()["cap"]

    def stress(change: Array) -> Array:
        return resultants(closure, section, GROWTH, forms + change, a_ref, K_REF, False).stress

    tangent = resultants(closure, section, GROWTH, forms, a_ref, K_REF).tangent
    differences = [(stress(d) - stress(-d)) / (2 * STEP) for d in STEP * np.eye(6)]
    np.testing.assert_allclose(tangent, np.stack(differences, axis=-1), atol=10 * DIFFERENCES)


@pytest.mark.parametrize("closure", ALL)
def test_tangent_is_symmetric_where_there_is_an_energy(closure):
    forms, a_ref = state()
    tangent = resultants(closure, cup_sections()["cap"], GROWTH, forms, a_ref, K_REF).tangent
    skew = np.abs(tangent - tangent.transpose(0, 2, 1)).max() / np.abs(tangent).max()
    assert closures.CLOSURES[closure].has_energy == (closure in ENERGY_CLOSURES)
    if closure in ENERGY_CLOSURES:
        assert skew < 1e-15
    else:
        assert skew > 1e-4


def test_without_a_tangent_the_rest_is_the_same():
    forms, a_ref = state()
    for closure in ALL:
        short = resultants(closure, wall(), GROWTH[:1], forms, a_ref, K_REF, tangent=False)
        full = resultants(closure, wall(), GROWTH[:1], forms, a_ref, K_REF)
        assert short.tangent is None
        np.testing.assert_array_equal(short.energy, full.energy)
        np.testing.assert_array_equal(short.stress, full.stress)


@pytest.mark.parametrize("closure", ALL)
def test_frame_does_not_matter(closure):
    """Components in any other frame of the tangent plane give the same energy."""
    forms, a_ref = state(n=1)
    change = np.array([[1.2, 0.3], [-0.5, 0.8]])

    def turned(components: Array) -> list[float]:
        new = change.T @ matrix(components) @ change
        return [new[0, 0], new[1, 1], new[0, 1]]

    other = np.array([turned(forms[0, :3]) + turned(forms[0, 3:])])
    other_ref = np.array([turned(a_ref[0])])
    section = cup_sections()["cap"]
    here = resultants(closure, section, GROWTH, forms, a_ref, K_REF).energy
    there = resultants(closure, section, GROWTH, other, other_ref, K_REF).energy
    assert there == pytest.approx(here, rel=1e-12)


def test_incompressible_layers_keep_their_volume():
    """At nu = 1/2 Psi_0 is mu/2 (I_1 - 3) with lambda_3 = 1/J_s, and l of the layer likewise."""
    forms, a_ref = state()
    section = cup_sections(poisson_ratio=0.5)["cap"]

    def density(form: Array, ref: Array) -> float:
        total = 0.0
        for layer, growth, (heights, weights) in zip(
            section.layers, GROWTH, section.gauss_points, strict=True
        ):
            e, rho = growth.factor, growth.density_ratio
            l_metric = e**2 * np.sqrt(np.linalg.det(matrix(ref)) / np.linalg.det(matrix(form[:3])))
            for xi, w in zip(heights, weights, strict=True):
                g = matrix(form[:3]) - 2 * l_metric * xi * matrix(form[3:])
                natural = e**2 * (1 - 2 * xi * K_REF) * matrix(ref)
                area = np.linalg.det(g) / np.linalg.det(natural)
                trace = np.trace(np.linalg.inv(natural) @ g) + 1 / area
                total += w * rho * layer.shear_modulus / 2 * (trace - 3)
        return total

    found = resultants("layer-stretch", section, GROWTH, forms, a_ref, K_REF)
    expected = [density(f, r) for f, r in zip(forms, a_ref, strict=True)]
    np.testing.assert_allclose(found.energy, expected, rtol=1e-12)
    for i, change in enumerate(STEP * np.eye(6)):
        slope = (density(forms[0] + change, a_ref[0]) - density(forms[0] - change, a_ref[0])) / (
            2 * STEP
        )
        assert found.stress[0, i] == pytest.approx(slope, abs=DIFFERENCES)
    state_5 = closures.fibre_state(
        "layer-stretch",
        invariants(forms, a_ref),
        next(fibres(section, GROWTH, K_REF)),
    )
    np.testing.assert_allclose(state_5.stretch * np.sqrt(state_5.area_ratio), 1.0, rtol=1e-14)


@pytest.mark.parametrize("closure", ENERGY_CLOSURES)
def test_the_incompressible_limit_is_continuous(closure):
    """Energy, stress and tangent differ from those at nu = 1/2 in proportion to 1/2 - nu."""
    forms, a_ref = state()

    def at(poisson: float):
        section = cup_sections(poisson_ratio=poisson)["cap"]
        return resultants(closure, section, GROWTH, forms, a_ref, K_REF)

    limit = at(0.5)
    gaps = (1e-3, 1e-4, 1e-5)
    for name in ("energy", "stress", "tangent"):
        away = [np.abs(getattr(at(0.5 - g), name) - getattr(limit, name)).max() for g in gaps]
        assert away[0] > 1e-4
        np.testing.assert_allclose(away, away[0] * np.array([1, 0.1, 0.01]), rtol=0.05)


def test_the_incompressible_tangent_varies_the_stress():
    forms, a_ref = state()
    section = cup_sections(poisson_ratio=0.5)["cap"]

    def stress(change: Array) -> Array:
        return resultants(
            "layer-stretch", section, GROWTH, forms + change, a_ref, K_REF, False
        ).stress

    tangent = resultants("layer-stretch", section, GROWTH, forms, a_ref, K_REF).tangent
    differences = [(stress(d) - stress(-d)) / (2 * STEP) for d in STEP * np.eye(6)]
    np.testing.assert_allclose(tangent, np.stack(differences, axis=-1), atol=10 * DIFFERENCES)


def test_closures_agree_without_poisson_effect():
    """Without it lambda_3 = 1 everywhere, and all readings are one."""
    forms, a_ref = state()
    section = cup_sections(poisson_ratio=0.0)["cap"]
    results = [resultants(c, section, GROWTH, forms, a_ref, K_REF) for c in ALL]
    for other in results[1:]:
        for mine, yours in zip(results[0], other, strict=True):
            np.testing.assert_allclose(mine, yours, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("closure", ALL)
def test_identical_layers_equal_one(closure):
    """Three layers of h/3 are one of h, up to the quadrature in xi."""
    forms, a_ref = state()
    one = Section([Layer("one", 0.3, 2.0, 0.4, 12)])
    three = Section([Layer(name, 0.1, 2.0, 0.4, 10) for name in "abc"])
    whole = resultants(closure, one, GROWTH[:1], forms, a_ref, K_REF)
    split = resultants(closure, three, GROWTH[:1] * 3, forms, a_ref, K_REF)
    for mine, yours in zip(whole, split, strict=True):
        np.testing.assert_allclose(mine, yours, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("closure", ALL)
def test_every_parameter_changes_the_tangent(closure):
    """A parameter that is read but not used in the tangent would pass the tests by differences."""
    forms, a_ref = state()
    base = {"thickness": 0.2, "mu": 1.0, "nu": 0.4, "e": 1.2, "rho": 1.44, "k": K_REF}

    def tangent(**changed: float) -> Array:
        p = base | changed
        section = Section([Layer("wall", p["thickness"], p["mu"], p["nu"], 5)])
        growth = [GrowthState(p["e"], p["rho"])]
        result = resultants(closure, section, growth, forms, a_ref, p["k"]).tangent
        assert result is not None
        return result

    start = tangent()
    for name, value in base.items():
        change = np.abs(tangent(**{name: 1.01 * value}) - start).max()
        assert change > 1e-4 * np.abs(start).max(), name


@pytest.mark.parametrize("closure", ALL)
def test_fields_of_growth_act_point_by_point(closure):
    """Growth given as an array is that of each point."""
    forms, a_ref = state()
    e = np.linspace(1.0, 1.5, len(forms))
    field = resultants(closure, wall(), [GrowthState(e, e**2)], forms, a_ref, K_REF)
    for i, value in enumerate(e):
        growth = [GrowthState(value, value**2)]
        one = resultants(closure, wall(), growth, forms[[i]], a_ref[[i]], K_REF)
        for mine, yours in zip(field, one, strict=True):
            np.testing.assert_allclose(mine[i], yours[0], rtol=1e-13, atol=1e-15)


def bent(amount: float, both: bool, n: int = 4, at: int = 2) -> tuple[Array, Array]:
    """Flat points, of which one has the curvature ``amount`` in one direction or in both."""
    forms = np.tile([1.0, 1.0, 0.0, 0.0, 0.0, 0.0], (n, 1))
    forms[at, 3:5] = amount, amount if both else 0.0
    return forms, forms[:, :3].copy()


@pytest.mark.parametrize("closure", ALL)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_fibre_turned_inside_out_is_reported(closure, sign):
    """Point, layer and height of the outermost fibre on the inner side of the bend."""
    section = Section([Layer("low", 0.1, 1.0, 0.3, 3), Layer("high", 0.1, 1.0, 0.3, 4)])
    forms, a_ref = bent(12.0 * sign, both=False)  # 1/12 is within h/2 of the mid-surface
    with pytest.raises(LostFibre) as caught:
        resultants(closure, section, [GrowthState(1.0, 1.0)] * 2, forms, a_ref, 0.0)
    lost = caught.value
    layer = section.layers[1 if sign > 0 else 0]
    assert (lost.index, lost.layer) == (2, layer.name)
    assert lost.height in section.gauss_points[1 if sign > 0 else 0][0]
    assert lost.height * sign > 0
    if closure != "paper":  # whose root is lost before the metric is
        assert lost.cause == "metric"
        assert 1 - 2 * 12.0 * abs(lost.height) < 0


@pytest.mark.parametrize("closure", ENERGY_CLOSURES)
def test_fibre_turned_inside_out_twice_is_reported(closure):
    forms, a_ref = bent(12.0, both=True)
    with pytest.raises(LostFibre) as caught:
        resultants(closure, wall(), [GrowthState(1.0, 1.0)], forms, a_ref, 0.0)
    assert (caught.value.index, caught.value.cause) == (2, "metric")


def test_lost_root_of_the_paper_closure_is_reported():
    """D = 1 - 2 xi b lambda_3(D) at xi = 0.09: no root from b = 2.6 on, although 1 - 2 xi b > 0."""
    section = wall(thickness=0.2, poisson_ratio=0.45)
    forms, a_ref = bent(3.4, both=False)
    with pytest.raises(LostFibre) as caught:
        resultants("paper", section, [GrowthState(1.0, 1.0)], forms, a_ref, 0.0)
    assert (caught.value.index, caught.value.layer, caught.value.cause) == (2, "wall", "root")
    assert caught.value.height in section.gauss_points[0][0]
    resultants("layer-stretch", section, [GrowthState(1.0, 1.0)], forms, a_ref, 0.0)


def test_lost_fibre_survives_pickling():
    """Ranks exchange it."""
    lost = pickle.loads(pickle.dumps(LostFibre(7, "oov", -0.1, "root")))
    assert (lost.index, lost.layer, lost.height, lost.cause) == (7, "oov", -0.1, "root")
    assert "oov" in str(lost)


def test_section_stacks_layers_from_inside():
    section = cup_sections(thickness=0.2)["cap"]
    assert [layer.name for layer in section.layers] == ["iov", "ecm"]
    np.testing.assert_allclose(section.boundaries, [-0.1, 0.08, 0.1], atol=1e-16)
    heights, weights = (np.concatenate(part) for part in zip(*section.gauss_points, strict=True))
    assert np.all(np.diff(heights) > 0)
    assert weights.sum() == pytest.approx(section.thickness, rel=1e-14)
    assert (weights * heights).sum() == pytest.approx(0.0, abs=1e-16)


@pytest.mark.parametrize(
    "values",
    [
        {"thickness": 0.0},
        {"shear_modulus": -1.0},
        {"points": 0},
        {"poisson_ratio": 0.5001},
        {"poisson_ratio": -1.0},
        {"thickness": float("nan")},
    ],
)
def test_meaningless_layers_are_refused(values):
    good = {"thickness": 0.1, "shear_modulus": 1.0, "poisson_ratio": 0.3, "points": 3}
    with pytest.raises(CaseError, match=next(iter(values))):
        Layer("wall", **(good | values))


def test_sections_need_layers_of_different_names():
    layer = Layer("wall", 0.1, 1.0, 0.3, 3)
    with pytest.raises(CaseError, match="different names"):
        Section([layer, layer])
    with pytest.raises(CaseError, match="one or more"):
        Section([])


@pytest.mark.parametrize("closure", ALL)
def test_factors_on_modulus_and_thickness_make_another_layer(closure):
    """Uneven layers, point by point, are those of a section of their own."""
    section = cup_sections()["cap"]
    stiffness = np.linspace(0.5, 2.0, 4)
    thickness = np.linspace(0.8, 1.3, 4)
    growth = [one._replace(stiffness=stiffness, thickness=thickness[::-1]) for one in GROWTH]
    rng = np.random.default_rng(3)
    a_ref = np.tile([1.0, 1.1, 0.1], (4, 1))
    forms = np.concatenate([1.4 * a_ref, -0.6 * a_ref], axis=1) + 0.02 * rng.normal(size=(4, 6))
    found = resultants(closure, section, growth, forms, a_ref, K_REF)
    for k in range(4):
        layers = [
            replace(
                one,
                shear_modulus=one.shear_modulus * stiffness[k],
                thickness=one.thickness * thickness[::-1][k],
            )
            for one in section.layers
        ]
        expected = resultants(
            closure, Section(layers), GROWTH, forms[k : k + 1], a_ref[k : k + 1], K_REF
        )
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one[k : k + 1], other, rtol=1e-11, atol=1e-13)
