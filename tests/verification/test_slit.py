"""The buckled cup between mirror planes (demos/slit.toml), against a finer mesh."""

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
    "D_over_r": {0.3: 0.6430, 0.4: 0.6612},
    "mouth_length_over_R": {0.3: 0.7879, 0.4: 0.9383},
    "mouth_width_over_R": {0.3: 0.1827, 0.4: 0.2339},
    "energy": {0.3: 1.0501, 0.4: 1.8295},
}
"""On 1,536 cells instead of 1,168, at times t_n."""


def test_slit_is_that_of_a_finer_mesh_and_crosses_nowhere(tmp_path: Path) -> None:
    """Extents and depth within 2 %, energy within 5e-4; rims that touch; no slide; no crossing."""
    summary = cup.run(load_case(DEMO), tmp_path, quiet=True)
    assert summary.ok, summary.message
    broken, touch = read_events(tmp_path)[1:]
    assert (broken["kind"], broken["wavenumber"]) == ("symmetry_breaking", 2)
    assert broken["t_n"] == pytest.approx(0.2831, rel=0.01)
    assert (touch["kind"], touch["parts"]) == ("self_contact", "rim against rim")
    path = read_path(tmp_path)
    for name, values in FINER.items():
        check(path, name, values, 5e-4 if name == "energy" else 0.02)
    for t_n in (0.3, 0.4):
        assert at(path, t_n, "contact_force") > 0.0
        assert at(path, t_n, "interface_m1") < 1e-3
    slit = path.t_n >= broken["t_n"]
    assert path.gap_over_h[slit].min() > 0.0
    states = States(tmp_path)
    for k in np.flatnonzero(slit):
        assert self_crossings(states[int(k)], 6) is None, path.t_n[k]
