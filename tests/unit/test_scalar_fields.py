"""Values of a case that vary: formulas, tables, and the sentences for what is not possible."""

import numpy as np
import pytest

from opticcup_fem.case import case_to_toml, load_case, parse_case
from opticcup_fem.case.checks import require_axisymmetric, require_prescribed_numbers
from opticcup_fem.errors import CaseError
from opticcup_fem.scalar_fields import ScalarField
from opticcup_fem.stimulus import GROWTH, NO_MASS, Stimulus, stimulus_of
from opticcup_fem.studies.model import growth_of

THETA, PHI = np.array([0.0, 0.5, 2.0]), np.array([0.0, np.pi / 2, np.pi])

WRONG = {
    "growth.iov=5*foo": ["growth.iov", "no foo", "theta, phi, t_n and pi"],
    "growth.iov=__import__('os')": ["no function __import__"],
    "growth.iov=().__class__": ["nothing else"],
    "growth.iov=theta.real": ["nothing else"],
    "growth.iov=1 + 'theta'": ["no texts"],
    "growth.iov=[theta for theta in theta]": ["nothing else"],
    "growth.iov=theta if theta else 1": ["nothing else"],
    "growth.iov=1 +": ["is not a formula"],
    "growth.iov=1;2": ["is not a formula"],
    "growth.iov=sin(1, 2)": ["sin takes 1 argument"],
    "growth.iov=max(1)": ["max takes 2 arguments"],
    "growth.iov=rho": ["no rho"],
    f"growth.iov={'1+' * 300}1": ["500 characters"],
    "growth.iov={t_n = [0, 0], value = [1, 2]}": ["increase"],
    "growth.iov={t_n = [0, 1], value = [1]}": ["as many numbers"],
    "growth.iov={t_n = [0, 1], value = [1, true]}": ["as many numbers"],
    "growth.iov=true": ["a number", "a table", "a formula"],
    "material.thickness_iov=1 + t_n": ["no t_n"],
    "material.thickness_iov={t_n = [0], value = [1]}": ["does not change with t_n"],
    "mass.iov.diffusivity=-1": ["at least 0"],
    "mass.iov.diffusivity=1": ["mass.iov.source"],
    "mass.iov.stiffness=1": ['mass.iov.kind = "other"'],
    "mass.iov.sorce=1": ["did you mean mass.iov.source"],
    "mass.iov=3": ["a table of kind, source"],
}


@pytest.mark.parametrize(("override", "parts"), WRONG.items())
def test_wrong_fields_are_explained(tmp_path, override, parts):
    path = tmp_path / "case.toml"
    path.touch()
    with pytest.raises(CaseError) as caught:
        load_case(path, [override])
    assert "\n" not in str(caught.value)
    for part in parts:
        assert part in str(caught.value)


def test_formulas_are_evaluated_at_points():
    field = ScalarField("2*cos(phi) - step(theta - 1)*max(1, t_n)**2/rho + pi*min(0, theta)")
    expected = 2 * np.cos(PHI) - np.array([0, 0, 1]) / 4.0
    np.testing.assert_allclose(field(0.5, THETA, PHI, 4.0), expected, atol=1e-15)
    x = np.stack([np.sin(THETA) * np.cos(PHI), np.sin(THETA) * np.sin(PHI), np.cos(THETA)], axis=1)
    np.testing.assert_allclose(field.at(0.5, 3 * x, 4.0), expected, atol=1e-15)
    assert field.variables == {"theta", "phi", "t_n", "rho"}


def test_the_distance_from_the_axis_of_a_disk_is_its_theta():
    x = np.array([[0.3, 0.0, 0.0], [0.0, 0.4, 0.0]])
    np.testing.assert_allclose(ScalarField("theta").at(0.0, x), [0.3, 0.4])


def test_constants_and_tables_have_one_value():
    assert ScalarField(2.5).at(0.3, np.ones((4, 3))) == 2.5
    assert ScalarField("9**9").at(0.3, np.ones((4, 3))) == 9.0**9
    table = parse_case({"growth": {"iov": {"t_n": [0, 0.5], "value": [1, 3]}}}).growth.iov
    values = [ScalarField(table)(t) for t in (-1, 0.25, 0.5, 9)]
    np.testing.assert_allclose(values, [1, 2, 3, 3])


def test_numbers_in_formulas_cannot_grow_without_bounds():
    assert ScalarField("9**9**9**9")(0.0) == np.inf
    with pytest.raises(CaseError, match="inf at theta = 0"):
        growth_of(parse_case({"growth": {"iov": "9**9**9**9"}}))


def test_values_without_a_meaning_are_refused_with_their_place():
    with pytest.raises(CaseError, match=r"growth\.iov .* theta = .* must stay positive"):
        growth_of(parse_case({"growth": {"iov": "-1.2*cos(theta)"}}))
    with pytest.raises(CaseError, match=r"stiffness_oov .* a number above 0 everywhere"):
        growth_of(parse_case({"material": {"stiffness_oov": "cos(theta)"}}))
    growth_of(parse_case({"growth": {"iov": "-0.9*cos(theta)"}}))


def test_cases_with_fields_are_written_and_read_again(tmp_path):
    data = {
        "growth": {"iov": "5*cos(theta)", "oov": {"t_n": [0, 1], "value": [1, 2.5]}},
        "material": {"thickness_iov": "1 + 0.1*cos(phi)", "stiffness_ecm": 0.5},
        "mass": {"iov": {"source": "10/(1 + 5*t_n)*rho", "kind": "other", "stiffness": 0.25}},
    }
    case = parse_case(data)
    path = tmp_path / "case.toml"
    path.write_text(case_to_toml(case), encoding="utf-8")
    assert load_case(path) == case
    assert load_case(path, ["mass.iov.stiffness=0.5"]).mass.iov.stiffness == 0.5
    assert '"value":[1.0,2.5]' in case.model_dump_json()


def test_what_varies_in_phi_is_not_axisymmetric():
    case = parse_case({"material": {"stiffness_iov": "1 + 0.1*cos(phi)"}})
    with pytest.raises(CaseError, match=r"material\.stiffness_iov .* leave phi out"):
        require_axisymmetric(case, "the meridian model is")
    require_axisymmetric(parse_case({"growth": {"iov": "5*cos(theta)"}}), "the meridian model is")


def test_laws_of_uniform_growth_refuse_what_is_not():
    require_prescribed_numbers(parse_case({"growth": {"iov": 3.0}}), "the scaling laws are")
    for other in ({"growth": {"iov": "3*t_n"}}, {"mass": {"iov": {"source": "0"}}}):
        with pytest.raises(CaseError, match="uniform layers only"):
            require_prescribed_numbers(parse_case(other), "the scaling laws are")


def test_stimuli_follow_s10_and_s12():
    """E = sqrt(1 + v_m (J rho - rho_0)); rho_r = J rho/rho_0, or 1 where nothing stiff is added."""
    mass = np.array([1.0, 2.0, 5.0])
    np.testing.assert_allclose(GROWTH.factor(mass), np.sqrt(mass))
    np.testing.assert_allclose(GROWTH.density_ratio(mass), mass)
    heavy = Stimulus(specific_volume=0.5)
    np.testing.assert_allclose(heavy.factor(mass), np.sqrt([1.0, 1.5, 3.0]))
    np.testing.assert_allclose(heavy.mass(heavy.factor(mass)), mass)
    np.testing.assert_allclose(heavy.density_ratio_of_factor(heavy.factor(mass)), mass)
    np.testing.assert_allclose(NO_MASS.density_ratio(mass), 1.0)
    np.testing.assert_allclose(Stimulus(1.0, 0.25).density_ratio(mass), [1.0, 1.25, 2.0])
    assert np.isnan(GROWTH.factor(-0.1))


def test_kinds_of_a_case():
    kinds = {"growth": 1.0, "other": 0.3, "swelling": 0.0, "heating": 0.0, "default": 1.0}
    for kind, stiffness in kinds.items():
        keys = {"kind": kind, "stiffness": 0.3 if kind == "other" else 0.0}
        case = parse_case({"mass": {"iov": keys}})
        assert stimulus_of(case, "iov") == Stimulus(1.0, stiffness)
    off = parse_case({"growth": {"mass_change": False}, "mass": {"iov": {"kind": "growth"}}})
    assert [stimulus_of(off, layer) for layer in ("iov", "oov")] == [GROWTH, NO_MASS]
