"""A free bilayer disk whose inner layer grows a little: the natural curvature (S18).

The natural forms are a flat metric and a uniform curvature.  Their Gauss curvature kappa^2 costs
membrane energy, so that the disk is a little flatter, by a part of order (kappa Rp^2/h)^2 of kappa.
"""

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import brentq

from opticcup_fem.mesh import disk_mesh
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.section import Section
from opticcup_fem.shell.supports import Mask, held_components
from opticcup_fem.theory import natural_curvature, natural_stretch
from tests.support.shells import COMM, cup_sections, loaded, rate_of

Array = npt.NDArray[np.float64]
M, N = 1 / 9, 50.0
SLENDERNESS = 20.0
"""Rp/h."""


def six_components(shell: Shell) -> Mask:
    """Hold the centre, and two points of the rim so that no rigid motion is left."""
    x = shell.reference
    rim = np.flatnonzero(np.isclose(np.linalg.norm(x, axis=1), 1.0))
    top = x[rim[np.argmax(x[rim, 1])]]
    return held_components(
        shell,
        [((0.0, 0.0, 0.0), "xyz"), ((1.0, 0.0, 0.0), "yz"), (tuple(top), "z")],
    )


def grown_disk(
    bow: float, cell_size: float, upside_down: bool = False
) -> tuple[float, float, float]:
    """Grow the disk's inner layer until kappa Rp^2/h = bow.

    Returns:
        Mean stretch and mean curvature of the disk over the natural ones (less 1), and the mean
        height of the rim over the centre in units of kappa Rp^2.
    """
    h = 1 / SLENDERNESS
    kappa_h = bow / SLENDERNESS**2
    e = brentq(lambda e: float(natural_curvature(1.0, e, M, N)) - kappa_h, 1.0, 1.1)
    layers = cup_sections(h)["cap"].layers
    section = Section(layers[::-1] if upside_down else layers)
    laws = {"iov": LinearGrowth(e - 1), "ecm": LinearGrowth(0.0)}
    shell = Shell(disk_mesh(1.0, cell_size, comm=COMM), {"disk": section}, laws)
    state, _, problem = loaded(shell, six_components(shell), 1, tolerance=1e-12)
    inertia = problem.inertia()
    assert inertia is not None and (inertia.negative, inertia.zero) == (0, 0)
    stretch, curvature = mean_stretch_and_curvature(shell, state)
    rim = np.isclose(np.linalg.norm(shell.reference, axis=1), 1.0)
    centre = np.argmin(np.linalg.norm(shell.reference, axis=1))
    rise = np.mean(state.r[rim, 2]) - state.r[centre, 2]  # a tilt averages out
    expected = natural_stretch(1.0, e, M, N) - 1
    return float(stretch / expected - 1), curvature * h / kappa_h - 1, rise * SLENDERNESS / bow


def mean_stretch_and_curvature(shell: Shell, state: ShellState) -> tuple[float, float]:
    """sqrt(tr(a_ref^-1 a)/2) - 1 and tr(a^-1 b)/2, means over the disk."""
    forms = shell.forms_at_points(state)
    a, b = matrices(forms[..., :3]), matrices(forms[..., 3:])
    over_ref = np.linalg.solve(matrices(shell.a_ref), a)
    over_a = np.linalg.solve(a, b)
    area = shell.weights / np.sum(shell.weights)
    stretch = np.sqrt(np.trace(over_ref, axis1=-2, axis2=-1) / 2) - 1
    return float(np.sum(area * stretch)), float(
        np.sum(area * np.trace(over_a, axis1=-2, axis2=-1)) / 2
    )


def matrices(components: Array) -> Array:
    """(11, 22, 12) as 2x2 matrices."""
    return np.stack([components[..., [0, 2]], components[..., [2, 1]]], axis=-2)


def test_small_growth_bends_the_disk_by_the_natural_curvature():
    """Towards n, where the inner layer (xi < 0) grows: the rim rises by kappa Rp^2/2."""
    stretch, curvature, rise = grown_disk(0.05, 0.5)
    assert abs(curvature) < 3e-4
    assert abs(stretch) < 1e-2
    assert rise == pytest.approx(0.5, rel=1e-3)


def test_outer_growth_bends_it_the_other_way():
    _, curvature, rise = grown_disk(0.05, 0.5, upside_down=True)
    assert curvature == pytest.approx(-2.0, abs=1e-3)
    assert rise == pytest.approx(-0.5, rel=1e-3)


def test_difference_to_the_natural_curvature_is_that_of_gauss_curvature():
    """It falls as (kappa Rp^2/h)^2."""
    bows = [0.2, 0.1, 0.05]
    differences = [abs(grown_disk(bow, 0.25)[1]) for bow in bows]
    print("differences", differences)
    assert rate_of(bows, differences) == pytest.approx(2.0, abs=0.3)
    assert differences[0] < 3e-3
