"""The tornado plot of a forecast: what a tenth more or less of each parameter does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure
from matplotlib.patches import Patch

from opticcup_fem.plots import style

if TYPE_CHECKING:
    from opticcup_fem.diagram.tornado import Effect
    from opticcup_fem.studies.predict import Forecast

FATE_COLOURS = {
    "normal": style.CURVES[2],
    "abnormal": style.CURVES[1],
    "invaginated": style.CURVES[0],
    "evaginated": style.CURVES[3],
    "undecided": style.REFERENCE,
}
_LABELS = {"alpha": r"$\alpha$", "nu": r"$\nu$", "R": "$R$", "h": "$h$", "m": "$m$", "n": "$n$"}


@style.styled
def tornado(forecast: Forecast, out: Path) -> Path:
    """Draw a forecast's effects, bars coloured by what becomes of the cup; PNG and SVG.

    Args:
        forecast: The forecast.
        out: The PNG file; the SVG has its name.
    """
    panels = [
        (forecast.times, "$t_n$ of the second event"),
        (forecast.depths, "largest depth $D/r$ of the round cup"),
    ]
    panels = [(effects, label) for effects, label in panels if effects]
    figure = Figure(figsize=(4.7 * max(len(panels), 1), 4.2), layout="constrained")
    all_axes = figure.subplots(1, max(len(panels), 1), squeeze=False)[0]
    for axes, (effects, label) in zip(all_axes, panels, strict=False):
        _bars(axes, effects, forecast)
        axes.set_xlabel(label)
    used = {forecast.fate, *(fate for pair in forecast.fates.values() for fate in pair)}
    handles = [
        Patch(color=colour, label=name) for name, colour in FATE_COLOURS.items() if name in used
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    shape = forecast.case.shape
    figure.suptitle(
        f"$R/h$ = {shape.radius_over_thickness:.3g}, "
        rf"$\alpha$ = {shape.opening_angle_deg:g}°: {forecast.fate}; "
        r"each parameter $-10\,\%$ (hatched) and $+10\,\%$",
        fontsize=9,
    )
    figure.savefig(out.with_suffix(".svg"), metadata={"Date": None})
    return style.save(figure, out)


def _bars(axes: Any, effects: list[Effect], forecast: Forecast) -> None:
    for place, one in enumerate(reversed(effects)):
        fates = forecast.fates[one.name]
        for value, fate, hatch in zip((one.low, one.high), fates, ("////", ""), strict=True):
            if value is not None:
                axes.barh(
                    place, value - one.base, left=one.base, height=0.62, hatch=hatch,
                    color=FATE_COLOURS[fate], edgecolor="white", linewidth=0.6,
                )  # fmt: skip
    axes.axvline(effects[0].base, color=style.INK, lw=0.9)
    names = [_LABELS.get(one.name, one.name) for one in reversed(effects)]
    axes.set_yticks(range(len(names)), names)
    axes.margins(x=0.08)
