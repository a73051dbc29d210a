"""Columns of path.csv at output times, and their comparison with reference values."""

import numpy as np
import pandas as pd
import pytest


def at(path: pd.DataFrame, t_n: float, name: str) -> float:
    """Return a column at an output time."""
    (value,) = path.loc[np.isclose(path.t_n, t_n, rtol=0, atol=1e-12), name]
    return float(value)


def check(path: pd.DataFrame, name: str, values: dict[float, float], tolerance: float) -> None:
    """Compare a column with reference values at output times."""
    found = {t: at(path, t, name) for t in values}
    print(name, {t: f"{100 * (found[t] / values[t] - 1):+.3f} %" for t in values})
    for t, value in values.items():
        assert found[t] == pytest.approx(value, rel=tolerance), f"{name} at t_n = {t}"
