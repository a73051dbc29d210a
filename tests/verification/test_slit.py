"""The buckled cup between mirrors (demos/slit.toml) to t_n = 1, against a finer mesh."""

from pathlib import Path

import numpy as np
import pytest

from opticcup_fem.case import load_case
from opticcup_fem.crossing import self_crossings
from opticcup_fem.records import read_events, read_path
from opticcup_fem.states import States
from opticcup_fem.studies import cup
from tests.support.path_rows import at, check

pytestmark = pytest.mark.slow

DEMO = Path(__file__).parents[2] / "demos" / "slit.toml"

FINER = {
    "D_over_r": {0.3: 0.6496, 0.4: 0.6714, 0.6: 0.7302, 0.8: 0.7448, 1.0: 0.7281},
    "mouth_length_over_R": {0.3: 0.7887, 0.4: 0.9382, 0.6: 1.2299, 0.8: 1.5208, 1.0: 1.8139},
    "mouth_width_over_R": {0.3: 0.1837, 0.4: 0.2316, 0.6: 0.5141, 0.8: 0.7751, 1.0: 0.9635},
    "energy": {0.3: 1.0499, 0.4: 1.8292, 0.6: 3.8515, 0.8: 6.4625, 1.0: 9.6565},
}
"""On 4,700 cells, .02 R large where the slit folds, on another pattern of mirrors; at times t_n."""

WITHIN = {
    "D_over_r": 0.003,
    "mouth_length_over_R": 0.001,
    "mouth_width_over_R": 0.01,
    "energy": 1e-4,
}


def test_slit_is_that_of_a_finer_mesh_and_crosses_nowhere(tmp_path: Path) -> None:
    """Extents, depth and energy; one loss of symmetry and no slip; mirrored; no crossing."""
    summary = cup.run(load_case(DEMO), tmp_path, quiet=True)
    assert summary.ok, summary.message
    broken, touch = read_events(tmp_path)[1:]
    assert (broken["kind"], broken["wavenumber"]) == ("symmetry_breaking", 2)
    assert broken["t_n"] == pytest.approx(0.2831, rel=0.005)
    assert (touch["kind"], touch["parts"]) == ("self_contact", "rim against rim")
    path = read_path(tmp_path)
    for name, values in FINER.items():
        check(path, name, values, WITHIN[name])
    assert at(path, 0.3, "mouth_width_over_R") == pytest.approx(0.1837, rel=0.005)
    slit = path.t_n > broken["t_n"]
    assert not path.jump[path.t_n > 0.29].any()
    assert path.gap_over_h[slit].min() > 0.0
    assert (path.contact_force[slit] > 0.0).all()
    assert path.interface_m1.max() < 1e-9
    states = States(tmp_path)
    for k in np.flatnonzero(slit)[::3]:
        assert self_crossings(states[int(k)], 6) is None, path.t_n[k]
