"""The load axis of a run: the natural curvature of its cap, prescribed or by mass balance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from opticcup_fem.case import Case
from opticcup_fem.stimulus import stimulus_of
from opticcup_fem.theory.prediction import (
    cap_curvature_of_case,
    cap_curvature_of_growth,
    growth_factor,
    stiffness_factor,
)

CAP = ("ecm", "iov")


def cap_curvature_of_run(case: Case, rows: Sequence[Mapping[str, Any]], t_n: float) -> float:
    """Return kappa_cap R at a time of a run.

    Growth by mass balance is the layer's mean, linear between the rows; prescribed growth is that
    of the apex.

    Args:
        case: The case.
        rows: Its rows so far, or columns that begin with ``t_n`` and ``e_<layer>``.
        t_n: Normalised time.
    """
    balanced = [layer for layer in CAP if getattr(case.mass, layer).source != ""]
    if not balanced:
        return float(cap_curvature_of_case(case, np.float64(t_n)))
    times = np.array([row["t_n"] for row in rows], dtype=float)
    ahead = times >= np.maximum.accumulate(times)
    factors, ratios = [], []
    for layer in CAP:
        if layer in balanced:
            known = np.array([row[f"e_{layer}"] for row in rows], dtype=float)
            e = np.interp(t_n, times[ahead], known[ahead])
        else:
            e = growth_factor(case, layer, t_n)
        rho = stimulus_of(case, layer).density_ratio_of_factor(e)
        factors.append(e)
        ratios.append(rho * stiffness_factor(case, layer, t_n))
    e_1, e_2 = factors
    return float(cap_curvature_of_growth(case, (e_1, e_2), (ratios[0], ratios[1])))
