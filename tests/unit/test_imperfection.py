"""Imperfect cups: what the imperfection is, and that small ones act in proportion.

What matters: without amplitude the cup is bitwise the perfect one; the response is linear in a
small amplitude and turns with its sign; pins and sampler live on the perfect sphere.
"""

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from opticcup_fem.case import parse_case
from opticcup_fem.equilibrium.newton import MixedNewton
from opticcup_fem.equilibrium.problem import Problem
from opticcup_fem.errors import CaseError
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.imperfection import MIXED, Imperfection, Wave, draw_imperfection
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.supports import rigid_modes_of_cup
from opticcup_fem.studies import meridian
from opticcup_fem.studies.model import shell_of
from tests.support.cups import coarse_case
from tests.support.shapes import sphere_angles, sphere_points
from tests.support.shells import RATES, coarse_cup, cup_sections

H = 0.2


def cup(imperfection: Imperfection | None) -> Shell:
    """Return the cup of 126 cells."""
    laws = {name: LinearGrowth(rate) for name, rate in RATES.items()}
    return Shell(coarse_cup(), cup_sections(H), laws, imperfection=imperfection)


def grown(shell: Shell, t_n: float) -> np.ndarray:
    """Return the positions of the equilibrium at ``t_n``."""
    newton = MixedNewton(Problem(shell, rigid_modes_of_cup(shell)), 1e-11)
    shell.set_time(t_n)
    solution = newton.solve(shell.reference_state())
    assert solution.converged
    return np.asarray(solution.state.r)


@pytest.mark.parametrize("m", [2, 3, 6])
def test_wave_is_radial_and_vanishes_at_the_poles(m: int) -> None:
    """Amplitude sin^k theta cos(m phi + phase), outward where it is positive."""
    theta = np.array([0.0, 0.4, np.pi / 2, 2.0, np.pi])
    x = 1.5 * sphere_points(theta, np.full(5, 0.3))
    moved = Wave(m, 0.02, 0.5)(x)
    radial = np.einsum("ni,ni->n", moved, x) / 1.5
    np.testing.assert_allclose(np.cross(moved, x), 0.0, atol=1e-15)
    k = 2 if m == 2 else 3
    np.testing.assert_allclose(
        radial, 0.02 * np.sin(theta) ** k * np.cos(0.3 * m + 0.5), atol=1e-15
    )
    assert np.abs(moved[[0, -1]]).max() < 1e-30


def test_draw_has_the_amplitude_and_depends_on_the_seed_alone() -> None:
    """One wave has it itself, a mixture as the root of the sum of squares."""
    (single,) = draw_imperfection(3, 0.1, 4).waves
    assert (single.wavenumber, single.amplitude) == (3, pytest.approx(0.1))
    mixture = draw_imperfection(0, 0.1, 4)
    assert tuple(wave.wavenumber for wave in mixture.waves) == MIXED == (2, 3, 4, 5, 6, 7, 8)
    assert np.linalg.norm([wave.amplitude for wave in mixture.waves]) == pytest.approx(0.1)
    assert mixture == draw_imperfection(0, 0.1, 4) != draw_imperfection(0, 0.1, 5)
    assert draw_imperfection(3, 0.1, 5).waves[0].phase != single.phase


def test_imperfection_adds_its_waves_up() -> None:
    waves = Wave(2, 0.1), Wave(5, -0.03, 1.0)
    x = sphere_points(np.array([0.5, 1.2]), np.array([0.1, 2.0]))
    np.testing.assert_allclose(Imperfection(waves)(x), waves[0](x) + waves[1](x))


def test_without_amplitude_the_cup_is_bitwise_the_perfect_one() -> None:
    perfect, none = (cup(imperfection) for imperfection in (None, Imperfection((Wave(2, 0.0),))))
    np.testing.assert_array_equal(grown(none, 0.02), grown(perfect, 0.02))


def test_small_imperfections_act_in_proportion() -> None:
    """Twice the amplitude, twice the response; the opposite phase, the opposite response.

    It is outward where the imperfection is, of which a thick cup straightens a part.
    """
    perfect = grown(cup(None), 0.03)
    amplitude, responses = 0.002 * H, []
    for factor, phase in ((1.0, 0.0), (2.0, 0.0), (1.0, np.pi)):
        shell = cup(Imperfection((Wave(2, factor * amplitude, phase),)))
        responses.append(grown(shell, 0.03) - perfect)
    once, twice, opposite = responses
    size = np.abs(once).max()
    assert size > 0.5 * amplitude
    assert np.abs(twice - 2 * once).max() < 0.02 * size
    assert np.abs(opposite + once).max() < 0.02 * size
    theta, phi = sphere_angles(shell.reference)
    outward = np.einsum("ni,ni->n", once, shell.reference)
    shape = np.sin(theta) ** 2 * np.cos(2 * phi)
    assert outward @ shape > 0.8 * np.linalg.norm(outward) * np.linalg.norm(shape)


def test_metric_is_the_imperfect_surfaces_and_points_keep_their_names() -> None:
    """a_ref from the imperfect surface; the reference, where pins are looked for, stays."""
    perfect, shell = cup(None), cup(Imperfection((Wave(2, 0.1),)))
    np.testing.assert_array_equal(shell.reference, perfect.reference)
    state = shell.reference_state()
    np.testing.assert_allclose(state.r - shell.reference, Wave(2, 0.1)(shell.reference), atol=1e-15)
    np.testing.assert_allclose(shell.forms_at_points(state)[..., :3], shell.a_ref)
    assert np.abs(shell.a_ref - perfect.a_ref).max() > 0.05 * np.abs(perfect.a_ref).max()
    # moments are zero at the sphere's curvature, so that the bent shell has an energy
    assert perfect.energy(perfect.reference_state()) < 1e-5
    assert shell.energy(state) > 1e-4


def test_case_makes_the_imperfection_in_units_of_h() -> None:
    keys = {"amplitude": 0.5, "wavenumber": 3, "seed": 2}
    shell = shell_of(coarse_case(10.0, imperfection=keys), MPI.COMM_SELF)
    expected = draw_imperfection(3, 0.05, 2)(shell.reference)
    np.testing.assert_array_equal(shell.rest, shell.reference + expected)
    perfect = shell_of(coarse_case(10.0), MPI.COMM_SELF)
    assert perfect.rest is perfect.reference


def test_meridian_refuses_an_imperfect_shell(tmp_path: Path) -> None:
    case = parse_case({"imperfection": {"amplitude": 0.1}, "run": {"model": "meridian"}})
    with pytest.raises(CaseError, match=r"imperfection.amplitude = 0.1 is not possible: run.model"):
        meridian.run(case, tmp_path, quiet=True)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"imperfection": {"wavenumber": 1}}, "imperfection.wavenumber = 1 is not possible"),
        (
            {"imperfection": {"amplitude": 0.1}, "run": {"follow": "axisymmetric"}},
            "has no axisymmetric states",
        ),
        ({"imperfection": {"amplitude": -0.1}}, "imperfection.amplitude"),
    ],
)
def test_impossible_imperfections_are_refused(tables: dict[str, object], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        parse_case(tables)
