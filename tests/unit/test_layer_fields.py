"""Stress of the layers of an axisymmetric state."""

from __future__ import annotations

import numpy as np
import pytest

from opticcup_fem.meridian.mesh import Grading, MeridianMesh
from opticcup_fem.meridian.shell import MeridianShell
from opticcup_fem.shell import closures
from opticcup_fem.shell.section import Layer, Section
from opticcup_fem.studies.sweep.layer_fields import layer_stresses
from tests.support.meridians import COARSE, LAWS, PROFILES, bent_state, bilayer, shell_on


@pytest.mark.parametrize("poisson", [0.3, 0.5])
def test_one_fibre_at_the_mid_surface_carries_the_membrane_force(poisson):
    """With xi = 0 alone, N^11 = 2 dW/da_11 is h J sigma/a_11, with sign and density ratio."""
    wall = Section([Layer("oov", 0.1, 1.0, poisson, 1)])
    sections = {"cap": bilayer(0.1), "oov": wall}
    shell = MeridianShell(MeridianMesh(PROFILES["closed"], COARSE), sections, LAWS)
    state, t_n = bent_state(shell, seed=2), 0.07
    cells = shell.mesh.region["oov"]
    forms = shell.forms_at_points(state)
    stress = layer_stresses(shell, state, t_n, "oov")["oov"]
    a_11, a_22 = forms[cells, :, 0], forms[cells, :, 1]
    stretch = closures.mean_stretches(
        shell.closure,
        wall,
        shell.growth_at(t_n, "oov"),
        forms[cells].reshape(-1, 6),
        np.broadcast_to([1.0, 1.0, 0.0], (a_11.size, 3)),
        shell.mesh.profile.curvature,
    )["oov"].reshape(a_11.shape)
    force = 0.1 * np.sqrt(a_11 * a_22) * stretch * stress / a_11
    expected = 2 * shell.resultants_of(forms, t_n).stress[cells, :, 0]
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(force, expected, rtol=1e-11)


def test_the_reference_state_is_free_of_stress():
    shell = shell_on(PROFILES["closed"], grading=Grading(0.08))
    for region in ("cap", "oov"):
        for stress in layer_stresses(shell, shell.reference_state(), 0.0, region).values():
            # the cubic interpolation of the sphere
            assert np.abs(stress).max() < 3e-3
