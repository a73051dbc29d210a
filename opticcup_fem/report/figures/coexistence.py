"""The model-form section's figure of round and buckled cups that exist side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from opticcup_fem.diagram.coexistence import equal_energy, thickest_slit
from opticcup_fem.plots import style
from opticcup_fem.report.figures.base import Comparison, Drawn, Row, labelled, shades
from opticcup_fem.report.results import Results

ALPHA = math.radians(40)
PAPER = 2.51
"""theta_b of the letter's simulations at 40 degrees."""


def coexistence_figure(results: Results) -> Drawn:
    """Draw the energy of the slit over the round cup's, and the slit's width, over R/h."""
    (one,) = results.sets["coexistence"]
    rows: list[Row] = list(one.pairs)
    times = sorted({float(row["t_n"]) for row in rows})
    by_time = {t_n: [row for row in rows if row["t_n"] == t_n] for t_n in times}
    figure = Figure(figsize=(10.0, 4.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    for (t_n, of_time), colour in zip(by_time.items(), shades(len(by_time)), strict=True):
        label = f"$t_n$ = {t_n:g}"
        _draw(left, of_time, "excess", colour, label, 1e4)
        _draw(right, of_time, "m2_slit", colour, label)
    left.axhline(0, color=style.REFERENCE, lw=0.9)
    labelled(left, "$R/h$", r"energy, slit over round: $10^4\,(E_s/E_r - 1)$", "a")
    labelled(right, "$R/h$", "amplitude of the slit, $m = 2$ of the interface, $R$", "b")
    right.set_ylim(bottom=0)
    slenderest = max(float(row["ratio"]) for row in rows)
    for axes in (left, right):
        axes.set_xlim(min(float(row["ratio"]) for row in rows) - 0.1, slenderest + 0.1)
        for ratio, line, _ in _boundaries(results):
            axes.axvline(ratio, color=style.INK, lw=0.9, ls=line)
    handles, labels = right.get_legend_handles_labels()
    handles += _keys(results)
    labels += [handle.get_label() for handle in handles[len(labels) :]]
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    summary = pd.DataFrame([_summary(t_n, of_time) for t_n, of_time in by_time.items()])
    return Drawn(
        "coexistence", "Model form: round and buckled cups side by side",
        _text(one.settings, summary), figure,
        {"coexistence": pd.DataFrame(rows), "coexistence_summary": summary},
        _comparisons(summary, results), {"Slits beside round cups at 40 degrees": summary},
    )  # fmt: skip


def _draw(
    axes: Axes, rows: Sequence[Row], name: str, colour: Any, label: str, unit: float = 1.0
) -> None:
    """Draw a column over R/h; filled marks are slits whose parts hold each other."""
    known = [row for row in sorted(rows, key=lambda r: r["ratio"]) if row[name] is not None]
    x, y = [float(row["ratio"]) for row in known], [unit * float(row[name]) for row in known]
    axes.plot(x, y, color=colour, lw=1.2, label=label)
    for row, at, value in zip(known, x, y, strict=True):
        filled = colour if row["slit_touches"] else "white"
        axes.plot([at], [value], "o", color=colour, mfc=filled, ms=5)


def _boundaries(results: Results) -> list[tuple[float, str, str]]:
    """Return R/h, line and label of the linear boundary and the letter's."""
    found = [((PAPER / ALPHA) ** 2, "--", rf"$\bar\theta_b$ = {PAPER:g}, the letter's simulations")]
    bracket = results.transitions.get("theta_b 40")
    if bracket is not None:
        theta = _theta(bracket.middle)
        label = rf"$\bar\theta_b$ = {theta:.3f}, small disturbances (bisection)"
        found.append((bracket.middle, ":", label))
    return found


def _keys(results: Results) -> list[Any]:
    from matplotlib.lines import Line2D

    keys = [
        Line2D([], [], color=style.INK, lw=0.9, ls=line, label=label)
        for _, line, label in _boundaries(results)
    ]
    marks = ((style.INK, "touches itself"), ("white", "free of contact"))
    return keys + [
        Line2D([], [], ls="none", marker="o", ms=5, color=style.INK, mfc=fill, label=label)
        for fill, label in marks
    ]


def _theta(ratio: float | None) -> float | None:
    return None if ratio is None else ALPHA * math.sqrt(ratio)


def _summary(t_n: float, rows: Sequence[Row]) -> dict[str, Any]:
    equal, first = equal_energy(rows), thickest_slit(rows)
    rounds = [float(row["ratio"]) for row in rows if row["energy_round"] is not None]
    return {
        "t_n": t_n,
        "slit found down to R/h": first,
        "theta_bar": _theta(first),
        "equal energy at R/h": equal,
        "theta_bar, equal energy": _theta(equal),
        "round cup stable up to R/h": max(rounds, default=None),
        "largest energy gain of a slit": min(
            (float(row["excess"]) for row in rows if row["excess"] is not None), default=None
        ),
    }


def _text(settings: dict[str, Any], summary: pd.DataFrame) -> list[str]:
    sentences = [
        "The loss of symmetry is subcritical: below the R/h at which small disturbances grow, a "
        "buckled cup (a slit) is a stable equilibrium beside the round one, and a finite "
        "disturbance decides. Slits found at R/h = "
        f"{settings['ratios'][0]:g} are followed to thicker shells on the surface model, both cups "
        f"on one mesh of {settings['mesh']}. (a) Energy of the slit relative to the round cup's: "
        "below zero the round cup is stable against small disturbances only. (b) Width of the "
        "slit; a curve ends where the slit opens into the round cup. Contact is resisted: slits "
        "with filled marks touch themselves.",
    ]
    equal = summary["equal energy at R/h"].dropna()
    first = summary["slit found down to R/h"].dropna()
    if len(equal) and len(first):
        sentences.append(
            f"The two energies are equal at R/h = {equal.min():.2f} (theta_bar = "
            f"{_theta(float(equal.min())):.2f}), and the slit is found down to R/h = "
            f"{first.min():g} (theta_bar = {_theta(float(first.min())):.2f}), of those computed."
        )
    return sentences


def _comparisons(summary: pd.DataFrame, results: Results) -> list[Comparison]:
    equal = summary.dropna(subset=["equal energy at R/h"])
    if equal.empty:
        return []
    row = equal.loc[equal["equal energy at R/h"].idxmin()]
    return [
        Comparison(
            "theta_b at 40 deg if the cup of less energy is taken",
            PAPER,
            float(row["theta_bar, equal energy"]),
            f"equal energies at R/h = {row['equal energy at R/h']:.2f}, t_n = {row['t_n']:g}",
        )
    ]
