"""The model-form section: closures, thickness rules, mass change off, the surface model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from opticcup_fem.diagram.fits import transition
from opticcup_fem.diagram.regimes import regime
from opticcup_fem.plots import style
from opticcup_fem.report.figures.base import (
    EVENT_COLOURS,
    Comparison,
    Drawn,
    Row,
    cross_handle,
    draw_path,
    event_handles,
    labelled,
    mark,
    shades,
)
from opticcup_fem.report.figures.cups import THETA
from opticcup_fem.report.figures.diagram import GAMMA, KAPPA, PLATE, draw_diagram, fits_of
from opticcup_fem.report.plan import READING_RATIOS, READINGS
from opticcup_fem.report.results import Results
from opticcup_fem.theory import cap_curvature

DEFAULT = "layer-stretch (2, 5, 5)"


def _by_reading(results: Results) -> dict[str, list[Row]]:
    """Return the rows of every reading, the default one first."""
    found: dict[str, list[Row]] = {
        DEFAULT: [r for r in results.rows("slenderness") if r["ratio"] in READING_RATIOS]
    }
    rows = results.rows("readings")
    for name, reading in READINGS.items():
        found[name] = [row for row in rows if all(row[k] == v for k, v in reading.items())]
    return found


def readings_figure(results: Results) -> Drawn:
    """Draw the phase diagram at 40 degrees under every reading of the plane-stress kinematics."""
    rows = _by_reading(results)
    figure = Figure(figsize=(11.0, 9.6), layout="constrained")
    panels = figure.subplots(3, 3).ravel()
    for axes, (name, of_reading) in zip(panels, rows.items(), strict=False):
        shown = [r for r in of_reading if r["kappa_1"] is not None]
        if len(shown) > 1:
            draw_diagram(axes, of_reading, 40.0, fits_of(of_reading).coefficients, paper=False)
        else:
            axes.text(0.5, 0.5, "no primary invagination", ha="center", transform=axes.transAxes)
        _mark_failures(axes, of_reading)
        labelled(axes, THETA, KAPPA)
        axes.grid(False)
        axes.set_title(name, loc="left")
    for axes in panels[len(rows) :]:
        axes.axis("off")
    handles = event_handles(list(EVENT_COLOURS), EVENT_COLOURS)
    handles += [
        cross_handle("path ends early"),
        cross_handle("first state without ellipticity", "+"),
    ]
    panels[len(rows)].legend(handles=handles, loc="center")
    summary = _summary(rows)
    lines = [
        {"reading": name, "regime": regime(row), **row}
        for name, of_reading in rows.items()
        for row in of_reading
    ]
    keep = [
        "reading", "ratio", "theta_bar", "regime", "t_1", "type_1", "kappa_1", "t_2", "type_2",
        "kappa_2", "t_b", "m_b", "kappa_b", "t_breakdown", "t_ellipticity", "t_contact",
        "t_reached", "status", "reason",
    ]  # fmt: skip
    text = [
        "The paper's kinematics leave open which J_s feeds the thickness stretch in the metric; "
        "each panel is one reading (docs/theory.md, Closures), with its Gauss points through ECM, "
        "IOV and OOV. Lines: the laws (3)-(5) fitted to the panel's own points.",
        _robustness(summary),
    ]
    shown_tables = {"What each reading says at 40 degrees": summary}
    return Drawn(
        "readings", "Model form: closures and thickness rules", text, figure,
        {"readings": pd.DataFrame(lines)[keep], "readings_summary": summary}, (), shown_tables,
    )  # fmt: skip


def _robustness(summary: pd.DataFrame) -> str:
    """Return in words how far the boundary moves with the reading."""
    both = summary.dropna(subset=["buckles first from R/h", "not yet at R/h"])
    never = summary[summary["not yet at R/h"].isna()]["reading"]
    sentence = (
        f"{len(both)} of {len(summary)} readings have thick cups that deepen and thin ones that "
        f"buckle; the first that buckles has R/h = {both['buckles first from R/h'].min():g} to "
        f"{both['buckles first from R/h'].max():g}, of those computed."
    )
    if len(never):
        sentence += f" Under {', '.join(never)} no cup is found to deepen before it buckles."
    return sentence


def _mark_failures(axes: Any, rows: Sequence[Row]) -> None:
    """Mark where paths end early or lose ellipticity."""
    for row in rows:
        for name, marker in (("t_reached", "x"), ("t_ellipticity", "+")):
            t_n = row.get(name)
            if t_n is not None and (name != "t_reached" or row["status"] == "ended early"):
                kappa = float(cap_curvature(t_n)) * row["ratio"]
                axes.plot([row["theta_bar"]], [kappa], marker, color=style.INK, ms=5, zorder=6)


def _summary(rows: dict[str, list[Row]]) -> pd.DataFrame:
    lines = []
    for name, of_reading in rows.items():
        fits = fits_of(of_reading)
        abnormal = [r["ratio"] for r in of_reading if regime(r) == "abnormal"]
        below = [
            r["ratio"]
            for r in of_reading
            if regime(r) in ("normal", "invaginated")
            and (not abnormal or r["ratio"] < min(abnormal))
        ]
        crossing = transition(fits, math.radians(40), GAMMA, PLATE)
        modes = sorted({str(int(r["m_b"])) for r in of_reading if regime(r) == "abnormal"})
        line: dict[str, Any] = {
            "reading": name,
            "buckles first from R/h": min(abnormal, default=None),
            "not yet at R/h": max(below, default=None),
            "theta_b, (6)": None if crossing is None else crossing[0],
            "m": ", ".join(modes),
        }
        for law, fit in (("a_1", fits.primary), ("a_2", fits.secondary), ("b_b", fits.buckling)):
            line[law] = None if fit is None else fit.slope
        line["paths that end early"] = sum(r["status"] != "ok" for r in of_reading)
        line["without ellipticity"] = sum(r.get("t_ellipticity") is not None for r in of_reading)
        lines.append(line)
    return pd.DataFrame(lines)


def mass_figure(results: Results) -> Drawn:
    """Draw the first loss of symmetry and depth without mass change, R/h = 5 .. 20."""
    rows = results.rows("no_mass")
    others = results.rows("readings_off") if "readings_off" in results.sets else []
    figure = Figure(figsize=(11.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    for row, cup, colour in zip(rows, results.sets["no_mass"], shades(len(rows)), strict=True):
        label = f"{row['ratio']:g}" if row["ratio"] % 5 == 0 else ""
        line = {"color": colour, "lw": 1.1, "label": label}
        draw_path(left, cup.record["path"], "D_over_r", row["t_b"], **line)
    labelled(left, style.SYMBOLS["t_n"], style.SYMBOLS["D_over_r"], "a")
    left.set_xlim(0, 1)
    left.set_ylim(bottom=0)
    left.legend(title="$R/h$", loc="lower right")
    for row in rows:
        if row["t_b"] is not None:
            mark(right, row["ratio"], row["t_b"], "symmetry_breaking", style.CURVES[1])
            right.annotate(
                f"{row['m_b']:g}", (row["ratio"], row["t_b"]), (0, 6), textcoords="offset points",
                ha="center", fontsize=8,
            )  # fmt: skip
    right.set_ylim(0, 1)
    labelled(right, "$R/h$", "$t_n$ of the first loss of symmetry, with its $m$", "b")
    names = ("ratio", "t_1", "type_1", "t_2", "t_b", "m_b", "t_early", "m_early", "t_breakdown")
    table = pd.DataFrame(
        [
            {"reading": reading, "regime": regime(row), **{k: row.get(k) for k in names}}
            for reading, row in [
                *((DEFAULT, row) for row in rows),
                *((f"{row['closure']} {tuple(row['thickness_points'])}", row) for row in others),
            ]
        ]
    )
    deepens = [f"{row['ratio']:g}" for row in rows if row["t_2"] is not None]
    stays = [f"{row['ratio']:g}" for row in rows if row["t_b"] is None]
    comparisons = [
        Comparison(
            "mass change off: a second deepening at any R/h = 5 .. 20",
            "no",
            "yes" if deepens else "no",
            f"at R/h = {', '.join(deepens)}" if deepens else "",
        ),
        Comparison(
            "mass change off: symmetry breaks at every R/h = 5 .. 20",
            "yes",
            "no" if stays else "yes",
            f"stable to t_n = 1 at R/h = {', '.join(stays)}" if stays else "m in the table",
        ),
    ]
    text = [
        "Mass change off (stress factor 1), 40 degrees. (a) D/r, dashed beyond the loss of "
        "symmetry. (b) The first loss, in m = 1 .. 16.",
    ]
    return Drawn(
        "mass-off", "Model form: mass change off", text, figure, {"mass_off": table}, comparisons,
        {"First loss of symmetry without mass change": table},
    )  # fmt: skip


def surface_figure(results: Results) -> Drawn:
    """Compare the surface model's events with the meridian model's, two cups a regime."""
    surface = results.rows("surface")
    meridian = {
        (r["alpha_deg"], r["ratio"]): r
        for r in (*results.rows("slenderness"), *results.rows("angles"))
    }
    lines = []
    for row in surface:
        twin = meridian[row["alpha_deg"], row["ratio"]]
        line: dict[str, Any] = {
            "alpha / deg": row["alpha_deg"],
            "R/h": row["ratio"],
            "theta_bar": row["theta_bar"],
            "surface": regime(row),
            "meridian": regime(twin),
        }
        for suffix in ("1", "2", "b"):
            both = [r[f"kappa_{suffix}"] for r in (row, twin)]
            if suffix == "2" and regime(twin) == "abnormal":
                both[1] = None  # a cup that has buckled has no second invagination to compare
            line[f"kappa_{suffix}, surface"], line[f"kappa_{suffix}, meridian"] = both
        line["m, surface"], line["m, meridian"] = row["m_b"], twin["m_b"]
        line["reason"] = row["reason"]
        lines.append(line)
    table = pd.DataFrame(lines)
    figure = Figure(figsize=(5.4, 4.6), layout="constrained")
    axes = figure.subplots()
    kinds = {"1": "primary_invagination", "2": "secondary_invagination", "b": "symmetry_breaking"}
    worst: list[float] = []
    for suffix, kind in kinds.items():
        for line in lines:
            x, y = line[f"kappa_{suffix}, meridian"], line[f"kappa_{suffix}, surface"]
            if x is not None and y is not None:
                mark(axes, x, y, kind, EVENT_COLOURS[kind])
                worst.append(abs(y / x - 1))
    top = 1.08 * axes.get_xlim()[1]
    axes.plot([0, top], [0, top], color=style.REFERENCE, lw=0.9)
    axes.legend(handles=event_handles(list(EVENT_COLOURS), EVENT_COLOURS), loc="upper left")
    labelled(axes, r"$\kappa^{cap}R$ of the event, meridian", r"$\kappa^{cap}R$, surface")
    agree = sum(line["surface"] == line["meridian"] for line in lines)
    text = [
        "The same cups on the triangulated surface, which is free to take any shape. Its losses of "
        "symmetry are where the cup leaves the axis by itself, at the resolution of its steps.",
        f"{agree} of {len(lines)} regimes agree; the events differ by at most "
        f"{100 * float(np.max(worst)):.1f} % in kappa R.",
    ]
    return Drawn(
        "surface", "The surface model on points of the diagram", text, figure,
        {"surface": table}, (), {"Surface and meridian": table},
    )  # fmt: skip
