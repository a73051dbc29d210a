"""Runs whose growth comes from the mass balance."""

from pathlib import Path

import meshio
import numpy as np
import pytest

from opticcup_fem.case import parse_case
from opticcup_fem.errors import CaseError, InterruptedRun
from opticcup_fem.records import read_events, read_path
from opticcup_fem.studies import cup, meridian
from opticcup_fem.studies.sweep.meridian_tasks import cup as meridian_cup
from tests.regression.test_restart import require_same_run
from tests.support.cups import coarse_case
from tests.support.interrupted import stop_after

UNIFORM = "10/(1 + 5*t_n)*rho"
"""d(J rho)/dt = 10/(1 + 5 t) J rho: J rho = (1 + 5 t)^2, so that e = 1 + 5 t."""

MERIDIAN = {
    "run": {"model": "meridian", "t_end": 0.02, "max_wavenumber": 2},
    "output": {"states": False, "fields": False, "picture": False, "times": [0.01]},
}


def with_mass(case, **layers):
    data = case.model_dump()
    for layer, keys in layers.items():
        data["mass"][layer] |= keys
    return parse_case(data)


def require_same_path(folder: Path, other: Path, tolerance: float) -> None:
    one, two = read_path(folder), read_path(other)
    assert len(one) == len(two)
    for name in one.columns:
        if one[name].dtype == float and name not in ("residual", "gap_over_h"):
            assert np.abs(one[name] - two[name]).max() < tolerance, name
    events = [read_events(f) for f in (folder, other)]
    assert [e["kind"] for e in events[0]] == [e["kind"] for e in events[1]]
    times = [[e["t_n"] for e in run] for run in events]
    # a fastest descent is flat: its time is known less well than the path
    np.testing.assert_allclose(*times, atol=5e-5)


@pytest.fixture(scope="module")
def prescribed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("prescribed")
    assert cup.run(coarse_case(t_end=0.02), folder, quiet=True).ok
    return folder


def test_uniform_source_is_prescribed_growth(prescribed: Path, tmp_path: Path) -> None:
    case = with_mass(coarse_case(t_end=0.02), iov={"source": UNIFORM}, oov={"source": "0"})
    oov_too = with_mass(case, oov={"source": "3/(1 + 1.5*t_n)*rho"})
    assert cup.run(oov_too, tmp_path, quiet=True).ok
    require_same_path(prescribed, tmp_path, 1e-6)
    rows = read_path(tmp_path)
    assert rows["mass_error_iov"].max() < 1e-10
    np.testing.assert_allclose(rows["e_iov"], 1 + 5 * rows["t_n"], rtol=1e-12)
    np.testing.assert_allclose(rows["e_oov_max"], 1 + 1.5 * rows["t_n"], rtol=1e-12)
    mass = rows["mass_iov"] / rows["mass_iov"][0]
    np.testing.assert_allclose(mass, (1 + 5 * rows["t_n"]) ** 2, rtol=1e-12)


def test_uniform_source_is_prescribed_growth_on_the_meridian(tmp_path: Path) -> None:
    case = parse_case(MERIDIAN)
    assert meridian.run(case, tmp_path / "one", quiet=True).ok
    other = with_mass(case, iov={"source": UNIFORM})
    assert meridian.run(other, tmp_path / "two", quiet=True).ok
    require_same_path(tmp_path / "one", tmp_path / "two", 1e-6)


@pytest.mark.slow
def test_sweeps_know_the_curvature_of_grown_caps() -> None:
    """The row of a cup by its balance is that of the cup with prescribed growth."""
    data = MERIDIAN | {"run": MERIDIAN["run"] | {"t_end": 0.12}}
    one = meridian_cup(data)["row"]
    two = meridian_cup(data | {"mass": {"iov": {"source": UNIFORM}}})["row"]
    assert one["kappa_1"] is not None
    assert two["kappa_1"] == pytest.approx(one["kappa_1"], abs=1e-3)
    assert two["t_1"] == pytest.approx(one["t_1"], abs=2e-5)


@pytest.mark.parametrize("ratio", [5.0, 10.0])
def test_uniform_source_is_prescribed_growth_through_folds(tmp_path: Path, ratio: float) -> None:
    """Whole paths of the meridian, back in time behind a limit point."""
    data = MERIDIAN | {"shape": {"radius_over_thickness": ratio}}
    data["run"] = MERIDIAN["run"] | {"t_end": 0.6}
    case = parse_case(data)
    assert meridian.run(case, tmp_path / "one", quiet=True).ok
    other = with_mass(case, iov={"source": UNIFORM})
    assert meridian.run(other, tmp_path / "two", quiet=True).ok
    require_same_path(tmp_path / "one", tmp_path / "two", 1e-6)


DRAINED = {"source": "-20", "kind": "swelling", "specific_volume": 0.1}

FLUX = with_mass(
    coarse_case(t_end=0.02, output={"times": [0.01, 0.02]}),
    iov={"source": "20*exp(-8*theta**2)", "diffusivity": 0.02, "specific_volume": 0.5},
)


@pytest.mark.slow
def test_mass_that_spreads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Balance closed at every step; interrupted, it goes on as if it had not been; fields."""
    one, two = tmp_path / "one", tmp_path / "two"
    assert cup.run(FLUX, one, quiet=True).ok
    rows = read_path(one)
    assert rows["mass_error_iov"].max() < 1e-10
    assert (rows["rho_iov_max"] - rows["rho_iov_min"]).iloc[-1] > 0.05
    assert (np.diff(rows["mass_iov"]) > 0).all()
    e = rows[["e_iov_min", "e_iov", "e_iov_max"]].iloc[-1].to_numpy()
    assert (np.diff(e) > 1e-3).all()
    with monkeypatch.context() as patch:
        stop_after(2, patch)
        with pytest.raises(InterruptedRun):
            cup.run(FLUX, two, quiet=True)
    assert cup.run(FLUX, two, quiet=True, resume=True).ok
    require_same_run(two, one, 1e-7)
    fields = meshio.read(one / "fields" / "0001.vtu").point_data
    assert np.nanmax(fields["e_iov"]) == pytest.approx(e[2], rel=0.02)
    assert np.isnan(fields["rho_iov"]).any() and np.nanmin(fields["rho_iov"]) > 0.9


@pytest.mark.slow
def test_mass_that_spreads_through_a_snap(tmp_path: Path) -> None:
    """R/h = 10 snaps at its first invagination; the balance is closed across it all the same."""
    steep = {"source": "10/(1 + 5*t_n)*rho*(1.4 - theta)", "diffusivity": 0.05}
    case = with_mass(coarse_case(10.0, t_end=0.07, output={"times": [0.07]}), iov=steep)
    assert cup.run(case, tmp_path, quiet=True).ok
    rows = read_path(tmp_path)
    assert rows["jump"].sum() == 1
    jump = int(np.argmax(rows["jump"]))
    assert rows["D_over_r"].iloc[jump] - rows["D_over_r"].iloc[jump - 1] > 0.1
    assert rows["mass_error_iov"].max() < 1e-10
    assert (rows["rho_iov_max"] - rows["rho_iov_min"]).iloc[-1] > 0.01
    event = read_events(tmp_path)[0]
    assert event["kind"] == "primary_invagination" and event["type"] == "fold"


def test_source_that_takes_all_mass_ends_the_run_with_a_sentence(tmp_path: Path) -> None:
    """dM/dt = -20 J with J near 1: nothing is left near t_n = 0.05."""
    steps = {"initial_step": 0.02, "min_step": 2e-3}
    case = with_mass(coarse_case(t_end=0.1, solver=steps), oov=DRAINED)
    summary = cup.run(case, tmp_path, quiet=True)
    assert not summary.ok
    assert "the mass balance of layer oov leaves no mass at t_n = 0.05" in summary.message
    rows = read_path(tmp_path)
    assert 0.045 < rows["t_n"].iloc[-1] < 0.06 and 0 < rows["rho_oov_min"].min() < 0.2


@pytest.mark.slow
def test_the_same_on_the_meridian(tmp_path: Path) -> None:
    run = MERIDIAN["run"] | {"t_end": 0.1}
    case = parse_case(MERIDIAN | {"mass": {"oov": DRAINED}, "run": run})
    summary = meridian.run(case, tmp_path, quiet=True)
    assert not summary.ok and "the mass balance of layer oov" in summary.message


def test_meridian_refuses_what_varies_in_phi(tmp_path: Path) -> None:
    case = parse_case(MERIDIAN | {"mass": {"iov": {"source": "rho*cos(phi)"}}})
    with pytest.raises(CaseError, match=r"mass\.iov\.source .* leave phi out"):
        meridian.run(case, tmp_path, quiet=True)
