"""Figure 4: the phase diagram, its fitted laws and its transitions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from opticcup_fem.diagram.bisection import Bracket
from opticcup_fem.diagram.coexistence import Slice, slices
from opticcup_fem.diagram.fits import LawFits, Line, fit_laws, transition
from opticcup_fem.diagram.regimes import regime
from opticcup_fem.plots import style
from opticcup_fem.report.figures.base import (
    EVENT_COLOURS,
    REGION_COLOURS,
    Comparison,
    Drawn,
    Row,
    event_handles,
    labelled,
    mark,
)
from opticcup_fem.report.figures.cups import THETA
from opticcup_fem.report.results import Results
from opticcup_fem.theory import (
    PAPER_COEFFICIENTS,
    ScalingCoefficients,
    buckling_curvature,
    buckling_transition,
    chi,
    plate_buckling_factor,
    primary_curvature,
    secondary_curvature,
    snapping_limit,
    spring_ratio,
)

KAPPA = r"natural curvature of the cap $\kappa^{cap}R$"
GAMMA = float(spring_ratio(1 / 9, 50.0, 0.45))
PLATE = float(plate_buckling_factor(chi(1 / 9, 50.0), 0.45))


def fits_of(rows: Sequence[Row]) -> LawFits:
    """Fit the laws to cups of the paper's material."""
    return fit_laws(rows, GAMMA, PLATE)


def draw_diagram(
    axes: Axes,
    rows: Sequence[Row],
    alpha_deg: float,
    ours: ScalingCoefficients | None,
    paper: bool = True,
    boundary: float | None = None,
) -> None:
    """Draw one angle's phase diagram: regions between our points, events, laws.

    Args:
        axes: Where.
        rows: Cups of one opening angle.
        alpha_deg: The angle in degrees.
        ours: Coefficients of the laws fitted here.
        paper: Whether the laws are drawn with the paper's coefficients, too.
        boundary: theta_bar from which cups are abnormal, half-way between two cups by default.
    """
    rows = sorted((r for r in rows if r["kappa_1"] is not None), key=lambda r: r["theta_bar"])
    theta = np.array([r["theta_bar"] for r in rows], float)
    top = 1.08 * max([float(r[f"kappa_{s}"] or 0) for r in rows for s in ("1", "2", "b")])
    first = np.array([r["kappa_1"] for r in rows], float)
    second = np.array([_second_kappa(r, top) for r in rows], float)
    fates = [regime(r) for r in rows]
    edges = np.concatenate([[theta[0]], (theta[1:] + theta[:-1]) / 2, [theta[-1]]])
    for i in range(1, len(fates)):
        turns = fates[i] == "abnormal" and fates[i - 1] != "abnormal"
        if boundary is not None and turns and theta[i - 1] <= boundary <= theta[i]:
            edges[i] = boundary
    for i, fate in enumerate(fates):
        x = np.array([edges[i], theta[i], edges[i + 1]])
        # a boundary runs on between neighbours of one regime and ends between two
        y = np.array([_between(second, fates, i, -1), second[i], _between(second, fates, i, 1)])
        low = np.interp(x, theta, first)
        axes.fill_between(x, low, y, color=REGION_COLOURS["invaginated"], lw=0.4)
        if fate in ("normal", "abnormal"):
            axes.fill_between(x, y, top, color=REGION_COLOURS[fate], lw=0.4)
    for row, fate in zip(rows, fates, strict=True):
        mark(axes, row["theta_bar"], row["kappa_1"], "primary_invagination", style.INK, 4.5)
        if fate == "normal":
            kind = "secondary_invagination"
            mark(axes, row["theta_bar"], row["kappa_2"], kind, EVENT_COLOURS[kind], 5.0)
        if fate == "abnormal":
            kind = "symmetry_breaking"
            mark(axes, row["theta_bar"], row["kappa_b"], kind, EVENT_COLOURS[kind], 4.5)
    along = np.linspace(theta[0], theta[-1], 200)
    for coefficients, line in ((PAPER_COEFFICIENTS, "--"), (ours, "-")):
        if coefficients is not None and (paper or coefficients is ours):
            _draw_laws(axes, along, math.radians(alpha_deg), coefficients, line)
    axes.set_xlim(theta[0], theta[-1])
    axes.set_ylim(0, top)
    axes.grid(False)


def _between(values: Any, fates: Sequence[str], at: int, side: int) -> float:
    other = at + side
    if not 0 <= other < len(fates) or fates[other] != fates[at]:
        return float(values[at])
    return float(values[at] + values[other]) / 2


def _second_kappa(row: Row, top: float) -> float:
    fate = regime(row)
    suffix = {"normal": "2", "abnormal": "b"}.get(fate)
    return top if suffix is None else float(row[f"kappa_{suffix}"])


def _draw_laws(
    axes: Axes, theta: Any, alpha: float, coefficients: ScalingCoefficients, line: str
) -> None:
    ratio = (theta / alpha) ** 2
    laws = (
        (primary_curvature(theta, GAMMA, coefficients), style.INK),
        (secondary_curvature(ratio, coefficients), EVENT_COLOURS["secondary_invagination"]),
        (
            buckling_curvature(theta, alpha, GAMMA, PLATE, coefficients),
            EVENT_COLOURS["symmetry_breaking"],
        ),
    )
    for values, colour in laws:
        axes.plot(theta, values, line, color=colour, lw=1.0)


def _theta(bracket: Bracket, alpha_deg: float) -> tuple[float, float]:
    """Return theta_bar in the middle of a bracket in R/h, and half its width."""
    low, high = (math.radians(alpha_deg) * math.sqrt(x) for x in (bracket.low, bracket.high))
    return (low + high) / 2, (high - low) / 2


def _boundary(results: Results, alpha_deg: float) -> float | None:
    """Return theta_b of an angle by bisection, None where it was not bracketed."""
    bracket = results.transitions.get(f"theta_b {alpha_deg:g}")
    return None if bracket is None else _theta(bracket, alpha_deg)[0]


def phase_figure(results: Results) -> Drawn:
    """Draw Fig. 4: (a) at 40 degrees, (b) for 30 to 50 degrees, and theta_b over alpha."""
    rows = results.rows("slenderness") + results.rows("angles")
    angles = sorted({float(row["alpha_deg"]) for row in rows})
    by_angle = {a: [r for r in rows if r["alpha_deg"] == a] for a in angles}
    fits = {a: fits_of(by_angle[a]) for a in angles}
    together = fits_of(rows)
    figure = Figure(figsize=(11.0, 11.5), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.0, 1.35))
    left, right = upper.subplots(1, 2, width_ratios=(1.45, 1.0))
    bounds = {a: _boundary(results, a) for a in angles}
    ours = fits[40.0].coefficients
    draw_diagram(left, by_angle[40.0], 40.0, ours, boundary=bounds[40.0])
    labelled(left, THETA, KAPPA, "a")
    left.grid(False)
    left.text(0.98, 0.03, r"$\alpha = 40°$", transform=left.transAxes, ha="right")
    _mark_transitions(left, results, 40.0)
    (beside,) = results.sets["coexistence"]
    _draw_coexistence(left, slices(beside.pairs), math.radians(40.0))
    _legend(left)
    _draw_transitions(right, results, angles, fits, together)
    others = [a for a in angles if a != 40.0]
    for axes, angle in zip(lower.subplots(2, 2).ravel(), others, strict=True):
        ours = fits[angle].coefficients or together.coefficients
        draw_diagram(axes, by_angle[angle], angle, ours, boundary=bounds[angle])
        labelled(axes, THETA, KAPPA)
        axes.grid(False)
        axes.set_title(rf"(b)  $\alpha = {angle:g}°$", loc="left")
        _mark_transitions(axes, results, angle)
    tables = {
        "fig4_points": _points_table(rows),
        "fig4_fits": _fits_table({**{f"{a:g}": fits[a] for a in angles}, "all": together}),
        "fig4_transitions": _transitions_table(results, angles, fits, together),
        "fig4_bisection": _asked_table(results),
    }
    text = [
        "Phase diagram in slenderness and natural curvature of the cap, whose time runs upwards. "
        "Blue: invaginated cup; green: normal, deepened cup; red: the cup has lost its symmetry. "
        "Full lines: the laws (3), (4), (5) fitted to these points (where an angle lacks points of "
        "a regime, to all angles together); dashed: with the paper's coefficients. Dotted, "
        "vertical: theta_s and theta_b by bisection. Where the blue region reaches the top neither "
        "second event comes up to t_n = 1: the apex no longer descends a second time. Squares on "
        "the lowest line are cups so slender that the primary invagination itself throws them out "
        "of symmetry; (5) is fitted without them. Dotted area in (a): a slit whose rims hold each "
        "other, found on the surface model with contact resisted, is stable beside the round cup; "
        "on the dash-dotted line both have the same energy. Its ends are half-way between two cups "
        "that were computed (section on cups side by side).",
    ]
    shown = {
        "Fitted coefficients, 95 % confidence intervals": tables["fig4_fits"],
        "Transitions": tables["fig4_transitions"],
    }
    return Drawn(
        "fig4", "Fig. 4: the phase diagram", text, figure, tables,
        _comparisons(results, fits[40.0]), shown,
    )  # fmt: skip


def _mark_transitions(axes: Axes, results: Results, angle: float) -> None:
    for name, label in (("theta_s", r"$\bar\theta_s$"), ("theta_b", r"$\bar\theta_b$")):
        bracket = results.transitions.get(f"{name} {angle:g}")
        if bracket is None:
            continue
        x = _theta(bracket, angle)[0]
        axes.axvline(x, color=style.INK, lw=0.9, ls=":")
        axes.annotate(
            label, (x, 1.0), (2, -3), xycoords=("data", "axes fraction"),
            textcoords="offset points", va="top",
        )  # fmt: skip


def _draw_coexistence(axes: Axes, known: Sequence[Slice], alpha: float) -> None:
    """Hatch where slit and round cup are both stable; draw where their energies are equal."""

    def at(one: Slice, ratio: float) -> tuple[float, float]:
        return alpha * math.sqrt(ratio), one.kappa_per_ratio * ratio

    left = [at(one, one.first) for one in known if one.first and one.last]
    right = [at(one, one.last) for one in known if one.first and one.last]
    limits = axes.get_xlim(), axes.get_ylim()
    if len(left) > 1:
        x, y = np.array(left + right[::-1]).T
        axes.fill(x, y, facecolor="none", edgecolor=style.INK, lw=0.5, hatch="....", alpha=0.55)
    equal = np.array([at(one, one.equal) for one in known if one.equal]).reshape(-1, 2)
    axes.plot(*equal.T, "-.", color=style.INK, lw=1.4, marker=".", ms=4)
    axes.set_xlim(*limits[0])
    axes.set_ylim(*limits[1])


def _legend(axes: Axes) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = event_handles(list(EVENT_COLOURS), EVENT_COLOURS)
    for name, colour in REGION_COLOURS.items():
        handles.append(Patch(facecolor=colour, edgecolor=style.REFERENCE, lw=0.6, label=name))
    for line, label in (("-", "laws, fitted here"), ("--", "laws, paper's coefficients")):
        handles.append(Line2D([], [], color=style.INK, ls=line, lw=1.0, label=label))
    both = "slit and round cup both stable"
    handles.append(Patch(fc="white", ec=style.INK, lw=0.5, hatch="....", label=both))
    equal = "their energies are equal"
    handles.append(Line2D([], [], color=style.INK, ls="-.", lw=1.4, marker=".", ms=4, label=equal))
    axes.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(0.02, 0.94), frameon=True,
        facecolor="white", edgecolor="white", framealpha=0.85,
    )  # fmt: skip


def _draw_transitions(
    axes: Axes,
    results: Results,
    angles: Sequence[float],
    fits: Mapping[float, LawFits],
    together: LawFits,
) -> None:
    grid = np.linspace(28, 52, 60)
    for name, colour in (("theta_b", style.CURVES[1]), ("theta_s", style.CURVES[0])):
        found = [(a, results.transitions.get(f"{name} {a:g}")) for a in angles]
        points = [(a, *_theta(b, a)) for a, b in found if b is not None]
        if points:
            x, y, error = zip(*points, strict=True)
            label = rf"$\bar\theta_{name[-1]}$, bisection"
            axes.errorbar(x, y, error, fmt="o", color=colour, mfc="white", capsize=3, label=label)
    if together.coefficients is not None:
        values = buckling_transition(np.radians(grid), GAMMA, PLATE, together.coefficients)
        axes.plot(grid, values, color=style.CURVES[1], lw=1.0, label="(6), fitted to all angles")
    paper = buckling_transition(np.radians(grid), GAMMA, PLATE)
    axes.plot(grid, paper, "--", color=style.CURVES[1], lw=1.0, label="(6), paper's coefficients")
    limit = float(snapping_limit(0.45))
    axes.axhline(limit, color=style.CURVES[0], ls="--", lw=1.0, label="(S26)")
    axes.legend(loc="center right", bbox_to_anchor=(1.0, 0.42))
    labelled(axes, r"opening angle $\alpha$ / degrees", r"transitions in $\bar\theta$")
    axes.set_title("transitions", loc="left")


def _points_table(rows: Sequence[Row]) -> pd.DataFrame:
    names = (
        "alpha_deg", "ratio", "theta_bar", "t_1", "type_1", "kappa_1", "t_2", "type_2", "kappa_2",
        "t_b", "m_b", "kappa_b", "t_early", "m_early", "t_contact", "t_ellipticity", "status",
        "reason",
    )  # fmt: skip
    table = pd.DataFrame([{name: row.get(name) for name in names} for row in rows])
    table.insert(3, "regime", [regime(row) for row in rows])
    return table.sort_values(["alpha_deg", "ratio"], ignore_index=True)


def _fits_table(fits: Mapping[str, LawFits]) -> pd.DataFrame:
    laws = (
        ("(3) a_1, b_1", "primary", ("a_1", "b_1")),
        ("(3), folds only", "snapping", ("a_1", "b_1")),
        ("(4) a_2, b_2", "secondary", ("a_2", "b_2")),
        ("(5) b_b, c_b", "buckling", ("b_b", "c_b")),
    )
    lines = []
    for name, fit in fits.items():
        for law, attribute, (slope, offset) in laws:
            line: Line | None = getattr(fit, attribute)
            if line is None:
                continue
            widths = line.half_widths
            lines.append(
                {
                    "alpha / deg": name,
                    "law": law,
                    "slope": line.slope,
                    "slope +-": widths[0],
                    "slope, paper": getattr(PAPER_COEFFICIENTS, slope),
                    "offset": line.offset,
                    "offset +-": widths[1],
                    "offset, paper": getattr(PAPER_COEFFICIENTS, offset),
                    "points": line.count,
                    "rms": line.rms,
                }
            )
    return pd.DataFrame(lines)


def _transitions_table(
    results: Results, angles: Sequence[float], fits: Mapping[float, LawFits], together: LawFits
) -> pd.DataFrame:
    lines = []
    for angle in angles:
        alpha = math.radians(angle)
        line: dict[str, Any] = {"alpha / deg": angle}
        for name in ("theta_s", "theta_b"):
            bracket = results.transitions.get(f"{name} {angle:g}")
            value = (None, None) if bracket is None else _theta(bracket, angle)
            line[f"{name}, bisection"], line[f"{name} +-"] = value
        own = transition(fits[angle], alpha, GAMMA, PLATE)
        line["(6), fitted here"], line["(6) +-"] = own or (None, None)
        every = transition(together, alpha, GAMMA, PLATE)
        line["(6), all angles"] = None if every is None else every[0]
        line["(6), paper"] = float(buckling_transition(alpha, GAMMA, PLATE))
        line["(S26)"] = float(snapping_limit(0.45))
        lines.append(line)
    return pd.DataFrame(lines)


def _asked_table(results: Results) -> pd.DataFrame:
    names = ("ratio", "theta_bar", "type_1", "t_1", "t_2", "t_b", "m_b", "status")
    lines = [
        {"transition": name, **{key: row.get(key) for key in names}, "regime": regime(row)}
        for name, rows in results.asked.items()
        for row in rows
        if name != "evagination"
    ]
    columns = ["transition", *names, "regime"]
    return pd.DataFrame(lines, columns=columns).sort_values(
        ["transition", "ratio"], ignore_index=True
    )


def _comparisons(results: Results, fits: LawFits) -> list[Comparison]:
    lines: list[Comparison] = []
    laws = (
        (fits.primary, ("a_1", "b_1"), "(3)"),
        (fits.secondary, ("a_2", "b_2"), "(4)"),
        (fits.buckling, ("b_b", "c_b"), "(5)"),
    )
    for line, names, law in laws:
        if line is None:
            continue
        values = zip(names, (line.slope, line.offset), line.half_widths, strict=True)
        for name, value, width in values:
            lines.append(
                Comparison(
                    f"{name} of {law} at 40 deg",
                    float(getattr(PAPER_COEFFICIENTS, name)),
                    value,
                    f"+-{width:.3f} (95 %), {line.count} cups",
                )
            )
    own = transition(fits, math.radians(40), GAMMA, PLATE)
    if own is not None:
        note = f"+-{own[1]:.3f} (95 %) from the scatter of both fits"
        lines.append(Comparison("theta_b of (6) at 40 deg", 2.46, own[0], note))
    bracket = results.transitions.get("theta_s 40")
    if bracket is not None:
        theta, width = _theta(bracket, 40.0)
        note = f"bisection +-{width:.3f}; the letter's is that of open caps, (S26)"
        lines.append(Comparison("theta_s: primary invagination snaps beyond", 1.88, theta, note))
    return lines
