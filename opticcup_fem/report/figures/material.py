"""Figures S1, S5 and S6: thickness of the layers, moduli, evagination, Poisson's ratio."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import Normalize, SymLogNorm
from matplotlib.figure import Figure

from opticcup_fem.diagram.regimes import AT_ONCE, breakdown, regime, second_event
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
from opticcup_fem.report.figures.cups import DEPTH, T_N, path_table
from opticcup_fem.report.figures.diagram import KAPPA
from opticcup_fem.report.figures.shapes import (
    LAYERS,
    draw_field,
    draw_shape,
    field_table,
    layer_legend,
    shape_table,
)
from opticcup_fem.report.plan import THICK, THIN
from opticcup_fem.report.results import Computed, Results
from opticcup_fem.theory import cap_curvature

_PAPER_FATES = {10.0: "evaginates", 50.0: "invaginates"}
"""What the paper says by modulus ratio."""

COLATITUDE = r"colatitude $\theta$ / degrees"


def thickness_figure(results: Results) -> Drawn:
    """Draw Fig. S1: lambda_3 of each layer on the section and along the meridian at t_n = 1."""
    (cup,) = (one for one in results.sets["shapes"] if one.row["ratio"] == 5)
    state = cup.states[-1]
    values = [
        v for part in state["regions"].values() for layer in part["stretch"].values() for v in layer
    ]
    figure = Figure(figsize=(9.5, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    norm = Normalize(min(values), max(values))
    colours = draw_field(left, state, "stretch", norm, "viridis")
    figure.colorbar(colours, ax=left, label=r"thickness stretch $\lambda_3$", shrink=0.8)
    left.set_title("(a)", loc="left")
    _along(right, state, "stretch")
    labelled(right, COLATITUDE, r"mean thickness stretch $\lambda_3$", "b")
    right.axvline(40, color=style.REFERENCE, lw=0.8)
    right.set_xlim(0, 180)
    right.set_xticks(range(0, 181, 30))
    right.legend()
    text = [
        f"R/h = 5, alpha = 40 degrees, mass change on, t_n = {state['t_n']:g}. Section to scale "
        "and the layers' means along the reference meridian; the line at 40 degrees is the "
        "interface, where the layers change. Contact is looked for on the mid-surface: layers "
        "drawn with their thickness may overlap.",
    ]
    return Drawn(
        "s1", "Fig. S1: thickness change of the layers", text, figure,
        {"s1": field_table([state], "stretch")},
    )  # fmt: skip


def _along(axes: Any, state: Mapping[str, Any], name: str) -> None:
    for region, layers in LAYERS.items():
        part = state["regions"][region]
        theta = np.degrees(np.array(part["theta"]))
        for layer in layers:
            label = style.LAYER_LABELS[layer]
            axes.plot(theta, part[name][layer], color=style.LAYER_COLOURS[layer], label=label)


def _words(cup: Computed) -> str:
    row = {"modulus_ratio": 50.0, "poisson_ratio": 0.45, **cup.row}
    return rf"$n$ = {row['modulus_ratio']:g}, $\nu$ = {row['poisson_ratio']:g}"


def moduli_figure(results: Results) -> Drawn:
    """Draw Fig. S5: depth for other moduli and Poisson ratios, and the residual stress."""
    cups, stressed = results.sets["moduli"], results.sets["stresses"]
    figure = Figure(figsize=(10.5, 6.6), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.0, 0.66))
    axes = upper.subplots()
    colours = shades(len(cups))
    for cup, colour in zip(cups, colours, strict=True):
        draw_path(axes, cup.record["path"], "D_over_r", color=colour, label=_words(cup))
        _end(axes, cup, colour)
    labelled(axes, T_N, DEPTH, "a")
    axes.set_xlim(0, 1)
    axes.set_ylim(bottom=0)
    axes.legend(loc="lower right")
    panels = lower.subplots(1, len(stressed))
    shown = [cup.states[-1] for cup in stressed]
    largest = max(
        abs(v)
        for state in shown
        for part in state["regions"].values()
        for layer in part["stress"].values()
        for v in layer
    )
    norm = SymLogNorm(0.1, vmin=-largest, vmax=largest)
    for axes, cup, state in zip(panels, stressed, shown, strict=True):
        mapped = draw_field(axes, state, "stress", norm, "PuOr_r")
        axes.set_title(f"{_words(cup)}\n$t_n$ = {state['t_n']:g}", fontsize=8)
    lower.suptitle("(b)", x=0.01, ha="left", fontsize=9)
    lower.colorbar(
        mapped, ax=list(panels), shrink=0.7, orientation="horizontal", aspect=50,
        label=r"meridional Cauchy stress $\sigma/\mu_\mathrm{IOV}$, mean of each layer",
    )  # fmt: skip
    largest_depth = {_plain(c): float(c.row["largest_D_over_r"]) for c in cups}
    text = [
        "(a) R/h = 5, alpha = 40 degrees. A dot ends a path that ends early, or where the shell "
        "touches itself. (b) Residual stress at the last of t_n = 0.1, 0.4, 0.65 and 1 that the "
        "path reaches: compression (purple) in the growing IOV, tension (orange) in the ECM. "
        "Contact is looked for on the mid-surface: layers drawn with their thickness may overlap.",
        *[f"{_plain(c)}: {c.row['reason']}." for c in cups if c.row["reason"]],
    ]
    comparisons = [
        _shallower(change, cups, key, rising, column, words)
        for change, key, rising in (
            ("larger modulus ratio", "modulus_ratio", True),
            ("smaller Poisson ratio", "poisson_ratio", False),
        )
        for column, words in (
            ("largest_D_over_r", "largest D/r"),
            ("D_over_r_at_0.4", "D/r at t_n = 0.4"),
        )
    ]
    frames = []
    for cup in stressed:
        frame = field_table(cup.states, "stress")
        frame.insert(0, "cup", _plain(cup))
        frames.append(frame)
    tables = {
        "s5a": path_table([_with(cup) for cup in cups], ["modulus_ratio", "poisson_ratio"]),
        "s5b": pd.concat(frames, ignore_index=True),
        "s5_depth": pd.DataFrame(
            {"cup": list(largest_depth), "largest_D_over_r": list(largest_depth.values())}
        ),
    }
    return Drawn(
        "s5", "Fig. S5: moduli, Poisson's ratio, residual stress", text, figure, tables, comparisons
    )


def _with(cup: Computed) -> Computed:
    return Computed({"modulus_ratio": 50.0, "poisson_ratio": 0.45, **cup.settings}, cup.record)


def _plain(cup: Computed) -> str:
    row = _with(cup).row
    return f"n = {row['modulus_ratio']:g}, nu = {row['poisson_ratio']:g}"


def _shallower(
    change: str, cups: Sequence[Computed], key: str, rising: bool, column: str, words: str
) -> Comparison:
    """Compare the paper's statement that a change makes the cup shallower.

    Args:
        change: The change in words.
        cups: Cups; those that differ from n = 50, nu = 0.45 in ``key`` alone are looked at.
        key: What changes, "modulus_ratio" or "poisson_ratio".
        rising: Whether it rises.
        column: The depth that is looked at.
        words: The depth in words.
    """
    other, usual = {
        "modulus_ratio": ("poisson_ratio", 0.45),
        "poisson_ratio": ("modulus_ratio", 50.0),
    }[key]
    rows = sorted(
        (row for cup in cups if (row := _with(cup).row)[other] == usual),
        key=lambda row: float(row[key]),
        reverse=not rising,
    )
    depths = [row.get(column) for row in rows]
    known = [float(depth) for depth in depths if depth is not None]
    answer = "yes" if all(b < a for a, b in pairwise(known)) else "no"
    symbol = {"modulus_ratio": "n", "poisson_ratio": "nu"}[key]
    shown = [
        f"{symbol} = {row[key]:g}: " + ("none" if depth is None else f"{depth:.3f}")
        for row, depth in zip(rows, depths, strict=True)
    ]
    return Comparison(
        f"{change}: shallower cup ({words})",
        "yes",
        answer if len(known) == len(depths) else None,
        ", ".join(shown),
    )


def _end(axes: Any, cup: Computed, colour: Any) -> None:
    """Mark where a path ends early, by a contact or without another equilibrium."""
    reached = float(cup.row["t_reached"])
    if reached < 0.999:
        axes.plot([reached], [float(cup.row["D_over_r"])], "o", ms=4, color=colour)


def limits_figure(results: Results) -> Drawn:
    """Draw Fig. S6: evagination, its threshold in n, and second events over Poisson's ratio."""
    cups, poisson = results.sets["evagination"], results.sets["poisson"]
    evaginated = results.sets["evaginated"][0].states
    figure = Figure(figsize=(10.5, 8.0), layout="constrained")
    upper, lower = figure.subfigures(2, 1)
    left, right = upper.subfigures(1, 2, width_ratios=(1.0, 1.35))
    for axes, state in zip(left.subplots(1, len(evaginated)), evaginated, strict=True):
        draw_shape(axes, state)
        axes.set_title(f"$t_n$ = {state['t_n']:g}")
    left.suptitle("(a)  $n$ = 10", x=0.02, ha="left", fontsize=9)
    layer_legend(left)
    axes = right.subplots()
    for cup, colour in zip(cups, shades(len(cups)), strict=True):
        label = f"$n$ = {cup.row['modulus_ratio']:g}"
        draw_path(axes, cup.record["path"], "D_over_r", color=colour, label=label)
        _end(axes, cup, colour)
    axes.legend(loc="center right")
    axes.set_xlim(0, 1)
    labelled(axes, T_N, DEPTH)
    panels = lower.subplots(1, 2)
    for axes, theta in zip(panels, (THICK, THIN), strict=True):
        _draw_poisson(axes, [c for c in poisson if abs(c.row["theta_bar"] - theta) < 0.01], theta)
    panels[0].set_title(rf"(b)  $\bar\theta$ = {THICK:g}", loc="left")
    handles = event_handles(list(EVENT_COLOURS), EVENT_COLOURS)
    handles.append(cross_handle("first state without ellipticity"))
    lower.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    comparisons = [
        Comparison(
            f"n = {cup.row['modulus_ratio']:g}",
            _PAPER_FATES.get(cup.row["modulus_ratio"]),
            "evaginates" if regime(cup.row) == "evaginated" else "invaginates",
        )
        for cup in cups
    ]
    bracket = results.transitions.get("evagination")
    if bracket is not None:
        note = f"bisection: between {bracket.low:.3f} and {bracket.high:.3f}"
        comparisons.append(
            Comparison("modulus ratio n below which the cup evaginates", 10.0, bracket.middle, note)
        )
    comparisons += _persistence(poisson)
    table = _poisson_table(poisson)
    text = [
        "(a) With n = 10 the stiff layer is too soft to invert the cap. The threshold in n is the "
        "smallest n for which the apex ever sinks below the rim. (b) Natural curvature at the "
        "events over Poisson's ratio at 40 degrees; nu = 0.5 is the closure's incompressible "
        "limit, J = 1. A cross marks where a state on the path first loses its ellipticity: beyond "
        "it the closure does not resist short waves, and numbers are those of the mesh.",
    ]
    tables = {
        "s6a": path_table(cups, ["modulus_ratio"]),
        "s6a_shapes": shape_table(evaginated),
        "s6b": table,
    }
    shown = {"Second events over Poisson's ratio": table}
    title = "Fig. S6: evagination and Poisson's ratio"
    return Drawn("s6", title, text, figure, tables, comparisons, shown)


def _draw_poisson(axes: Any, cups: Sequence[Computed], theta: float) -> None:
    for kind, suffix in (
        ("primary_invagination", "1"),
        ("secondary_invagination", "2"),
        ("symmetry_breaking", "b"),
    ):
        chosen = [c.row for c in cups if _before_breakdown(c.row, suffix)]
        x = [row["poisson_ratio"] for row in chosen]
        y = [row[f"kappa_{suffix}"] for row in chosen]
        axes.plot(x, y, color=EVENT_COLOURS[kind], lw=0.8)
        for nu, kappa in zip(x, y, strict=True):
            mark(axes, nu, kappa, kind, EVENT_COLOURS[kind])
    lost = [c.row for c in cups if c.row["t_ellipticity"] is not None]
    axes.plot(
        [row["poisson_ratio"] for row in lost],
        [float(cap_curvature(row["t_ellipticity"])) * row["ratio"] for row in lost],
        "x",
        color=style.INK,
    )
    axes.set_ylim(bottom=0)
    labelled(axes, r"Poisson ratio $\nu$", KAPPA)
    axes.set_title(rf"$\bar\theta$ = {theta:g}", loc="left")


def _before_breakdown(row: Row, suffix: str) -> bool:
    """Tell whether an event is there, and not a part of the closure's breakdown."""
    t_n, lost = row[f"t_{suffix}"], breakdown(row)
    return t_n is not None and (lost is None or t_n <= AT_ONCE * lost)


def _persistence(cups: Sequence[Computed]) -> list[Comparison]:
    lines = []
    wanted = {THICK: "secondary_invagination", THIN: "symmetry_breaking"}
    for theta, kind in wanted.items():
        of_theta = [c.row for c in cups if abs(c.row["theta_bar"] - theta) < 0.01]
        for name, chosen in (
            ("nu = 0.40 .. 0.49", [r for r in of_theta if r["poisson_ratio"] < 0.5]),
            ("nu = 0.5", [r for r in of_theta if r["poisson_ratio"] == 0.5]),
        ):
            found = [second_event(row) for row in chosen]
            missing = [
                f"{row['poisson_ratio']:g}"
                for row, one in zip(chosen, found, strict=True)
                if one is None or one[0] != kind
            ]
            lines.append(
                Comparison(
                    f"theta_bar = {theta:g}, {name}: {kind.replace('_', ' ')} persists",
                    "yes",
                    "no" if missing else "yes",
                    f"not at nu = {', '.join(missing)}" if missing else "",
                )
            )
    return lines


def _poisson_table(cups: Sequence[Computed]) -> pd.DataFrame:
    lines = []
    for cup in cups:
        row = cup.row
        names = ("t_1", "kappa_1", "t_2", "type_2", "kappa_2", "t_b", "m_b", "kappa_b")
        ends = ("t_ellipticity", "t_contact", "t_reached")
        lines.append(
            {
                "theta_bar": round(row["theta_bar"], 3),
                "nu": row["poisson_ratio"],
                "regime": regime(row),
                **{name: row.get(name) for name in (*names, *ends)},
            }
        )
    return pd.DataFrame(lines)
