"""Meridian sections of layers, from the states of the task ``layers``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import FigureBase
from matplotlib.patches import Polygon

from opticcup_fem.plots import style

LAYERS = {"cap": ("iov", "ecm"), "oov": ("oov",)}
"""Layers of the regions, inside first."""

State = Mapping[str, Any]


def draw_shape(axes: Axes, state: State) -> None:
    """Fill the layers of a state's section, true to scale."""
    for region, layers in LAYERS.items():
        faces = np.array(state["regions"][region]["faces"])
        for k, layer in enumerate(layers):
            outline = np.concatenate([faces[:, k], faces[::-1, k + 1]])
            for side in (1.0, -1.0):
                colour = style.LAYER_COLOURS[layer]
                axes.add_patch(
                    Polygon(
                        outline * [side, 1.0], facecolor=colour, edgecolor=colour, linewidth=0.4
                    )
                )
    axes.autoscale_view()
    style.plain_axes(axes)


def layer_legend(figure: FigureBase) -> None:
    """Say below a figure or a part of it which colour is which layer."""
    layers = [layer for layers in LAYERS.values() for layer in layers]
    figure.legend(
        handles=style.layer_handles(layers), loc="outside lower center", ncols=len(layers)
    )


def draw_field(axes: Axes, state: State, name: str, norm: Normalize, colours: str) -> Any:
    """Colour the layers of a state's section by a field; return what a colour bar needs.

    Args:
        axes: Where.
        state: The state.
        name: "stretch" or "stress".
        norm: Range of the colours.
        colours: Name of a colour map.
    """
    polygons, values = [], []
    for region, layers in LAYERS.items():
        part = state["regions"][region]
        faces = np.array(part["faces"])
        # a field near zero is as white as the paper
        for side in (1.0, -1.0):
            axes.plot(side * faces[:, :, 0], faces[:, :, 1], color=style.REFERENCE, lw=0.5)
        for k, layer in enumerate(layers):
            values_at = np.array(part[name][layer])
            field = (values_at[1:] + values_at[:-1]) / 2
            for i, value in enumerate(field):
                corners = [faces[i, k], faces[i + 1, k], faces[i + 1, k + 1], faces[i, k + 1]]
                for side in (1.0, -1.0):
                    polygons.append(np.array(corners) * [side, 1.0])
                    values.append(value)
    collection = PolyCollection(polygons, array=np.array(values), cmap=colours, norm=norm)
    collection.set_edgecolor("face")
    collection.set_linewidth(0.3)
    axes.add_collection(collection)
    axes.autoscale_view()
    style.plain_axes(axes)
    return collection


def shape_table(states: Sequence[State]) -> pd.DataFrame:
    """Return the faces of all states, one row a point of a face."""
    frames = []
    for state in states:
        for region, part in state["regions"].items():
            faces = np.array(part["faces"])
            for k in range(faces.shape[1]):
                frames.append(
                    pd.DataFrame(
                        {
                            "t_n": state["t_n"],
                            "region": region,
                            "face": k,
                            "theta": part["theta"],
                            "r_over_R": faces[:, k, 0],
                            "z_over_R": faces[:, k, 1],
                        }
                    )
                )
    return pd.concat(frames, ignore_index=True)


def field_table(states: Sequence[State], name: str) -> pd.DataFrame:
    """Return a field of all states along the meridian, one row a layer and place."""
    frames = []
    for state in states:
        for region, part in state["regions"].items():
            for layer in LAYERS[region]:
                frames.append(
                    pd.DataFrame(
                        {
                            "t_n": state["t_n"],
                            "layer": layer,
                            "theta": part["theta"],
                            name: part[name][layer],
                        }
                    )
                )
    return pd.concat(frames, ignore_index=True)
