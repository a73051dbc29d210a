"""Open caps and disks on the meridian model: run folders, the surface model, and closed forms.

What matters: the natural forms b_nat = Lambda^2 (b_ref + kappa a_ref) of (S17), (S18).  A cap with
kappa R = 1 is flat when free of stress, so that its edge tangent is horizontal there.
"""

from __future__ import annotations

import math
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pandas as pd
import pytest

from opticcup_fem.case import Case, parse_case
from opticcup_fem.cli import app
from opticcup_fem.meridian.observables import apex_forms
from opticcup_fem.mesh import open_cap_mesh
from opticcup_fem.records import read_events, read_path
from opticcup_fem.shell.growth import LinearGrowth
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.supports import held_components
from opticcup_fem.studies import meridian
from opticcup_fem.studies.meridian import path_of
from opticcup_fem.studies.model import sections_of
from opticcup_fem.theory import natural_curvature, natural_stretch, snapping_limit
from tests.support.shells import loaded

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


def case_of(kind: str, ratio: float, angle_deg: float = 40.0) -> Case:
    return parse_case(
        {
            "shape": {
                "kind": kind,
                "radius_over_thickness": ratio,
                "opening_angle_deg": angle_deg,
            },
            "run": {"model": "meridian", "max_wavenumber": 2},
        }
    )


@pytest.mark.parametrize("kind", ["cup", "cap", "disk"])
def test_whole_paths_from_the_command_line(kind: str, tmp_path: Path) -> None:
    settings = [f"shape.kind={kind}", "shape.radius_over_thickness=10", "run.max_wavenumber=3"]
    arguments = [part for setting in settings for part in ("--set", setting)]
    chick = str(ROOT / "demos" / "chick.toml")
    app(
        ["run", chick, "--model", "meridian", "--out", str(tmp_path), "--quiet", *arguments],
        standalone_mode=False,
    )
    path = read_path(tmp_path)
    assert path.t_n.iloc[-1] == 1.0
    counts = [name for name in path if name.startswith("negative_m")]
    assert counts == [f"negative_m{m}" for m in range(4)]
    for name in ("bifurcation.png", "summary.png", "sections.npz"):
        assert (tmp_path / name).stat().st_size > 10_000
    # every output time has its fields, read back as many
    assert (tmp_path / "fields.pvd").read_text().count("<DataSet") == 11
    losses = [one for one in read_events(tmp_path) if one["kind"] == "symmetry_breaking"]
    if kind == "cup":
        assert not losses
    else:
        assert losses[0]["wavenumber"] == 2
        assert (tmp_path / "modes.pvd").read_text().count("<DataSet") >= len(losses)
    if kind == "disk":
        # 3.373 of the nonlinear reference, which has more Gauss points
        assert losses[0]["kappa_cap_R"] * 10 == pytest.approx(3.373, rel=5e-3)


def test_a_little_grown_disk_has_the_natural_curvature() -> None:
    """Its difference to (S18), of order (kappa Rp^2/h)^2, is gone at a bow of 0.05."""
    case = case_of("disk", 20.0)
    path = path_of(case)
    t_n = 0.05 / 20**2 / (natural_curvature(1.0, 1.005, 1 / 9, 50.0, 1.0, 1.005**2) / 0.001)
    *_, point = path.follow(float(t_n))
    e = 1 + 5 * point.t_n
    kappa = float(natural_curvature(1.0, e, 1 / 9, 50.0, 1.0, e**2)) * 20
    a, _, _, b, _, _ = apex_forms(path.problem.shell, point.state)
    assert b / a == pytest.approx(kappa, rel=1e-3)
    stretch = float(natural_stretch(1.0, e, 1 / 9, 50.0, 1.0, e**2))
    assert math.sqrt(a) - 1 == pytest.approx(stretch - 1, rel=2e-2)


def test_an_open_cap_is_that_of_the_surface_model() -> None:
    """Short of its snap, R/h = 10 at t_n = 0.015: energy to 1e-5, distance of apex and rim."""
    case, t_n = case_of("cap", 10.0), 0.015
    path = path_of(case)
    *_, point = path.follow(t_n)
    r = point.state.r
    mesh = open_cap_mesh(case.shape.opening_angle, 0.2, 0.1, comm=MPI.COMM_SELF)
    laws = {"iov": LinearGrowth(5 * t_n), "ecm": LinearGrowth(0.0)}
    shell = Shell(mesh, {"cap": sections_of(case)["cap"]}, laws)
    x = shell.reference
    rim = np.flatnonzero(np.abs(x[:, 2] - math.cos(case.shape.opening_angle)) < 1e-9)
    places = [tuple(x[rim[np.argmax(x[rim, axis])]]) for axis in (0, 1)]
    held = held_components(shell, [((0.0, 0.0, 1.0), "xyz"), (places[0], "yz"), (places[1], "z")])
    state, _, problem = loaded(shell, held, 12, most=25)
    inertia = problem.inertia()
    assert inertia is not None and inertia.negative == 0
    energy = path.problem.shell.energy(point.state, t_n)
    assert shell.energy(state) == pytest.approx(energy, rel=1e-5)
    apart = np.linalg.norm(state.r[rim] - state.r[np.argmax(x[:, 2])], axis=1)
    np.testing.assert_allclose(apart, np.linalg.norm(r[-1] - r[0]), rtol=1e-5)


def horizontal_curvature(rows: pd.DataFrame) -> float:
    """Return kappa R where the edge tangent is first horizontal."""
    angle = rows.tangent_angle_interface.to_numpy()
    after = int(np.argmax(angle < 0))
    pair = slice(after - 1, after + 1)
    return float(np.interp(0.0, -angle[pair], rows.kappa_cap_R.to_numpy()[pair]))


@pytest.mark.parametrize("theta_bar", [1.5, 1.7, 1.9])
def test_open_caps_evert_at_their_natural_curvature_and_snap_above_the_limit(
    theta_bar: float, tmp_path: Path
) -> None:
    """At alpha = 10 degrees, where (S26) holds: limit points above theta_s = 1.8818 only."""
    ratio = (theta_bar / math.radians(10)) ** 2
    case = case_of("cap", ratio, 10.0)
    case = case.model_copy(update={"run": case.run.model_copy(update={"t_end": 0.01})})
    assert meridian.run(case, tmp_path, quiet=True).ok
    rows = read_path(tmp_path)
    found = horizontal_curvature(rows)
    print(theta_bar, ratio, found, rows.t_n[rows.limit_point].tolist())
    assert found == pytest.approx(1.0, rel=0.02)
    assert rows.limit_point.any() == (theta_bar > snapping_limit(0.45))
