"""Figure S4: buckling of free circular plates."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from opticcup_fem.plots import style
from opticcup_fem.report.figures.base import Comparison, Drawn, labelled
from opticcup_fem.report.results import Results
from opticcup_fem.theory import (
    chi,
    plate_buckling_curvature,
    plate_buckling_curvature_by_energy,
    plate_buckling_factor,
)


def plate_figure(results: Results) -> Drawn:
    """Draw Fig. S4: kappa h at which a free bilayer disc leaves axisymmetry."""
    rows = results.rows("plates")
    ratio = np.array([row["ratio"] for row in rows], float)
    kappa = np.array([row["kappa_h"] for row in rows], float)
    grid = np.geomspace(ratio.min(), ratio.max(), 100)
    value = float(chi(1 / 9, 50.0))
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    analytic = plate_buckling_curvature(grid, value, 0.45)
    energy = plate_buckling_curvature_by_energy(grid)
    left.loglog(grid, analytic, color=style.CURVES[0], label="(S35)")
    left.loglog(grid, energy, "--", color=style.CURVES[1], label="comparison of energies")
    left.loglog(ratio, kappa, "o", mfc="white", color=style.INK, label="this code")
    for axis, places in (
        (left.xaxis, (8, 10, 15, 20, 30)),
        (left.yaxis, (0.005, 0.01, 0.02, 0.05)),
    ):
        axis.set_major_locator(FixedLocator(places))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())
    left.legend()
    labelled(left, "$R^p/h$", r"critical $\kappa^p h$", "a")
    right.plot(grid, analytic * grid**2, color=style.CURVES[0])
    right.plot(grid, energy * grid**2, "--", color=style.CURVES[1])
    right.plot(ratio, kappa * ratio**2, "o", mfc="white", color=style.INK)
    right.set_ylim(3.0, 4.8)
    labelled(right, "$R^p/h$", r"critical $\kappa^p h\,(R^p/h)^2$", "b")
    factor = float(plate_buckling_factor(value, 0.45))
    text = [
        "A free bilayer disc (m = 1/9, n = 50, nu = 0.45) whose inner layer grows: first "
        "bifurcation of the axisymmetric bowl, always with "
        f"m = {', '.join(sorted({str(row['wavenumber']) for row in rows}))}. (b) shows the factor "
        "of (h/Rp)^2.",
    ]
    comparisons = [
        Comparison(
            "a_b of a free plate, kappa h (Rp/h)^2, at Rp/h = 30",
            factor,
            float((kappa * ratio**2)[-1]),
            "(S35) against the nonlinear computation; the energy law has 4.461",
        )
    ]
    table = pd.DataFrame(rows)[["ratio", "kappa_h", "wavenumber"]]
    table["kappa_h_ratio2"] = kappa * ratio**2
    table["S35"] = plate_buckling_curvature(ratio, value, 0.45)
    table["energy"] = plate_buckling_curvature_by_energy(ratio)
    return Drawn("s4", "Fig. S4: free circular plates", text, figure, {"s4": table}, comparisons)
