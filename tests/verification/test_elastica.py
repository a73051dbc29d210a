"""A cantilever strip under a dead force on its end, against the elastica.

The elastica neither stretches nor feels its thickness.  The strip stretches by N/(E h), of order
f/(E h) = k h^2/12 for f = k B, and its bending stiffness changes by (h theta')^2: both are of
second order in h/L, and the difference must fall as h^2.
"""

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_bvp

from opticcup_fem.shell.loads import EdgeForce
from opticcup_fem.shell.supports import clamped
from tests.support.shells import loaded, strip_shell, wall

Array = npt.NDArray[np.float64]
FORCE = 5.0
"""f L^2/B: the tip rises by 0.71 L and turns by 70 degrees."""


def elastica(force: float) -> Array:
    """Tip (x, z) of theta'' = -k cos(theta), theta(0) = 0, theta'(1) = 0."""

    def slope(_: Array, y: Array) -> Array:
        return np.stack([y[1], -force * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    def ends(start: Array, end: Array) -> Array:
        return np.array([start[0], end[1], start[2], start[3]])

    solution = solve_bvp(slope, ends, np.linspace(0, 1, 41), np.zeros((4, 41)), tol=1e-9)
    assert solution.success
    return solution.y[2:, -1]


def tip(thickness: float, along: int, direction: float = 1.0) -> Array:
    """Tip (x, z) of the strip of length 1, E h^3/12 = h^3/6."""
    force = direction * FORCE * thickness**3 / 6
    load = EdgeForce("right", lambda t_n: (0.0, 0.0, force * t_n))
    shell = strip_shell(wall(thickness, 0.0), 0.1, along, max(along // 12, 1), loads=[load])
    state, _, _ = loaded(shell, clamped(shell, "left"), 5, tolerance=1e-12, most=15)
    end = np.isclose(shell.reference[:, 0], 1.0)
    return state.r[end][:, [0, 2]].mean(axis=0)


def test_elastica_itself():
    """Pinned: tables of the elastica give 0.714 for the rise and 0.388 for the shortening."""
    np.testing.assert_allclose(elastica(FORCE), [0.61237, 0.71379], atol=1e-5)
    small = elastica(1e-3)
    assert small[1] == pytest.approx(1e-3 / 3, rel=1e-5)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_coarse_cantilever_bends_like_the_elastica(direction):
    """24 cells; up for an upward force."""
    x, z = tip(0.01, 12, direction)
    np.testing.assert_allclose([x, direction * z], elastica(FORCE), atol=2e-4)


def test_thin_cantilever_is_the_elastica():
    """The difference falls as h^2, and what is left after its extrapolation is 2e-6."""
    exact = elastica(FORCE)
    thick, thin = (tip(h, 24) - exact for h in (0.02, 0.01))
    print("differences", thick, thin, "extrapolated", (4 * thin - thick) / 3)
    assert np.linalg.norm(thin) < 1e-4
    assert np.linalg.norm(thick) / np.linalg.norm(thin) == pytest.approx(4.0, abs=0.1)
    np.testing.assert_allclose((4 * thin - thick) / 3, 0.0, atol=2e-6)
