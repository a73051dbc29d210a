"""Layer fields of states whose stress and thickness are known.

What matters: which component is meridional and which azimuthal, the sign of stress, and that faces
stand off the mid-surface by the layers' current thickness on the right side.
"""

from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

from opticcup_fem.mesh import cup_mesh, disk_mesh
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.recovery import capture, layer_fields, layer_heights
from opticcup_fem.shell.section import Layer, Section

NU, MU = 0.45, 3.0
LAMBDA = 2 * MU * NU / (1 - 2 * NU)


def psi(l_1: float, l_2: float, l_3: float) -> float:
    """Psi_0 (S8) of principal elastic stretches."""
    J = l_1 * l_2 * l_3
    I_1 = l_1**2 + l_2**2 + l_3**2
    return LAMBDA / 4 * (J**2 - 1 - 2 * np.log(J)) + MU / 2 * (I_1 - 3 - 2 * np.log(J))


def plane_stress(l_1: float, l_2: float) -> tuple[float, float, float]:
    """Thickness stretch and the two Cauchy stresses of a sheet stretched in its plane."""
    l_3 = np.sqrt((LAMBDA + 2 * MU) / (LAMBDA * (l_1 * l_2) ** 2 + 2 * MU))
    h = 1e-6
    s_1 = (psi(l_1 + h, l_2, l_3) - psi(l_1 - h, l_2, l_3)) / (2 * h) / (l_2 * l_3)
    s_2 = (psi(l_1, l_2 + h, l_3) - psi(l_1, l_2 - h, l_3)) / (2 * h) / (l_1 * l_3)
    return float(l_3), s_1, s_2


@pytest.fixture(scope="module")
def disk() -> Shell:
    section = Section([Layer("sheet", 0.02, MU, NU, 2)])
    mesh = disk_mesh(1.0, 0.5, comm=MPI.COMM_SELF)
    return Shell(mesh, {"disk": section}, {"sheet": LinearGrowth(0.0)})


def stretched(shell: Shell, matrix: np.ndarray) -> ShellState:
    state = replace(shell.reference_state(), r=shell.reference @ matrix.T)
    state = shell.with_mean_directors(state)
    return replace(state, kappa=shell.curvature_of(state))


def test_meridional_and_azimuthal_stress(disk: Shell) -> None:
    """Pulled along x and pressed along y: the meridional stress is the pull on the x axis only."""
    l_x, l_y = 1.2, 0.9
    fields = layer_fields(disk, stretched(disk, np.diag([l_x, l_y, 1.0])), "disk")["sheet"]
    l_3, s_x, s_y = plane_stress(l_x, l_y)
    assert s_x > 0 > s_y
    assert fields.thickness_stretch == pytest.approx(np.full_like(fields.thickness_stretch, l_3))
    trace = fields.stress[..., 0] + fields.stress[..., 1]
    assert trace == pytest.approx(np.full_like(trace, s_x + s_y), rel=1e-6)
    x, y, _ = np.moveaxis(disk.reference[disk.spaces.nodes].mean(axis=1), -1, 0)
    phi, mean = np.arctan2(y, x), fields.stress.mean(axis=1)
    near_x = np.abs(np.sin(phi)) < 0.15
    near_y = np.abs(np.cos(phi)) < 0.15
    assert near_x.any() and near_y.any()
    assert np.allclose(mean[near_x, 0], s_x, rtol=0.1, atol=0.1 * s_x)
    assert np.allclose(mean[near_y, 1], s_x, rtol=0.1, atol=0.1 * s_x)
    # a meridian's image leans towards x, the pull: shear has the sign of -sin 2 phi
    diagonal = np.abs(np.sin(2 * phi)) > 0.8
    assert (np.sign(mean[diagonal, 2]) == -np.sign(np.sin(2 * phi[diagonal]))).all()


def test_turning_the_sheet_changes_no_component(disk: Shell) -> None:
    """Components refer to material directions: a rigid motion leaves them alone."""
    stretch = np.diag([1.2, 0.9, 1.0])
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]]) @ np.array(
        [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    )
    one = layer_fields(disk, stretched(disk, stretch), "disk")["sheet"].stress
    other = layer_fields(disk, stretched(disk, turn @ stretch), "disk")["sheet"].stress
    assert np.abs(one - other).max() < 1e-10


def test_free_growth_is_free_of_stress_and_thickness_change(disk: Shell) -> None:
    """A sheet that follows its own growth has no stress; held back, it is in compression e^2."""
    grown = Shell(disk.surface_mesh, disk.sections, {"sheet": LinearGrowth(0.5, mass_change=True)})
    grown.set_time(0.6)
    e = 1.3
    follows = layer_fields(grown, stretched(grown, np.diag([e, e, 1.0])), "disk")["sheet"]
    assert np.abs(follows.stress).max() < 1e-9
    assert np.abs(follows.thickness_stretch - 1).max() < 1e-9
    back = layer_fields(grown, stretched(grown, np.eye(3)), "disk")["sheet"]
    _, s, _ = plane_stress(1 / e, 1 / e)
    # rho_r = e^2 and the reference volume is 1/e^2 of the grown one: the same Cauchy stress
    assert back.stress[..., 0] == pytest.approx(np.full(back.stress.shape[:2], s), rel=1e-6)
    assert s < 0


def test_layers_of_a_grown_sphere_pull_and_push() -> None:
    """A bilayer sphere of radius r: each layer's mean of the fibres' exact plane stress.

    The IOV grows and the ECM does not: it is pressed, the ECM pulled.  With R = 1 a fibre at height
    xi has the natural metric e^2 (1 + 2 xi) and the current one r^2 (1 + 2 xi l/r), l the layer's
    lambda_3 at the middle surface; the energy counts its area, 1 + 2 xi, as 1, and so its stress is
    that of a free fibre over 1 + 2 xi.
    """
    h, t_n, radius, rate = 0.2, 0.1, 1.2, 5.0
    layers = [Layer("iov", 0.9 * h, MU, NU, 5), Layer("ecm", 0.1 * h, MU, NU, 2)]
    laws = {"iov": LinearGrowth(rate), "ecm": LinearGrowth(0.0)}
    mesh = cup_mesh(0.7, 0.34, 0.2, 0.5, comm=MPI.COMM_SELF)
    shell = Shell(mesh, dict.fromkeys(("cap", "oov"), Section(layers)), laws)
    shell.set_time(t_n)
    fields = layer_fields(shell, stretched(shell, radius * np.eye(3)), "oov")
    half_traces = {}
    for name, low, high, e in (("iov", -0.5, 0.4, 1 + rate * t_n), ("ecm", 0.4, 0.5, 1.0)):
        x, w = np.polynomial.legendre.leggauss(20)
        heights = h * ((high - low) / 2 * x + (high + low) / 2)
        l_middle, _, _ = plane_stress(radius / e, radius / e)
        stretches = [
            radius * np.sqrt(1 + 2 * xi * l_middle / radius) / (e * np.sqrt(1 + 2 * xi))
            for xi in heights
        ]
        exact = sum(
            wi / 2 / (1 + 2 * xi) * plane_stress(s, s)[1]
            for wi, xi, s in zip(w, heights, stretches, strict=True)
        )
        half_traces[name] = fields[name].stress[..., :2].mean(axis=-1)
        assert half_traces[name].mean() == pytest.approx(exact, rel=5e-3)
        assert np.abs(fields[name].stress[..., 2]).max() < 0.02 * abs(exact)
    assert half_traces["iov"].max() < 0 < half_traces["ecm"].min()


def test_heights_alone_are_those_of_the_faces() -> None:
    """Heights without stresses put the faces where the layers' fields put them."""
    h, t_n = 0.2, 0.2
    cap = Section([Layer("iov", 0.9 * h, 1.0, NU, 5), Layer("ecm", 0.1 * h, 50.0, NU, 2)])
    sections = {"cap": cap, "oov": Section([Layer("oov", h, 1.0, NU, 5)])}
    laws = {name: LinearGrowth(rate) for name, rate in (("iov", 3.0), ("ecm", 0.0), ("oov", 1.0))}
    shell = Shell(cup_mesh(0.7, 0.34, 0.2, 0.5, comm=MPI.COMM_SELF), sections, laws)
    shell.set_time(t_n)
    state = stretched(shell, np.diag([1.2, 1.3, 1.1]))
    snapshot = capture(shell, state, t_n)
    assert snapshot is not None
    for region, heights in layer_heights(shell, state).items():
        middle = snapshot.position[snapshot.cells[snapshot.cells_of(region)]]
        apart = np.linalg.norm(snapshot.faces[region] - middle[:, :, None], axis=-1)
        assert np.abs(heights[..., 0] + apart[..., 0]).max() < 1e-12
        assert np.abs(heights[..., -1] - apart[..., -1]).max() < 1e-12
        assert (np.diff(heights, axis=-1) > 0).all()


def test_faces_stand_off_by_the_current_thickness() -> None:
    """On a sphere the inner face lies h/2 inside; the ECM lies outside the IOV."""
    h = 0.2
    cap = Section([Layer("iov", 0.9 * h, 1.0, NU, 5), Layer("ecm", 0.1 * h, 50.0, NU, 2)])
    sections = {"cap": cap, "oov": Section([Layer("oov", h, 1.0, NU, 5)])}
    laws = {name: LinearGrowth(0.0) for name in ("iov", "ecm", "oov")}
    shell = Shell(cup_mesh(0.7, 0.34, 0.2, 0.5, comm=MPI.COMM_SELF), sections, laws)
    snapshot = capture(shell, shell.reference_state(), 0.0)
    assert snapshot is not None
    radii = np.linalg.norm(snapshot.faces["cap"], axis=-1)
    assert radii.mean(axis=(0, 1)) == pytest.approx([0.9, 1.08, 1.1], abs=2e-3)
    radii = np.linalg.norm(snapshot.faces["oov"], axis=-1)
    assert radii.mean(axis=(0, 1)) == pytest.approx([0.9, 1.1], abs=2e-3)
    in_cap = snapshot.region == snapshot.region_ids["cap"]
    assert np.isnan(snapshot.thickness_stretch["oov"][in_cap]).all()
    assert np.isfinite(snapshot.stress["ecm"][in_cap]).all()
