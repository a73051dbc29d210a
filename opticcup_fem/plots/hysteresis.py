"""The slit beside the round cup: shape and energy, on and back in t_n, and in thicker shells."""

from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from opticcup_fem.plots import style

_LABELS = {"on": "growing", "back": "growth undone", "round": "round cup"}


@style.styled
def hysteresis(table: str | Path, out: str | Path) -> Path:
    """Draw a table of the study ``hysteresis``.

    Args:
        table: hysteresis.csv.
        out: The picture.

    Returns:
        The picture's path.
    """
    rows = pd.read_csv(table)
    thicker = rows[rows.branch.str.startswith("thicker")]
    figure = Figure(figsize=(4.2 * (2 + (len(thicker) > 0)), 3.6), layout="constrained")
    panels = figure.subplots(1, 2 + (len(thicker) > 0), squeeze=False)[0]
    for name, label, colour in zip(_LABELS, _LABELS.values(), style.CURVES, strict=False):
        branch = rows[rows.branch == name]
        panels[0].plot(branch.t_n, branch.mouth_width_over_R, ".-", color=colour, label=label)
    panels[0].set(xlabel=style.SYMBOLS["t_n"], ylabel="width of the mouth (r.m.s., $R$)")
    panels[0].legend()
    slits, beside = rows[(rows.branch == "back") & rows.slit], rows[rows.branch == "round"]
    _excess(panels[1], slits, beside, "t_n")
    panels[1].set(xlabel=style.SYMBOLS["t_n"])
    if len(thicker) > 0:
        slits = thicker[(thicker.branch == "thicker") & thicker.slit]
        _excess(panels[2], slits, thicker[thicker.branch != "thicker"], "radius_over_thickness")
        panels[2].set(xlabel=f"$R/h$ at $t_n$ = {thicker.t_n.iloc[0]:g}")
    return style.save(figure, Path(out))


def _excess(axes: Axes, slits: pd.DataFrame, beside: pd.DataFrame, over: str) -> None:
    """Draw by how many per cent a slit's energy exceeds that of the round cup."""
    both = slits.merge(beside, on=over, suffixes=("", "_round"))
    axes.plot(both[over], 100 * (both.energy / both.energy_round - 1), ".-", color=style.CURVES[1])
    axes.axhline(0.0, color=style.REFERENCE, linewidth=0.8)
    axes.set(ylabel="excess energy of the slit (%)")
