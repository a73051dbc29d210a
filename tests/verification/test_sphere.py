"""The closed sphere under uniform growth and pressure, against one scalar equation for its radius.

A sphere of stretch s has a = s^2 a_ref and b = -(s/R) a_ref.  Its energy is written here from
(S8), and shares nothing with the package.  `paper` and `closed-form` have no energy: their radius
is the root of the virtual work with every lambda_3 held.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import brentq

from opticcup_fem.shell.closures import CLOSURES
from opticcup_fem.shell.loads import Load, Pressure
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.supports import rigid_modes_of_cup
from tests.support.shells import (
    ENERGY_CLOSURES,
    OTHER_CLOSURES,
    loaded,
    rate_of,
    sphere_shell,
    wall,
)

Array = npt.NDArray[np.float64]
NU = 0.45
LAME = 2 * NU / (1 - 2 * NU)
RATE = 1.5
STEP = 1e-5


class ExactSphere:
    """Unit sphere of one layer, mu = 1, five Gauss points, density-preserving growth."""

    def __init__(self, closure: str, thickness: float, growth: float) -> None:
        """Place the Gauss points."""
        x, w = np.polynomial.legendre.leggauss(5)
        self.closure, self.e = closure, growth
        self.xi, self.weights = thickness / 2 * x, thickness / 2 * w

    def area_ratio(self, s: float, metric_stretch: Array | float) -> Array:
        """J_s^2, with g = (s^2 + 2 l xi s) a_ref and g_nat = e^2 (1 + 2 xi) a_ref."""
        return (self._g(s, metric_stretch) / self._natural()) ** 2

    def _g(self, s: float, metric_stretch: Array | float) -> Array:
        return s**2 + 2 * metric_stretch * self.xi * s

    def _natural(self) -> Array:
        return self.e**2 * (1 + 2 * self.xi)

    def stretches(self, s: float) -> tuple[Array, Array]:
        """lambda_3 in the metric, and in J and I_1, at every height."""
        if self.closure == "condensed":
            metric = np.ones_like(self.xi)
        elif self.closure == "layer-stretch":
            metric = np.full_like(self.xi, plane_stress(s**4 / self.e**4))
        elif self.closure == "closed-form":
            metric = plane_stress(self.area_ratio(s, 1.0))
        else:
            metric = np.array([self._implicit(s, i) for i in range(len(self.xi))])
        if self.closure in ENERGY_CLOSURES:
            return metric, plane_stress(self.area_ratio(s, metric))
        return metric, metric

    def _implicit(self, s: float, i: int) -> float:
        def residual(stretch: float) -> float:
            return stretch - plane_stress(self.area_ratio(s, stretch)[i])

        return brentq(residual, 0.05, 2.3, xtol=1e-15)

    def energy(self, s: float, held: tuple[Array, Array] | None = None) -> float:
        """Energy of the whole sphere; ``held`` fixes the stretches."""
        metric, lambda_3 = self.stretches(s) if held is None else held
        J = np.sqrt(self.area_ratio(s, metric)) * lambda_3
        I_1 = 2 * self._g(s, metric) / self._natural() + lambda_3**2
        psi = LAME / 4 * (J**2 - 1 - 2 * np.log(J)) + (I_1 - 3 - 2 * np.log(J)) / 2
        return float(4 * np.pi * np.sum(self.weights * self.e**2 * psi))

    def stretch(self, pressure: float = 0.0) -> float:
        """The equilibrium stretch under internal pressure p, whose potential is -p V."""

        def work(s: float) -> float:
            held = None if self.closure in ENERGY_CLOSURES else self.stretches(s)
            strain = self.energy(s + STEP, held) - self.energy(s - STEP, held)
            return strain / (2 * STEP) - pressure * 4 * np.pi * s**2

        return brentq(work, 0.9 * self.e, 1.12 * self.e, xtol=1e-14)


def plane_stress(area_ratio):
    """lambda_3 of Sigma^33 = 0."""
    return np.sqrt((LAME + 2) / (LAME * area_ratio + 2))


def radius(shell: Shell, state: ShellState) -> float:
    """Radius of the sphere of the shell's area."""
    a_11, a_22, a_12 = np.moveaxis(shell.forms_at_points(state)[..., :3], -1, 0)
    area = np.sum(shell.weights * np.sqrt(a_11 * a_22 - a_12**2) / shell.area_ref)
    return float(np.sqrt(area / (4 * np.pi)))


def grown(closure: str, factor: float, steps: int = 4) -> tuple[float, float, list[int]]:
    """Relative errors of radius and energy, and Newton iterations, for e = 1 to 2.5."""
    exact = ExactSphere(closure, 0.2, 1 + RATE)
    shell = sphere_shell(wall(0.2, NU), RATE, closure, factor)
    state, iterations, problem = loaded(
        shell, rigid_modes_of_cup(shell), steps, tolerance=1e-9, most=20
    )
    if closure in ENERGY_CLOSURES:
        inertia = problem.inertia()
        assert inertia is not None and (inertia.negative, inertia.zero) == (0, 0)
    s = exact.stretch()
    return radius(shell, state) / s - 1, shell.energy(state) / exact.energy(s) - 1, iterations


@pytest.mark.parametrize("closure", CLOSURES)
def test_growing_sphere_on_a_coarse_mesh(closure):
    """126 cells: the errors of interpolation, 2e-5 and 7e-5, not more."""
    radius_error, energy_error, iterations = grown(closure, 1.0)
    assert abs(radius_error) < 3e-5
    assert abs(energy_error) < 1e-4
    assert max(iterations) <= 8


def test_closures_have_different_spheres():
    """The comparison tells them apart: their energies differ by far more than the errors."""
    assert set(CLOSURES) == {*ENERGY_CLOSURES, *OTHER_CLOSURES}
    spheres = [ExactSphere(closure, 0.2, 1 + RATE) for closure in CLOSURES]
    energies = [sphere.energy(sphere.stretch()) for sphere in spheres]
    assert np.diff(np.sort(energies)).min() > 4e-3 * min(energies)


@pytest.mark.slow
@pytest.mark.parametrize("closure", CLOSURES)
def test_growing_sphere_converges(closure):
    """Fourth order in radius and energy."""
    factors = [1.0, 0.7, 0.5]
    radii, energies, iterations = zip(*(grown(closure, f) for f in factors), strict=True)
    orders = [rate_of(factors, np.abs(errors)) for errors in (radii, energies)]
    print(closure, "radius", radii, "energy", energies, "orders", orders, iterations)
    assert min(orders) > 3.8  # meshes of one family are not similar: one or two tenths
    assert abs(radii[-1]) < 2e-6
    assert abs(energies[-1]) < 1e-5


def pressed(loads: Sequence[Load], thickness: float, nu: float = 0.3) -> float:
    shell = sphere_shell(wall(thickness, nu), loads=loads)
    state, _, _ = loaded(shell, rigid_modes_of_cup(shell), steps=1, tolerance=1e-12)
    return radius(shell, state)


@pytest.mark.parametrize("thickness", [0.1, 0.05, 0.02])
def test_small_pressure_inflates_as_thin_shell_theory_says(thickness):
    """The radius grows by p R^2 (1 - nu)/(2 E h), up to parts of (h/R)^2, which bending takes."""
    nu, pressure = 0.3, 1e-4 * thickness
    young = 2 * (1 + nu)
    expected = pressure * (1 - nu) / (2 * young * thickness)
    out, inwards = (pressed([Pressure(p)], thickness) for p in (pressure, -pressure))
    assert out > inwards
    # the difference is free of the discrete sphere's own, tiny relaxation
    assert (out - inwards) / 2 == pytest.approx(expected, rel=1.0 * thickness**2 + 1e-3)


def test_large_pressure_agrees_with_the_scalar_equation():
    """Eight per cent larger, with the follower's growing area: p 4 pi r^2 dr, energy -p V."""
    pressure = 0.05
    exact = ExactSphere("layer-stretch", 0.1, 1.0)
    shell = sphere_shell(wall(0.1, NU), loads=[Pressure(lambda t_n: pressure * t_n)])
    state, _, _ = loaded(shell, rigid_modes_of_cup(shell), steps=3, tolerance=1e-11)
    s = exact.stretch(pressure)
    assert s > 1.05
    assert radius(shell, state) == pytest.approx(s, rel=3e-5)
    potential = exact.energy(s) - pressure * 4 / 3 * np.pi * s**3
    assert shell.energy(state) == pytest.approx(potential, rel=1e-4)
