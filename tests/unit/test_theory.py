"""Closed forms of the paper.

Worth reading: (S17), (S18) against a symbolic minimisation of (S16) that shares nothing with the
package, and the loads (S14) against a derivative of the energy (S13). Both fix the signs of kappa,
b and xi.
"""

import dataclasses
import doctest
import importlib
import math

import numpy as np
import pytest
import sympy as sp

from opticcup_fem import theory
from opticcup_fem.case import parse_case

M, N, NU = 1 / 9, 50.0, 0.45
ALPHA = math.radians(40)
# e_1, e_2, m, n, rho_1, rho_2: growing inside, growing outside, shrinking, mass change off
BILAYERS = [
    (1.0, 1.5, 1 / 9, 50.0, 1.0, 2.25),
    (1.0, 6.0, 1 / 9, 50.0, 1.0, 36.0),
    (2.0, 1.3, 0.7, 0.2, 4.0, 1.69),
    (0.6, 0.9, 3.0, 7.0, 0.36, 0.81),
    (1.0, 3.0, 1 / 9, 50.0, 1.0, 1.0),
    (1.2, 1.7, 0.4, 5.0, 1.1, 0.8),
]


# --- natural stretch and curvature, (S16)-(S18)


@pytest.fixture(scope="module")
def minimiser():
    """Lambda^2 and kappa h that minimise (S16) for h/R -> 0, from SymPy's own integrals."""
    metric, bend, xi = sp.symbols("A K xi")
    e_1, e_2, m, n, rho_1, rho_2 = symbols = sp.symbols("e1 e2 m n rho1 rho2", positive=True)
    split = sp.Rational(1, 2) - m / (1 + m)  # h = 1, the outer layer is the upper one

    def layer(e, stiffness, bottom, top):
        # Isotropic strain over the grown metric e^2 a_ref; b = K a_ref, g = a - 2 xi b.
        strain = (metric - 2 * xi * bend - e**2) / e**2
        return sp.integrate(sp.expand(stiffness * strain**2), (xi, bottom, top))

    half = sp.Rational(1, 2)
    energy = layer(e_1, n * rho_1, split, half) + layer(e_2, rho_2, -half, split)
    solution = sp.solve([sp.diff(energy, metric), sp.diff(energy, bend)], [metric, bend])
    return symbols, solution[metric], solution[bend] / solution[metric]


@pytest.mark.parametrize("bilayer", BILAYERS)
def test_natural_quantities_minimise_the_projected_energy(minimiser, bilayer):
    symbols, area, curvature = minimiser
    values = dict(zip(symbols, (sp.Float(value, 30) for value in bilayer), strict=True))
    assert theory.natural_stretch(*bilayer) ** 2 == pytest.approx(
        float(area.subs(values)), rel=1e-12
    )
    assert theory.natural_curvature(*bilayer) == pytest.approx(
        float(curvature.subs(values)), rel=1e-12
    )


def test_natural_quantities_equal_the_printed_formulas_identically(minimiser):
    symbols, area, curvature = minimiser
    e1, e2, m, n, r1, r2 = symbols
    bottom = (
        e2**8 * m**4 * n**2 * r1**2
        + 2 * e1**4 * e2**4 * m * (m * (2 * m + 3) + 2) * n * r1 * r2
        + e1**8 * r2**2
    )
    mixed = e1**2 * (3 * m * (m + 1) + 1) + e2**2 * (m * (m + 3) + 3)
    top = (
        e1**2 * e2**8 * m**4 * n**2 * r1**2
        + e1**4 * e2**4 * m * n * mixed * r1 * r2
        + e1**8 * e2**2 * r2**2
    )
    printed = -3 * e1**4 * e2**4 * (e1**2 - e2**2) * m * (m + 1) ** 2 * n * r1 * r2 / top
    assert sp.cancel(area - top / bottom) == 0
    assert sp.cancel(curvature - printed) == 0


def minimise_projected_energy(radius, bilayer, poisson):
    """Minimise (S16) over all six components of a and b on a sphere, h = 1."""
    e_1, e_2, m, n, rho_1, rho_2 = bilayer
    a_ref = np.array([[1.3, 0.2], [0.2, 0.9]])  # any frame
    b_ref = -a_ref / radius

    def energy(x):
        a = np.stack([x[..., [0, 1]], x[..., [1, 2]]], axis=-2)
        b = np.stack([x[..., [3, 4]], x[..., [4, 5]]], axis=-2)
        return theory.projected_energy(
            a, b, a_ref, b_ref, (e_1, e_2), (rho_1, rho_2), m, n, poisson
        )

    # A quadratic function: differences of any step give its gradient and Hessian exactly.
    basis = np.eye(6)
    gradient = (energy(basis) - energy(-basis)) / 2
    pairs = basis[:, None] + basis[None, :]
    single = energy(basis)
    hessian = energy(pairs) - single[:, None] - single[None, :] + energy(np.zeros(6))
    x = np.linalg.solve(hessian, -gradient)
    a, b = np.array([[x[0], x[1]], [x[1], x[2]]]), np.array([[x[3], x[4]], [x[4], x[5]]])
    return a, b, a_ref, b_ref


@pytest.mark.parametrize("poisson", [0.0, 0.45])
@pytest.mark.parametrize("bilayer", BILAYERS[:4])
def test_projected_energy_has_the_natural_forms_as_minimiser(bilayer, poisson):
    radius = 1e5
    a, b, a_ref, b_ref = minimise_projected_energy(radius, bilayer, poisson)
    stretch, curvature = theory.natural_stretch(*bilayer), theory.natural_curvature(*bilayer)
    a_nat, b_nat = theory.natural_forms(stretch, curvature, a_ref, b_ref)
    # The closed forms are the limit h/R -> 0; what is left is of the order h/R.
    np.testing.assert_allclose(a, a_nat, rtol=20 / radius, atol=20 / radius)
    np.testing.assert_allclose(b, b_nat, rtol=0, atol=20 / radius * float(stretch) ** 2)


def test_natural_quantities_are_first_order_in_thickness_over_radius():
    bilayer = BILAYERS[0]
    errors = []
    for radius in (1e2, 1e3, 1e4):
        a, _, a_ref, _ = minimise_projected_energy(radius, bilayer, NU)
        errors.append(abs(a[0, 0] / a_ref[0, 0] - theory.natural_stretch(*bilayer) ** 2))
    slopes = np.diff(np.log(errors)) / np.diff(np.log([1e-2, 1e-3, 1e-4]))
    assert np.all(slopes > 0.9)


def test_projected_energy_of_equal_layers_on_a_plate_is_koiters():
    a = np.array([[1.1, 0.05], [0.05, 0.95]])
    b = np.array([[0.3, -0.1], [-0.1, 0.7]])
    flat, zero = np.eye(2), np.zeros((2, 2))
    projected = theory.projected_energy(a, b, flat, zero, (1, 1), (1, 1), 0.3, 1.0, NU, 0.2)
    koiter = theory.koiter_energy(a, b, flat, zero, 2 * (1 + NU), NU, 0.2)
    assert projected == pytest.approx(float(koiter), rel=1e-12)


def test_projected_energy_vanishes_in_a_strongly_curved_grown_shell():
    a_ref = np.array([[1.3, 0.2], [0.2, 0.9]])
    b_ref = -a_ref / 2.0
    grown = theory.projected_energy(
        1.69 * a_ref, 1.69 * b_ref, a_ref, b_ref, (1.3, 1.3), (1.69, 1.69), M, N, NU
    )
    assert grown == pytest.approx(0.0, abs=1e-25)


def test_natural_curvature_numbers():
    times = [0.05, 0.1, 0.2, 0.3, 0.5, 1.0]
    expected = [0.3026, 0.5015, 0.7306, 0.8495, 0.9606, 1.0415]
    np.testing.assert_allclose(theory.cap_curvature(times), expected, atol=5e-5)
    t_n = np.linspace(0, 1, 100_001)
    neglected = theory.cap_curvature(t_n, mass_change=False)
    assert neglected.max() == pytest.approx(0.7998, abs=5e-5)
    assert t_n[neglected.argmax()] == pytest.approx(0.413, abs=5e-4)
    assert np.all(np.diff(theory.cap_curvature(t_n)) > 0)  # with mass it never falls


def test_monolayer_and_uniform_growth_do_not_bend():
    e = np.array([0.7, 1.0, 1.5, 4.0])
    np.testing.assert_allclose(theory.natural_stretch(1.0, e, 0.0, N), e, rtol=1e-12)
    assert np.all(theory.natural_curvature(1.0, e, 0.0, N) == 0)
    # m -> 0 is approached, not only hit
    np.testing.assert_allclose(theory.natural_stretch(1.0, e, 1e-9, N), e, rtol=1e-5)
    np.testing.assert_allclose(theory.natural_stretch(e, e, M, N), e, rtol=1e-12)
    np.testing.assert_allclose(theory.natural_curvature(e, e, M, N), 0, atol=1e-14)
    np.testing.assert_allclose(theory.natural_stretch(e, 1.0, 1e9, N), e, rtol=1e-5)


@pytest.mark.parametrize("bilayer", BILAYERS)
def test_turning_the_bilayer_over_turns_its_curvature(bilayer):
    e_1, e_2, m, n, rho_1, rho_2 = bilayer
    turned = (e_2, e_1, 1 / m, 1 / n, rho_2, rho_1)
    assert theory.natural_stretch(*turned) == pytest.approx(
        float(theory.natural_stretch(*bilayer)), rel=1e-12
    )
    assert theory.natural_curvature(*turned) == pytest.approx(
        -float(theory.natural_curvature(*bilayer)), rel=1e-12
    )


def test_small_growth_is_timoshenkos_bimetal():
    strain = 1e-7
    kappa = theory.natural_curvature(1.0, 1.0 + strain, 1.0, 1.0)
    assert kappa == pytest.approx(1.5 * strain, rel=1e-5)


def test_cap_curvature_follows_the_rates():
    kappa = theory.cap_curvature(0.4, 0.2, 10.0, (0.5, 2.0))
    assert kappa == theory.natural_curvature(1.2, 1.8, 0.2, 10.0)
    neglected = theory.cap_curvature(0.4, 0.2, 10.0, (0.5, 2.0), mass_change=False)
    assert neglected == theory.natural_curvature(1.2, 1.8, 0.2, 10.0, 1.0, 1.0)


def test_density_preserving_growth_is_the_default():
    kept = theory.natural_curvature(1.2, 3.0, M, N)
    assert kept == theory.natural_curvature(1.2, 3.0, M, N, 1.44, 9.0)
    assert kept != pytest.approx(float(theory.natural_curvature(1.2, 3.0, M, N, 1.0, 1.0)))


# --- rigidities and the OOV as a spring


def test_effective_modulus_is_the_mean_through_the_thickness():
    assert theory.effective_modulus_ratio(M, N) == pytest.approx(0.1 * N + 0.9, rel=1e-12)
    assert theory.effective_modulus_ratio([0.3, 0.0], [1.0, 7.0]) == pytest.approx([1, 1])


def test_lame_moduli_give_back_young_and_poisson():
    lmbda, mu = theory.lame_moduli(3.0, 0.3)
    assert mu == 3.0
    assert lmbda / (2 * (lmbda + mu)) == pytest.approx(0.3, rel=1e-12)


def test_rigidities():
    assert theory.membrane_rigidity(2.0, 0.5, 0.1) == pytest.approx(0.2 / 0.75, rel=1e-12)
    assert theory.bending_rigidity(2.0, 0.5, 0.1) == pytest.approx(2e-3 / 9, rel=1e-12)


def test_spring_ratio_is_the_ratio_of_the_rigidities():
    cap = theory.bending_rigidity(theory.effective_modulus_ratio(M, N), NU, 0.2)
    oov = theory.bending_rigidity(1.0, NU, 0.2)
    gamma = theory.spring_ratio(M, N, NU)
    assert gamma == pytest.approx(float(oov / (2 * cap * (1 + NU))), rel=1e-12)
    assert gamma == pytest.approx(0.05845, abs=5e-6)


def test_equivalent_curvature_is_what_the_spring_leaves():
    left = theory.equivalent_curvature(3.0, 0.06, 0.7, 1.0, 0.04)
    assert left == pytest.approx(3.0 - 0.06 * 0.7 / 0.2, rel=1e-12)


# --- energies, (S13)-(S15), (S22), (S37)


def test_koiter_energy_vanishes_at_the_natural_forms_only():
    a_ref = np.array([[1.0, 0.1], [0.1, 2.0]])
    a_nat, b_nat = theory.natural_forms(1.2, 3.0, a_ref, -a_ref)
    np.testing.assert_allclose(a_nat, 1.44 * a_ref, rtol=1e-12)
    np.testing.assert_allclose(b_nat, 1.44 * (3.0 - 1.0) * a_ref, rtol=1e-12)
    elastic = (2.0, 0.3, 0.1)
    assert theory.koiter_energy(a_nat, b_nat, a_nat, b_nat, *elastic) == 0
    shear = np.array([[0.0, 1e-3], [1e-3, 0.0]])
    assert theory.koiter_energy(a_nat + shear, b_nat, a_nat, b_nat, *elastic) > 0
    assert theory.koiter_energy(a_nat, b_nat + shear, a_nat, b_nat, *elastic) > 0


def test_koiter_energy_of_known_strains():
    identity = np.eye(2)
    y, b = theory.membrane_rigidity(2.0, 0.3, 0.1), theory.bending_rigidity(2.0, 0.3, 0.1)
    uniaxial = np.diag([1.02, 1.0])  # E_11 = 0.01
    zero = np.zeros((2, 2))
    membrane = theory.koiter_energy(uniaxial, zero, identity, zero, 2.0, 0.3, 0.1)
    assert membrane == pytest.approx(float(y) / 2 * 1e-4, rel=1e-12)
    bending = theory.koiter_energy(identity, 0.5 * identity, identity, zero, 2.0, 0.3, 0.1)
    assert bending == pytest.approx(float(b) / 2 * (0.3 * 1 + 0.7 * 0.5), rel=1e-12)


def cross_term(strain, bend, radius, stretch, curvature, elastic):
    """Derivative of (S13), per reference area, along a linear strain and change of curvature."""
    a_ref = np.eye(2)
    b_ref = -a_ref / radius
    a_nat, b_nat = theory.natural_forms(stretch, curvature, a_ref, b_ref)

    def energy(s):
        a, b = a_ref + 2 * s * strain, b_ref + s * bend
        return stretch**2 * theory.koiter_energy(a, b, a_nat, b_nat, *elastic)

    return (energy(1.0) - energy(-1.0)) / 2  # exact for a quadratic


def test_growth_loads_do_the_work_of_the_natural_forms():
    radius, stretch, curvature, elastic = 1.7, 1.3, 2.2, (3.0, 0.35, 0.2)
    loads = theory.growth_loads(stretch, curvature, radius, *elastic)
    identity, zero = np.eye(2), np.zeros((2, 2))
    arguments = (radius, stretch, curvature, elastic)
    # w = 1, outward: strain 1/R; b = -a/(R + w) gives b_ab = -(R + w) a_ref/R^2, so -1/R^2.
    membrane = cross_term(identity / radius, zero, *arguments)
    bending = cross_term(zero, -identity / radius**2, *arguments)
    assert membrane == pytest.approx(-float(loads.membrane_pressure), rel=1e-12)
    assert bending == pytest.approx(-float(loads.bending_pressure), rel=1e-12)
    # A tangential u with div u = 2: the edge does its work, by Gauss's theorem 2 u . m_0 per area.
    assert cross_term(identity, zero, *arguments) == pytest.approx(
        -2 * float(loads.edge_traction), rel=1e-12
    )
    # A rotation q alone changes b by grad q; div q = 2 takes -q . m_0 of the moment.
    turning = cross_term(zero, identity, *arguments)
    assert turning == pytest.approx(2 * float(loads.edge_moment), rel=1e-12)
    torque = theory.edge_torque(stretch, curvature, radius, *elastic)
    assert turning == pytest.approx(-2 * float(torque), rel=1e-12)


def test_edge_torque_has_the_sign_of_the_curvature():
    assert theory.edge_torque(1.0, 2.0, 1.0, 3.0, 0.3, 0.1) > 0
    rigidity = float(theory.bending_rigidity(3.0, 0.3, 0.1))
    torque = theory.edge_torque(2.0, 2.0, 0.5, 3.0, 0.3, 0.1)
    assert torque == pytest.approx(rigidity * 1.3 * (2.0 * 0.5 - 0.75) / 0.5, rel=1e-12)


def test_boundary_layer_rotation_minimises_its_energy():
    place = {"radius": 1.3, "rigidity": 0.02, "thickness": 0.1}
    rotation = theory.boundary_layer_rotation(0.01, **place)
    assert rotation == pytest.approx(0.01 * math.sqrt(0.13) / 0.02, rel=1e-12)
    around = rotation * np.array([1 - 1e-3, 1.0, 1 + 1e-3])
    energy = theory.boundary_layer_energy(around, 0.01, ALPHA, **place)
    assert energy[1] < energy[0] == pytest.approx(energy[2], rel=1e-9)
    # Without a moment it is (S22), pi alpha B rotation^2 sqrt(R/h).
    free = theory.boundary_layer_energy(0.5, 0.0, ALPHA, **place)
    assert free == pytest.approx(math.pi * ALPHA * 0.02 * 0.25 * math.sqrt(13), rel=1e-12)


# --- plates and open caps, (S25), (S26), (S33)-(S36)


def test_chi_and_its_exact_value():
    assert theory.chi(M, N) == pytest.approx(0.5233, abs=5e-5)
    # (S17), (S18) themselves, at a growth of 1e-6
    e = 1 + 1e-6
    limit = (theory.natural_stretch(1, e, M, N) ** 2 - 1) / (
        2 * theory.natural_curvature(1, e, M, N)
    )
    assert theory.chi_small_growth(M, N) == pytest.approx(float(limit), rel=1e-4)
    assert theory.chi_small_growth(M, N) == pytest.approx(0.47597, abs=5e-6)
    # (S34) is its expansion: the difference falls as m^2 n m/(m n) = m
    difference = [float(theory.chi(m, N) / theory.chi_small_growth(m, N) - 1) for m in (1e-3, 1e-4)]
    assert abs(difference[1]) < abs(difference[0]) / 5 < 1e-3


def test_plate_buckling():
    chi = theory.chi(M, N)
    factor = theory.plate_buckling_factor(chi, NU)
    assert factor == pytest.approx(4.167, abs=5e-4)
    np.testing.assert_allclose(
        theory.plate_buckling_curvature([10, 20], chi, NU), factor / [100, 400], rtol=1e-12
    )
    energy = theory.plate_buckling_curvature_by_energy(np.array([10.0, 20.0]))
    np.testing.assert_allclose(energy * [100, 400], math.sqrt(10 + 7 * math.sqrt(2)), rtol=1e-12)
    assert energy[0] * 100 == pytest.approx(4.461, abs=5e-4)


def test_stability_of_the_plate_equals_the_printed_formula():
    stretch, radius = 1.2, 3.0
    for n_1, n_3 in ((1, 2), (2, 1), (2, 3)):
        s_1, s_3 = math.sin(math.pi * n_1), math.sin(math.pi * n_3)
        bracket = (NU - 1) * n_1 * (math.pi * n_1 + s_1) - 4 * math.pi * (NU + 1)
        top = 2 * (1 - stretch**2) * (4 * (NU + 1) * s_1 + n_1 * bracket)
        bottom = radius**2 * stretch**4 * (1 - NU**2) * n_1 * n_3 * (math.pi * n_3 + s_3)
        kappa = theory.plate_buckling_curvature_of_stretch(stretch, radius, NU, n_1, n_3)
        assert kappa == pytest.approx(math.sqrt(top / bottom), rel=1e-12)


def test_plate_buckling_follows_from_the_stability_of_the_plate():
    # (S35) solves (S33) with (S34) put in, Lambda^4 -> 1 for a slender plate (h = 1).
    chi, radius = theory.chi(M, N), 1e4
    kappa = theory.plate_buckling_curvature(radius, chi, NU)
    stretch = np.sqrt(1 + 2 * chi * kappa)
    assert theory.plate_buckling_curvature_of_stretch(stretch, radius, NU) == pytest.approx(
        float(kappa), rel=1e-6
    )


def test_span_is_the_plates_edge_displacement():
    chi, kappa_h = theory.chi(M, N), 0.3
    area = 1 + 2 * chi * kappa_h  # (S34)
    displacement = -0.5 * (1 + NU) * 2.0 * (1 - area)  # (S28a) at xi = Rp = 2
    assert theory.span(2.0, kappa_h, chi, NU) == pytest.approx(float(2.0 + displacement), rel=1e-12)


def printed_horizontal_curvature(alpha, radius, h, nu, area):
    """(S25) as it is printed, with dimensions."""
    s = 1 + nu
    top = 10 * h**2 * (area * s * (alpha**2 * s + 9) - alpha**2 * s**2 - 9 * nu - 3)
    top += 3 * alpha**2 * (1 - area) * radius**2 * (1 - nu**2) * (3 * alpha**2 * s + 20)
    bottom = 5 * h**2 * (alpha**2 * s + 6) - 3 * alpha**4 * radius**2 * (1 - nu**2)
    return top / (2 * area * radius * s * bottom)


@pytest.mark.parametrize("stretch", [1.0, 1.3])
def test_horizontal_curvature_equals_the_printed_formula(stretch):
    kappa = theory.horizontal_curvature(ALPHA, 5.0, NU, stretch)
    expected = printed_horizontal_curvature(ALPHA, 50.0, 10.0, NU, stretch**2) * 50.0
    assert kappa == pytest.approx(expected, rel=1e-12)


def test_horizontal_curvature_of_a_tiny_cap_flattens_it():
    # The theory's own plate, (S28b), curves by (1 + nu) kappa: flat at (1 + nu) kappa R = 1.
    assert theory.horizontal_curvature(1e-4, 5.0, NU) == pytest.approx(1 / (1 + NU), rel=1e-6)


def test_snapping_limit_is_the_pole_of_the_horizontal_curvature():
    limit = float(theory.snapping_limit(NU))
    assert limit == pytest.approx(1.8818, abs=5e-5)
    alpha = 1e-3  # (S26) is the leading order in alpha
    below, above = (
        float(theory.horizontal_curvature(alpha, (factor * limit / alpha) ** 2, NU))
        for factor in (1 - 1e-4, 1 + 1e-4)
    )
    assert below > 1e3
    assert above < -1e3


# --- scaling laws, (3)-(6)

GAMMA = float(theory.spring_ratio(M, N, NU))
A_B = float(theory.plate_buckling_factor(theory.chi(M, N), NU))


def test_scaling_laws_at_the_paper_s_coefficients():
    paper = theory.PAPER_COEFFICIENTS
    assert dataclasses.astuple(paper) == (1.55, -0.95, 0.86, 0.22, 4.72, -5.50)
    theta, ratio = 2.0, (2.0 / ALPHA) ** 2
    assert theory.theta_bar(ALPHA, ratio) == pytest.approx(theta, rel=1e-12)
    assert theory.primary_curvature(theta, GAMMA) == pytest.approx(
        1.55 * (1 + GAMMA) * 2 - 0.95, rel=1e-12
    )
    assert theory.secondary_curvature(ratio) == pytest.approx(
        0.86 * theta**2 / ALPHA**2 + 0.22, rel=1e-12
    )
    assert theory.buckling_curvature(theta, ALPHA, GAMMA, A_B) == pytest.approx(
        4.72 * (A_B / 4 + 1 + GAMMA * (math.pi - ALPHA) * 4 / ALPHA**2) - 5.50, rel=1e-12
    )


def test_scaling_laws_use_the_coefficients_they_are_given():
    fitted = theory.ScalingCoefficients(1.5, -0.9, 0.9, 0.1, 5.0, -6.0)
    assert theory.primary_curvature(2.0, 0.0, fitted) == pytest.approx(2.1, rel=1e-12)
    assert theory.secondary_curvature(10.0, fitted) == pytest.approx(9.1, rel=1e-12)
    assert theory.buckling_curvature(1.0, ALPHA, 0.0, 2.0, fitted) == pytest.approx(9.0, rel=1e-12)
    with pytest.raises(dataclasses.FrozenInstanceError):
        fitted.a_1 = 1.0  # type: ignore[misc]


def test_transition_numbers():
    assert theory.buckling_transition(ALPHA, GAMMA, A_B) == pytest.approx(2.447, abs=5e-4)
    assert theory.buckling_transition(ALPHA, 0.06, A_B) == pytest.approx(2.498, abs=5e-4)


@pytest.mark.parametrize(("gamma", "a_b"), [(0.0, A_B), (GAMMA, A_B), (0.06, A_B), (GAMMA, 0.1)])
def test_transition_is_where_the_two_laws_meet(gamma, a_b):
    alpha = np.radians([10.0, 30.0, 40.0, 50.0, 90.0])
    theta = theory.buckling_transition(alpha, gamma, a_b)
    for factor, order in ((0.99, -1), (1.0, 0), (1.01, 1)):
        secondary = theory.secondary_curvature((factor * theta / alpha) ** 2)
        buckling = theory.buckling_curvature(factor * theta, alpha, gamma, a_b)
        if order == 0:
            np.testing.assert_allclose(secondary, buckling, rtol=1e-11)
        else:  # below, the secondary invagination comes first; beyond, buckling
            assert np.all(np.sign(secondary - buckling) == order)


FITTED = theory.ScalingCoefficients(1.544, -0.958, 0.904, 0.148, 5.02, -6.10)


@pytest.mark.parametrize("c", [theory.PAPER_COEFFICIENTS, FITTED])
def test_transition_equals_the_printed_formula_with_the_root_over_the_fraction(c):
    alpha_2 = math.pi - ALPHA
    lead = c.a_2 - alpha_2 * c.b_b * GAMMA
    linear = c.c_b - c.b_2 + c.b_b
    root = math.sqrt(4 * ALPHA**2 * c.b_b * A_B * lead + ALPHA**4 * linear**2)
    printed = math.sqrt((root + ALPHA**2 * linear) / (2 * lead))
    assert theory.buckling_transition(ALPHA, GAMMA, A_B, c) == pytest.approx(printed, rel=1e-12)


def test_transition_where_the_quadratic_term_vanishes_and_where_the_laws_never_meet():
    c = theory.PAPER_COEFFICIENTS
    balanced = c.a_2 / (c.b_b * (math.pi - ALPHA))
    theta = theory.buckling_transition(ALPHA, balanced, A_B)
    assert theory.secondary_curvature((theta / ALPHA) ** 2) == pytest.approx(
        float(theory.buckling_curvature(theta, ALPHA, balanced, A_B)), rel=1e-12
    )
    assert np.isnan(theory.buckling_transition(ALPHA, 10 * balanced, A_B))


# --- prediction for a case


def curvature_of(case, t_n):
    return float(theory.cap_curvature_of_case(case, t_n))


def test_the_chick_is_predicted_normal():
    case = parse_case({})
    prediction = theory.predict(case)
    primary, secondary, buckling = prediction.events
    assert prediction.outcome == "normal"
    assert prediction.primary_type == "smooth"  # theta_bar = 1.561 < theta_s
    assert prediction.theta_b == pytest.approx(2.447, abs=5e-4)
    assert (secondary.kappa_cap_R, primary.kind) == (pytest.approx(4.52), "primary_invagination")
    assert curvature_of(case, primary.t_n) == pytest.approx(primary.kappa_cap_R, rel=1e-12)
    assert curvature_of(case, secondary.t_n) == pytest.approx(secondary.kappa_cap_R, rel=1e-12)
    assert math.isnan(buckling.t_n)  # 10.66 against 5.21 at t_n = 1
    assert prediction.final_kappa_cap_R == pytest.approx(5 * 1.0415, abs=3e-4)


def test_the_slender_vesicle_is_predicted_abnormal():
    case = parse_case({"shape": {"radius_over_thickness": 15}})
    prediction = theory.predict(case)
    _, secondary, buckling = prediction.events
    assert prediction.outcome == "abnormal"
    assert prediction.primary_type == "snap-through"
    assert 0.2 < buckling.t_n < secondary.t_n < 0.4


@pytest.mark.parametrize(("ratio", "outcome"), [(12.2, "normal"), (12.4, "abnormal")])
def test_the_outcome_turns_at_theta_b(ratio, outcome):
    case = parse_case({"shape": {"radius_over_thickness": ratio}})
    prediction = theory.predict(case)
    assert prediction.outcome == outcome
    assert (prediction.theta_bar > prediction.theta_b) == (outcome == "abnormal")


def test_buckling_before_the_end_and_secondary_never_is_abnormal():
    case = parse_case(
        {
            "shape": {"radius_over_thickness": 15, "opening_angle_deg": 50},
            "growth": {"mass_change": False},
        }
    )
    prediction = theory.predict(case)
    assert math.isnan(prediction.events[1].t_n)
    assert prediction.outcome == "abnormal"


def test_nothing_is_reached_in_a_short_run():
    prediction = theory.predict(parse_case({"run": {"t_end": 0.02}}))
    assert prediction.outcome == "not reached"
    assert all(math.isnan(event.t_n) for event in prediction.events)


def test_time_of_curvature_takes_the_first_crossing():
    case = parse_case({"growth": {"mass_change": False}})
    kappa = 5 * 0.75  # passed upward before the peak at .413 and downward after it
    t_n = theory.time_of_curvature(case, kappa)
    assert t_n < 0.413
    assert curvature_of(case, t_n) == pytest.approx(kappa, rel=1e-12)
    assert 0 < theory.time_of_curvature(case, 0.5) < 0.05
    assert math.isnan(theory.time_of_curvature(case, 5 * 0.81))
    assert math.isnan(theory.time_of_curvature(case, 0.0))
    assert math.isnan(theory.time_of_curvature(case, -1.0))


def test_report_names_events_and_outcome():
    chick = theory.prediction_report(parse_case({}))
    assert "secondary invagination       4.5200       0.3752" in chick
    assert "symmetry breaking           10.6611  not reached" in chick
    assert "normal cup" in chick and "note:" not in chick
    odd = parse_case(
        {
            "shape": {"radius_over_thickness": 30, "opening_angle_deg": 60},
            "growth": {"mass_change": False},
        }
    )
    text = theory.prediction_report(odd)
    assert "abnormal cup" in text and text.count("note:") == 2


def one_koiter_energy(a, b):
    return theory.koiter_energy(a, b, np.eye(2), -np.eye(2), 2.0, 0.3, 0.1)


def one_projected_energy(a, b):
    identity = np.eye(2)
    return theory.projected_energy(a, b, identity, -identity, (1.1, 1.2), (1.0, 1.3), M, N, NU, 0.1)


def test_formulas_broadcast():
    assert theory.natural_curvature(1.0, [[1.5], [2.0]], [0.1, 0.2, 0.3], N).shape == (2, 3)
    assert theory.horizontal_curvature([0.3, 0.4], [[5.0], [6.0]], NU).shape == (2, 2)
    assert theory.buckling_curvature([1.5, 2.0], [[0.5], [0.7]], GAMMA, A_B).shape == (2, 2)
    a = np.broadcast_to(np.eye(2), (4, 2, 2))
    forms = np.linspace(0.9, 1.2, 4)[:, None, None] * [[1.0, 0.1], [0.1, 0.8]]
    koiter, projected = (
        [energy(form, forms[3 - i]) for i, form in enumerate(forms)]
        for energy in (one_koiter_energy, one_projected_energy)
    )
    np.testing.assert_allclose(one_koiter_energy(forms, forms[::-1]), koiter, rtol=1e-13)
    np.testing.assert_allclose(one_projected_energy(forms, forms[::-1]), projected, rtol=1e-13)
    assert theory.natural_forms(np.ones(4), np.zeros(4), a, a)[1].shape == (4, 2, 2)


@pytest.mark.parametrize("name", ["arrays", "natural", "rigidity", "plate", "scaling"])
def test_examples_in_the_docstrings(name):
    module = importlib.import_module(f"opticcup_fem.theory.{name}")
    results = doctest.testmod(module)
    assert results.attempted > 0
    assert results.failed == 0
