"""Figures 1, 2, 3, S2 and S3: the chick cup, slenderness at 40 degrees, and what drives it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from opticcup_fem.diagram.fits import fitted_line
from opticcup_fem.diagram.regimes import regime, second_event
from opticcup_fem.plots import style
from opticcup_fem.report.figures.base import (
    EVENT_COLOURS,
    Array,
    Comparison,
    Drawn,
    Row,
    draw_path,
    event_handles,
    followed_parts,
    labelled,
    mark,
    shades,
)
from opticcup_fem.report.figures.shapes import draw_shape, layer_legend, shape_table
from opticcup_fem.report.results import Computed, Results
from opticcup_fem.studies.sweep.rows import value_at
from opticcup_fem.theory import chi, spring_ratio

if TYPE_CHECKING:
    from matplotlib.axes import Axes

T_N, DEPTH, STRETCH = (style.SYMBOLS[name] for name in ("t_n", "D_over_r", "lambda_iov"))
THETA = r"slenderness $\bar\theta = \alpha\sqrt{R/h}$"


def path_table(cups: Sequence[Computed], names: Sequence[str]) -> pd.DataFrame:
    """Return the followed states of cups, one row a state, with the cups' settings."""
    parts = []
    for cup in cups:
        for part in followed_parts(cup.record["path"]):
            columns = ("t_n", "D_over_r", "lambda_iov", "apex_height_over_R")
            frame = pd.DataFrame({name: part[name] for name in columns})
            for name in reversed(names):
                frame.insert(0, name, cup.row[name])
            parts.append(frame)
    return pd.concat(parts, ignore_index=True)


def chick_figure(results: Results, experiment: pd.DataFrame | None, name: str) -> Drawn:
    """Draw Fig. 1(b, c), or S2 with the same curves in the supplement's order."""
    on, off = results.sets["chick"]
    figure = Figure(figsize=(9.0, 3.9), layout="constrained")
    panels = figure.subplots(1, 2)
    letters = ("b", "c") if name == "fig1" else ("a", "b")
    for axes, column, label, letter in zip(
        panels, ("lambda_iov", "D_over_r"), (STRETCH, DEPTH), letters, strict=True
    ):
        for cup, colour, words in (
            (on, style.CURVES[0], "with mass change"),
            (off, style.CURVES[1], "without mass change"),
        ):
            draw_path(axes, cup.record["path"], column, color=colour, label=words)
            _mark_invaginations(axes, cup, column, colour)
        if experiment is not None and column in experiment:
            axes.plot(
                experiment["t_n"], experiment[column], "o", color=style.INK, ms=4, label="measured"
            )
        labelled(axes, T_N, label, letter)
        axes.set_xlim(0, 1)
        axes.set_ylim(bottom=1.0 if column == "lambda_iov" else 0.0)
    handles, labels = panels[0].get_legend_handles_labels()
    kinds = ("primary_invagination", "secondary_invagination")
    handles += event_handles(kinds, dict.fromkeys(kinds, style.INK))
    labels += [style.EVENT_MARKERS[kind][1] for kind in kinds]
    figure.legend(handles, labels, loc="outside lower center", ncols=5)
    second = "yes" if on.row["t_2"] is not None else "no"
    second_off = "yes" if off.row["t_2"] is not None else "no"
    comparisons = [
        Comparison("R/h = 5, with mass change: second invagination", "yes", second),
        Comparison(
            "R/h = 5, without mass change: second invagination",
            None,
            second_off,
            "the letter states symmetry breaking in its place, see mass change off below",
        ),
    ]
    text = [
        "Thickness ratio of the IOV at the apex and depth over radius of the chick cup, R/h = 5, "
        "alpha = 40 degrees. Dotted: a jump at a limit point. "
        f"With mass change t_1 = {on.row['t_1']:.4f} ({on.row['type_1']}) and t_2 = "
        f"{on.row['t_2']:.4f} ({on.row['type_2']}).",
    ]
    if experiment is None:
        text.append(
            "The experiment's points are printed in the paper as marks only; "
            "`--experiment FILE.csv` (columns t_n, D_over_r, lambda_iov) overlays measured ones."
        )
    titles = {
        "fig1": "Fig. 1(b, c): the chick optic cup",
        "s2": "Fig. S2: with and without mass change",
    }
    if name == "s2":
        text.append(
            "The supplement also draws an earlier model with assumed gradients of stiffness and "
            "growth, of which this code has no counterpart."
        )
    tables = {name: path_table([on, off], ["mass_change"])}
    return Drawn(name, titles[name], text, figure, tables, comparisons if name == "fig1" else ())


def _mark_invaginations(axes: Axes, cup: Computed, column: str, colour: str) -> None:
    for kind, suffix in (("primary_invagination", "1"), ("secondary_invagination", "2")):
        t_n = cup.row[f"t_{suffix}"]
        if t_n is not None:
            value = value_at(cup.record["path"], t_n, column)
            if value is not None:
                mark(axes, t_n, value, kind, colour)


def slenderness_figure(results: Results) -> Drawn:
    """Draw Fig. 2: D/r against t_n for R/h = 5 .. 20, and shapes of a thick and a thin cup."""
    cups = results.sets["slenderness"]
    figure = Figure(figsize=(9.0, 8.2), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.25, 1.0))
    axes = upper.subplots()
    colours = shades(len(cups))
    for cup, colour in zip(cups, colours, strict=True):
        second = second_event(cup.row)
        until = second[1] if second and second[0] == "symmetry_breaking" else None
        draw_path(
            axes, cup.record["path"], "D_over_r", until, color=colour, lw=1.3,
            label=f"{cup.row['ratio']:g}",
        )  # fmt: skip
        events = [("primary_invagination", cup.row["t_1"])]
        events += [(second[0], second[1])] if second else []
        for kind, t_n in events:
            value = value_at(cup.record["path"], t_n, "D_over_r")
            if value is not None:
                mark(axes, t_n, value, kind, EVENT_COLOURS[kind])
    labelled(axes, T_N, DEPTH, "a")
    axes.set_xlim(0, 1)
    axes.set_ylim(bottom=0)
    first = upper.legend(
        *axes.get_legend_handles_labels(), title="$R/h$", loc="outside right upper", ncols=2
    )
    upper.add_artist(first)
    handles = event_handles(list(EVENT_COLOURS), EVENT_COLOURS)
    axes.legend(handles=handles, loc="lower right")
    _draw_shapes(lower, results)
    bracket = results.transitions.get("theta_b 40")
    comparisons = []
    if bracket is not None:
        theta = math.radians(40) * math.sqrt(bracket.middle)
        comparisons.append(
            Comparison(
                "theta_b at 40 deg: buckling comes first (numerical)",
                2.51,
                theta,
                f"bisection: between R/h = {bracket.low:.3f} and {bracket.high:.3f}",
            )
        )
    text = [
        "(a) D/r at 40 degrees for R/h = 5 to 20; full lines up to the loss of symmetry, dashed "
        "the axisymmetric path beyond it, on which only a perfect cup could balance. "
        "(b) Meridian sections with their layers: R/h = 5 (top) to the deep cup, R/h = 15 (bottom) "
        "up to its loss of symmetry; the shape after it is not axisymmetric.",
    ]
    return Drawn(
        "fig2", "Fig. 2: slenderness at 40 degrees", text, figure,
        {"fig2a": path_table(cups, ["ratio"]), "fig2b": _shapes_table(results)}, comparisons,
    )  # fmt: skip


def _draw_shapes(figure: Any, results: Results) -> None:
    rows = results.sets["shapes"]
    columns = max(len(one.states) for one in rows)
    panels = figure.subplots(len(rows), columns, squeeze=False)
    for line, one in zip(panels, rows, strict=True):
        states = one.states
        for axes in line[len(states) :]:
            axes.axis("off")
        reach = max(_reach(state) for state in states)
        for axes, state in zip(line, states, strict=False):
            draw_shape(axes, state)
            axes.set_xlim(-reach, reach)
            axes.set_title(f"$t_n$ = {state['t_n']:g}")
        line[0].text(
            -0.05, 0.5, f"$R/h$ = {one.row['ratio']:g}", transform=line[0].transAxes,
            rotation=90, ha="right", va="center",
        )  # fmt: skip
    layer_legend(figure)
    panels[0][0].set_title(f"(b)   $t_n$ = {rows[0].record['states'][0]['t_n']:g}")


def _reach(state: Mapping[str, Any]) -> float:
    faces = [np.array(region["faces"]) for region in state["regions"].values()]
    return 1.05 * max(float(f[..., 0].max()) for f in faces)


def _shapes_table(results: Results) -> pd.DataFrame:
    frames = []
    for one in results.sets["shapes"]:
        frame = shape_table(one.states)
        frame.insert(0, "ratio", one.row["ratio"])
        frames.append(frame)
    return pd.concat(frames, ignore_index=True)


def drive_figure(results: Results) -> Drawn:
    """Draw the quantities of Fig. 3: equivalent curvature, rotation of the interface, spans."""
    rows = results.rows("slenderness")
    gamma = float(spring_ratio(1 / 9, 50.0, 0.45))
    first = [row for row in rows if row["kappa_1"] is not None]
    theta, ratio, kappa, turn = (
        np.array([row[name] for row in first], float)
        for name in ("theta_bar", "ratio", "kappa_1", "delta_theta_1")
    )
    equivalent = kappa - gamma * turn * np.sqrt(ratio)
    figure = Figure(figsize=(12.0, 4.0), layout="constrained")
    panels = figure.subplots(1, 3)
    axes = panels[0]
    axes.plot(theta, kappa, "D", mfc="white", color=style.INK, label=r"$\kappa^{cap}R$")
    axes.plot(theta, equivalent, "o", color=style.CURVES[0], label=r"$\kappa^{eq}R$, (2)")
    line = fitted_line(theta, equivalent)
    comparisons = []
    if line is not None:
        axes.plot(theta, line(theta), color=style.CURVES[0], lw=1.0)
        words = rf"${line.slope:.2f}\,\bar\theta {line.offset:+.2f}$"
        axes.text(0.97, 0.08, words, transform=axes.transAxes, ha="right", color=style.CURVES[0])
    axes.legend(loc="upper left")
    labelled(axes, THETA, r"critical curvature at primary invagination", "a")
    axes = panels[1]
    alpha = math.radians(40)
    for suffix, kind in (("1", "primary_invagination"), ("b", "symmetry_breaking")):
        chosen = [r for r in rows if r[f"delta_theta_{suffix}"] is not None]
        if suffix == "b":
            chosen = [r for r in chosen if regime(r) == "abnormal"]
        axes.plot(
            [math.sqrt(r["ratio"]) for r in chosen],
            [r[f"delta_theta_{suffix}"] / alpha for r in chosen],
            linestyle="none", marker=style.EVENT_MARKERS[kind][0], mfc="white",
            color=EVENT_COLOURS[kind], label=style.EVENT_MARKERS[kind][1],
        )  # fmt: skip
    axes.axhline(1.0, color=style.REFERENCE, lw=0.9)
    axes.set_ylim(bottom=0)
    axes.legend(loc="center left")
    labelled(axes, r"$\sqrt{R/h}$", r"rotation of the interface $\Delta\theta/\alpha$", "b")
    comparisons.append(
        Comparison(
            "rotation at primary invagination over alpha, R/h = 5..20",
            1.0,
            float(np.mean(turn / alpha)),
            f"horizontal tangent in the letter; ours {np.min(turn / alpha):.2f} to "
            f"{np.max(turn / alpha):.2f}",
        )
    )
    spans = _spans([r for r in rows if regime(r) == "normal"])
    axes = panels[2]
    axes.plot(spans["ratio"], spans["span_cap"], "o-", color=style.CURVES[0], label="cap")
    axes.plot(
        spans["ratio"], spans["span_oov"], "s-", color=style.CURVES[2], label="OOV boundary layer"
    )
    axes.set_ylim(0, 1.08 * spans["span_oov"].max())
    axes.legend(loc="lower right")
    labelled(axes, "$R/h$", "characteristic span at secondary invagination, $R$", "c")
    table = pd.DataFrame(
        {
            "ratio": ratio,
            "theta_bar": theta,
            "kappa_cap_R": kappa,
            "kappa_eq_R": equivalent,
            "delta_theta_over_alpha": turn / alpha,
        }
    )
    text = [
        "(a) Natural curvature of the cap at the primary invagination and what is left of it after "
        "the OOV's boundary layer is bent, kappa_eq = kappa_cap - Gamma Delta theta/sqrt(R h). "
        "(b) Rotation of the interface's tangent, in units of alpha: 1 is the horizontal tangent "
        "that (3) assumes. (c) Spans R alpha (1 + chi (1 + nu) kappa h) of a cap set free and "
        "e_OOV R sin(alpha + sqrt(h/R)) of the boundary layer, where the secondary invagination "
        "comes; (4) assumes that they keep a fixed ratio.",
        f"The ratio of the spans is {spans['ratio_of_spans'].min():.3f} to "
        f"{spans['ratio_of_spans'].max():.3f}.",
    ]
    tables = {"fig3ab": table, "fig3c": spans}
    return Drawn("fig3", "Fig. 3: what drives the cup", text, figure, tables, comparisons)


def _spans(rows: Sequence[Row]) -> pd.DataFrame:
    alpha, nu = math.radians(40), 0.45
    value = float(chi(1 / 9, 50.0))
    ratio, kappa, t_n = (
        np.array([row[name] for row in rows], float) for name in ("ratio", "kappa_2", "t_2")
    )
    cap: Array = alpha * (1 + value * (1 + nu) * kappa / ratio)
    oov: Array = (1 + 1.5 * t_n) * np.sin(alpha + np.sqrt(1 / ratio))
    columns = {"ratio": ratio, "span_cap": cap, "span_oov": oov, "ratio_of_spans": cap / oov}
    return pd.DataFrame(columns)


def apex_figure(results: Results) -> Drawn:
    """Draw Fig. S3: apex height and its rate at theta_bar = 2.21."""
    (cup,) = (one for one in results.sets["slenderness"] if one.row["ratio"] == 10)
    figure = Figure(figsize=(9.0, 3.7), layout="constrained")
    left, right = figure.subplots(1, 2)
    draw_path(left, cup.record["path"], "apex_height_over_R", color=style.CURVES[0])
    labelled(left, T_N, style.SYMBOLS["apex_height_over_R"], "a")
    rates = []
    for part in followed_parts(cup.record["path"]):
        t, c = part["t_n"], part["apex_height_over_R"]
        keep = np.concatenate([[True], np.diff(t) > 1e-9])
        t, c = t[keep], c[keep]
        if len(t) > 2:
            rate = np.gradient(c, t)
            right.plot(t, rate, color=style.CURVES[0])
            rates.append(pd.DataFrame({"t_n": t, "apex_height_over_R": c, "dc_dt_n": rate}))
    for suffix, kind in (("1", "primary_invagination"), ("2", "secondary_invagination")):
        t_n = cup.row[f"t_{suffix}"]
        value = value_at(cup.record["path"], t_n, "apex_height_over_R")
        assert value is not None
        mark(left, t_n, value, kind, EVENT_COLOURS[kind])
        right.axvline(t_n, color=EVENT_COLOURS[kind], lw=0.9, ls=":")
    right.set_ylim(-12, 3)
    right.axhline(0, color=style.REFERENCE, lw=0.8)
    labelled(right, T_N, r"apex rate $\mathrm{d}(c/R)/\mathrm{d}t_n$", "b")
    kinds = ("primary_invagination", "secondary_invagination")
    left.legend(handles=event_handles(kinds, EVENT_COLOURS), loc="upper right")
    for axes in (left, right):
        axes.set_xlim(0, 1)
    text = [
        f"R/h = 10, theta_bar = {cup.row['theta_bar']:.2f}. The first fall is a jump at a limit "
        "point (the rate is unbounded before it); the second is the smooth dip of the rate at "
        f"t_n = {cup.row['t_2']:.4f}: the apex speeds up, without a limit point.",
    ]
    comparisons = [
        Comparison(
            "theta_bar = 2.21: secondary invagination",
            "snapping",
            "snapping" if cup.row["type_2"] == "fold" else "smooth",
            "by limit points; the supplement calls a changing rate snapping",
        )
    ]
    return Drawn(
        "s3", "Fig. S3: the apex and its rate", text, figure,
        {"s3": pd.concat(rates, ignore_index=True)}, comparisons,
    )  # fmt: skip
