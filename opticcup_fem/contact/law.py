r"""The law of contact: energy of a gap, b(x) = -(x^2 - 1)^2 ln(x^2), x the gap over d_hat.

Where faces touch, the energy per area is k d_hat b, k a stress: nought from x = 1 on, twice
continuously differentiable there, and unbounded as the gap closes.
"""

from __future__ import annotations

import numpy as np

from opticcup_fem.snapshot import Floats


def barrier(x: Floats) -> tuple[Floats, Floats, Floats]:
    """Return b, b' and b'' at x > 0; all are nought from x = 1 on."""
    x = np.minimum(x, 1.0)
    square, log = x * x - 1, np.log(x * x)
    value = -square * square * log
    slope = -4 * x * square * log - 2 * square * square / x
    bend = -4 * (3 * x * x - 1) * log - 16 * square + 2 * square * square / (x * x)
    return value, slope, bend


def repulsion(u: Floats) -> tuple[Floats, Floats, Floats]:
    r"""Return psi = -b'(x)/x and its derivatives in u = x^2 > 0; nought from u = 1 on.

    Two points that repel each other with the energy psi/(2 pi) stand for faces whose energy is b:
    over a plane at the distance g, the integral of psi(rho^2)/(2 pi) is b(g).
    """
    u = np.minimum(u, 1.0)
    log, part = np.log(u), (u - 1) / u
    value = 4 * (u - 1) * log + 2 * u * part * part
    slope = 4 * log + 8 * part - 2 * part * part
    bend = 4 / u + 8 / u**2 - 4 * part / u**2
    return value, slope, np.where(u < 1, bend, 0.0)


def rise(x: Floats) -> Floats:
    """Return what grows smoothly from 0 at x = 0 to 1 at x = 1, and stays."""
    x = np.clip(x, 0.0, 1.0)
    share: Floats = x**2 * (3 - 2 * x)
    return share
