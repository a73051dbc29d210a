"""Azimuthal content of analytic motions, and the axisymmetric mean of analytic cups.

What matters: a motion in one wavenumber has that wavenumber wherever the cup lies and however it is
turned; shares are those of the energies; the mean keeps what is axisymmetric and nothing else.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from opticcup_fem.observables import Observer
from opticcup_fem.snapshot import Snapshot
from opticcup_fem.wavenumbers import AxisymmetricPart, AzimuthalContent, azimuthal_content
from tests.support.shapes import cup, deformed, sphere_angles, sphere_mesh

TURN = Rotation.from_rotvec([0.4, -0.9, 0.2]).as_matrix()
SHIFT = np.array([0.3, -0.2, 0.5])


@pytest.fixture(scope="module")
def grown() -> Snapshot:
    """Return an axisymmetric cup on cells of size 0.2."""
    return deformed(sphere_mesh(0.2), cup)


@pytest.fixture(scope="module")
def observer(grown: Snapshot) -> Observer:
    return Observer(grown)


def wave(snapshot: Snapshot, m: int, phase: float = 0.3) -> np.ndarray:
    """Return a smooth motion in wavenumber m, along e_r, e_phi and e_z."""
    theta, phi = sphere_angles(snapshot.reference)
    shape = np.sin(theta) ** max(m, 1)
    cosine, sine = np.cos(m * phi + phase), np.sin(m * phi + phase)
    radial, around, up = shape * cosine, -0.4 * shape * sine, 0.7 * shape * np.cos(theta) * cosine
    x, y = np.cos(phi), np.sin(phi)
    return np.column_stack([radial * x - around * y, radial * y + around * x, up])


def placed(snapshot: Snapshot) -> Snapshot:
    """Return the snapshot turned and shifted."""
    return replace(snapshot, position=snapshot.position @ TURN.T + SHIFT)


@pytest.mark.parametrize("m", range(7))
def test_motion_in_one_wavenumber(grown: Snapshot, observer: Observer, m: int) -> None:
    """cos(m phi + phase) has wavenumber m and purity 1, up to the cubic's interpolation error."""
    content = azimuthal_content(observer, grown, wave(grown, m))
    assert content.wavenumber == m
    assert content.purity == pytest.approx(1.0, abs=1e-4)
    assert int(np.argmax(content.interface)) == m
    assert max(content.interface) == 1.0
    assert np.delete(content.interface, m).max() < 0.02
    assert sum(content.shares) == pytest.approx(1.0)
    assert content.asymmetry < 1e-6
    assert content.describe() == {"wavenumber": m, "purity": content.purity}


@pytest.mark.parametrize("m", [0, 1, 3])
def test_content_does_not_depend_on_the_cups_place(
    grown: Snapshot, observer: Observer, m: int
) -> None:
    """State and motion turned together have the same content; the motion alone has another."""
    motion = wave(grown, m)
    here = azimuthal_content(observer, grown, motion)
    there = azimuthal_content(observer, placed(grown), motion @ TURN.T)
    np.testing.assert_allclose(there.shares, here.shares, atol=1e-10)
    np.testing.assert_allclose(there.interface, here.interface, atol=1e-8)
    unturned = azimuthal_content(observer, placed(grown), motion)
    assert np.abs(np.subtract(unturned.shares, here.shares)).max() > 0.01


def test_shares_are_those_of_the_mean_squares(grown: Snapshot, observer: Observer) -> None:
    """Twice the amplitude is four times the share, also between m = 0 and the others."""
    for m, n in ((2, 3), (0, 4)):
        alone = [wave(grown, one) for one in (m, n)]
        theta, _ = sphere_angles(grown.reference)
        square = [np.mean(motion**2, axis=1) @ np.ones(len(theta)) for motion in alone]
        both = azimuthal_content(observer, grown, alone[0] + 2 * alone[1])
        once = azimuthal_content(observer, grown, alone[0] + alone[1])
        ratio = [one.shares[n] / one.shares[m] for one in (once, both)]
        assert ratio[1] == pytest.approx(4 * ratio[0], rel=1e-3)
        # nodes are spread over the sphere unevenly: the ratio itself is near that of their sums
        assert ratio[0] == pytest.approx(square[1] / square[0], rel=0.3)


def test_wavenumber_and_purity_are_those_of_the_largest_share() -> None:
    content = AzimuthalContent((0.1, 0.2, 0.65, 0.05), (0.3, 0.1, 1.0), 1e-8)
    assert (content.wavenumber, content.purity) == (2, 0.65)


def test_asymmetry_is_the_states_own(grown: Snapshot, observer: Observer) -> None:
    """A bent state has it, whatever its motion is."""
    bent = replace(grown, position=grown.position + 0.05 * wave(grown, 2))
    content = azimuthal_content(observer, bent, wave(grown, 0))
    assert content.wavenumber == 0
    assert content.asymmetry > 1e-4


def test_mean_of_an_axisymmetric_cup_is_itself(grown: Snapshot, observer: Observer) -> None:
    """Up to the error of cubic interpolation, and wherever it lies."""
    part = AxisymmetricPart(observer, grown)
    error = np.linalg.norm(part(grown) - grown.position, axis=1)
    assert error.max() < 1e-3
    again = np.linalg.norm(part(placed(grown)) - (part(grown) @ TURN.T + SHIFT), axis=1)
    assert again.max() < 1e-8


@pytest.mark.parametrize("m", [2, 3, 5])
def test_mean_leaves_out_every_wave(grown: Snapshot, observer: Observer, m: int) -> None:
    """Of a cup with a wave of m >= 2 the mean is that of the cup, to second order in the wave."""
    part = AxisymmetricPart(observer, grown)
    bent = replace(grown, position=grown.position + 0.03 * wave(grown, m))
    assert np.abs(bent.position - grown.position).max() > 0.02
    assert np.abs(part(bent) - part(grown)).max() < 1e-4


def test_mean_keeps_what_is_axisymmetric(grown: Snapshot, observer: Observer) -> None:
    """A motion of m = 0, along e_r and e_z and a twist, stays."""
    part = AxisymmetricPart(observer, grown)
    moved = replace(grown, position=grown.position + 0.03 * wave(grown, 0))
    change = np.linalg.norm(part(moved) - moved.position, axis=1)
    assert change.max() < 1e-3
    assert np.abs(part(moved) - part(grown)).max() > 0.02
