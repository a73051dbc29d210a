"""The one look of all pictures: colours that colour-blind readers can tell apart, field symbols."""

from collections.abc import Callable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from opticcup_fem.whole_files import replacing

INK = "#222222"
REFERENCE = "#8c8c8c"

LAYER_COLOURS = {"ecm": "#d55e00", "iov": "#56b4e9", "oov": "#009e73"}
"""Okabe and Ito's vermilion, sky blue, bluish green."""

SPARE_COLOURS = ("#cc79a7", "#e69f00", "#0072b2", "#f0e442")
"""For layers of other names, in turn."""

LAYER_LABELS = {"ecm": "ECM", "iov": "IOV", "oov": "OOV"}

CURVES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")

EVENT_MARKERS = {
    "primary_invagination": ("D", "primary invagination"),
    "secondary_invagination": ("^", "secondary invagination"),
    "symmetry_breaking": ("s", "symmetry breaking"),
    "closure_breakdown": ("X", "closure breakdown"),
    "self_contact": ("P", "self-contact"),
    "limit_point": ("o", "limit point"),
    "symmetry_regained": ("h", "symmetry regained"),
}
"""Marker and label of each kind of event: diamond, triangle and square as in the letter."""

SYMBOLS = {
    "t_n": r"normalised time $t_n$",
    "D_over_r": r"invagination depth $D/r$",
    "lambda_iov": r"IOV thickness ratio $\lambda_\mathrm{IOV}$",
    "apex_height_over_R": r"apex height $c/R$",
    **{f"interface_m{m}": rf"$m = {m}$ on the interface, amplitude$/R$" for m in range(2, 9)},
}

SETTINGS: dict[str, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.direction": "in",
    "ytick.direction": "in",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.8,
    "lines.linewidth": 1.6,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "figure.facecolor": "white",
    "savefig.dpi": 200,
}


def event_label(event: Mapping[str, Any]) -> str:
    """Return an event in words: "symmetry breaking (jump, m = 2), $t_n$ = 0.2830"."""
    _, label = EVENT_MARKERS[event["kind"]]
    wavenumber = f", m = {event['wavenumber']}" if "wavenumber" in event else ""
    return f"{label} ({event['type']}{wavenumber}), $t_n$ = {float(event['t_n']):.4f}"


_P = ParamSpec("_P")
_R = TypeVar("_R")


def styled(draw: Callable[_P, _R]) -> Callable[_P, _R]:
    """Return a drawing function that runs with these settings and leaves the user's alone."""

    @wraps(draw)
    def wrapper(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with mpl.rc_context(SETTINGS):
            return draw(*args, **kwargs)

    return wrapper


def layer_colour(layer: str, known: tuple[str, ...] = ()) -> str:
    """Return a layer's colour; layers of other names get spare ones by their place in `known`."""
    if layer in LAYER_COLOURS:
        return LAYER_COLOURS[layer]
    others = [name for name in known if name not in LAYER_COLOURS]
    place = others.index(layer) if layer in others else 0
    return SPARE_COLOURS[place % len(SPARE_COLOURS)]


def layer_handles(layers: Sequence[str]) -> list[Patch]:
    """Return legend handles of layers in their order."""
    known = tuple(layers)
    return [
        Patch(color=layer_colour(name, known), label=LAYER_LABELS.get(name, name)) for name in known
    ]


def save(figure: Figure, path: Path) -> Path:
    """Write a figure and return its path; the figure belongs to no window system."""
    with replacing(path) as unfinished:
        figure.savefig(unfinished, format=path.suffix[1:])
    return path


def plain_axes(axes: Axes) -> None:
    """Leave a drawing to scale without frame or ticks."""
    axes.set_aspect("equal")
    axes.axis("off")
