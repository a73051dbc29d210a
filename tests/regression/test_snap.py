"""The snap of a coarse cup as a critical point: its event, its mode on file, its picture."""

from pathlib import Path

import numpy as np
import pytest

from opticcup_fem.records import read_events, read_path
from opticcup_fem.studies import cup
from tests.support.cups import coarse_case


@pytest.fixture(scope="module")
def snapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A coarse cup of R/h = 10 through its snap, with picture and fields."""
    folder = tmp_path_factory.mktemp("snap")
    summary = cup.run(coarse_case(10.0, 0.045, output={"picture": True}), folder, quiet=True)
    assert summary.ok, summary.message
    return folder


def test_snap_is_a_localised_limit_point_of_m_0(snapped: Path) -> None:
    """Within its bracket, a per cent from .04092 (a coarse mesh), with an axisymmetric mode."""
    (event,) = read_events(snapped)
    assert (event["kind"], event["type"]) == ("primary_invagination", "fold")
    low, high = event["t_n_range"]
    assert low <= event["t_n"] <= high and high - low < 2e-4
    assert event["t_n"] == pytest.approx(0.04092, rel=0.03)
    assert event["wavenumber"] == 0 and event["purity"] > 0.99
    assert 0 < event["eigenvalue"] < 0.3 * event["eigenvalues"][1]
    path = read_path(snapped)
    assert path.jump.sum() == 1 and (path.negative_eigenvalues == 0).all()


def test_critical_mode_is_on_file_and_drawn(snapped: Path) -> None:
    """critical.npz holds the state, its mode and spectrum; modes.pvd one file; the picture is."""
    with np.load(snapped / "critical.npz") as file:
        arrays = dict(file)
    (event,) = read_events(snapped)
    assert arrays["t_n"] == [event["t_n"]] and arrays["wavenumber"] == [0]
    assert arrays["kind"] == ["limit_point"]
    assert arrays["interface"].shape == (1, 9) and arrays["interface"][0].argmax() == 0
    assert arrays["shares"][0].sum() == pytest.approx(1.0)
    vertices = arrays["position"].shape[1]
    assert arrays["position"].shape == arrays["mode"].shape == (1, vertices, 3)
    assert arrays["triangles"].min() == 0 and arrays["triangles"].max() == vertices - 1
    lengths = np.linalg.norm(arrays["mode"][0], axis=1)
    assert 0.9 < lengths.max() < 1.1
    across = np.abs(arrays["mode"][0].mean(axis=0))[:2]
    assert across.max() < 0.02
    assert (snapped / "modes.pvd").read_text().count("<DataSet") == 1
    assert (snapped / "critical.png").stat().st_size > 10_000
