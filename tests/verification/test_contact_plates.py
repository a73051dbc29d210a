"""Half a sphere between two plates: Reissner's slope, a flat contact, and then a dimple."""

import numpy as np
import pytest

from tests.support.plates import DISTANCE, pressed, reissner

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("ratio", [50.0, 100.0])
def test_flat_contact_and_then_a_dimple(ratio: float) -> None:
    """F = 4 E h^2 delta/(R sqrt(3 (1 - nu^2))) at small delta; a dimple beyond two thicknesses."""
    states = pressed(ratio, 2.7, step=0.06)
    plate, apex, force, gap, radius = (
        np.array([getattr(state, name) for state in states])
        for name in ("plate", "apex", "force", "apex_gap", "radius")
    )
    small = (apex > 1e-3) & (apex < 0.15)
    assert small.sum() >= 2
    for deflection, measured in zip(apex[small], force[small], strict=True):
        assert measured == pytest.approx(reissner(float(deflection)), rel=0.05)
    flat = (plate > 0.2) & (plate < 1.6)
    assert flat.sum() >= 8
    assert (gap[flat] > 0).all() and (gap[flat] < 1.4 * DISTANCE).all()
    assert (np.diff(force[flat]) > 0).all() and (np.diff(radius[flat]) >= 0).all()
    # the apex leaves the plate, which from then on stands on a ring
    leaves = float(plate[np.argmax(gap > 3 * DISTANCE)])
    assert 1.8 < leaves < 2.4
    assert gap[-1] > 1.2
