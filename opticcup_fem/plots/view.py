"""An interactive page of a run: one HTML file that turns the cup and scrubs through its states.

Plotly draws it; its JavaScript is written into the page, which needs no server and no network.
Every position of the slider is an accepted state: nothing is interpolated.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import Normalize, to_hex

from opticcup_fem.errors import CaseError
from opticcup_fem.plots import style
from opticcup_fem.plots.body import Shape, Surface, layer_surfaces
from opticcup_fem.plots.curves import branches
from opticcup_fem.plots.page import UNSTABLE
from opticcup_fem.plots.playback import Playback, load_playbacks
from opticcup_fem.plots.scene_colours import COLOUR_LABELS, colour_map, colour_scale
from opticcup_fem.records import VIEW
from opticcup_fem.whole_files import replace_text

if TYPE_CHECKING:
    import plotly.graph_objects as go

MOST_STATES = 60
"""More states than this make a page of tens of megabytes; they are thinned out evenly."""

_GRID = {"n_phi": 48, "n_cap": 12, "n_oov": 20}
_DIGITS = 4

_PLAIN = {
    "$": "",
    r"\alpha": "α",
    r"\lambda_3": "λ<sub>3</sub>",
    r"\mu_\mathrm{IOV}": "μ<sub>IOV</sub>",
    "t_n": "t<sub>n</sub>",
}
"""Mathematics of figures in the page's own marks."""


def view(
    run_dir: str | Path,
    out: str | Path | None = None,
    *,
    quantity: str | None = None,
    cut: bool = True,
    most_states: int = MOST_STATES,
) -> Path:
    """Write the page of a run.

    Args:
        run_dir: The run's folder, with states.
        out: The page, ending in .html; view.html in the run's folder by default.
        quantity: What colours mean: None for layers, or a key of
            `opticcup_fem.plots.body.QUANTITIES`.
        cut: Whether a quarter is cut out.
        most_states: How many states to keep at most; the ends of jumps are always kept.

    Returns:
        The page's path.

    Raises:
        CaseError: The folder holds no states, or the page cannot be written there.
    """
    out = Path(out) if out is not None else Path(run_dir) / VIEW
    if out.suffix != ".html":
        raise CaseError(f"{out}: the page's name must end in .html")
    (playback,) = load_playbacks([run_dir], quantity)
    playback.prepare(cut=cut, quantity=quantity, **_GRID)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        replace_text(out, _page(playback, kept_states(playback, most_states)))
    except OSError as error:
        raise CaseError(f"{out}: cannot write there ({error.strerror})") from None
    return out


def kept_states(playback: Playback, most: int) -> list[int]:
    """Return the states that a page shows: both ends of every jump, and others evenly."""
    count = len(playback.course.t_n)
    jumps = playback.course.jumps
    kept = {0, count - 1, *jumps, *(k + 1 for k in jumps)}
    if count > most:
        kept |= {round(k) for k in np.linspace(0, count - 1, max(2, most - len(kept)))}
        return sorted(kept)
    return list(range(count))


def _page(playback: Playback, kept: Sequence[int]) -> str:
    """Return the page."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    figure = make_subplots(
        rows=1,
        cols=2,
        column_widths=[0.66, 0.34],
        specs=[[{"type": "scene"}, {"type": "xy"}]],
        horizontal_spacing=0.06,
    )
    bodies = _Bodies(playback)
    for trace in bodies.traces(kept[0]):
        figure.add_trace(trace, row=1, col=1)
    for trace in _curve(playback):
        figure.add_trace(trace, row=1, col=2)
    if bodies.scale is not None:
        figure.add_trace(_colour_bar(playback.grid.quantity or "", bodies.scale), row=1, col=2)
    figure.add_trace(_marker(playback, kept[0]), row=1, col=2)
    moving = [*range(bodies.count), len(figure.data) - 1]
    figure.frames = [
        go.Frame(
            name=str(k),
            data=[*bodies.moves(k), _marker(playback, k)],
            traces=moving,
            layout={"title": {"text": _title(playback, k)}},
        )
        for k in kept
    ]
    _arrange(figure, playback, kept)
    text: str = figure.to_html(include_plotlyjs=True, auto_play=False, default_height="94vh")
    return text


class _Bodies:
    """The layers of a playback as Plotly's meshes."""

    def __init__(self, playback: Playback) -> None:
        self._playback, self._grid = playback, playback.grid
        quantity = self._grid.quantity
        self.scale = (
            None
            if quantity is None
            else colour_scale(quantity, [s.values for s in playback.shapes])
        )
        self._parts: list[tuple[str, Surface, bool]] = []
        for layer in self._grid.layers:
            skin, walls = layer_surfaces(self._grid, layer)
            self._parts.append((layer, skin, False))
            if len(walls.triangles):
                self._parts.append((layer, walls, True))
        self.count = len(self._parts)

    def traces(self, k: int) -> "list[go.Mesh3d]":
        """Return the meshes of state k, complete."""
        import plotly.graph_objects as go

        shape, layers = self._playback.shapes[k], tuple(self._grid.layers)
        made = []
        for layer, surface, is_wall in self._parts:
            i, j, c = surface.triangles.T
            label = style.LAYER_LABELS.get(layer, layer)
            light = (
                {"ambient": 1.0, "diffuse": 0.0, "specular": 0.0}
                if is_wall
                else {"ambient": 0.45, "diffuse": 0.7, "specular": 0.1, "roughness": 0.7}
            )
            made.append(
                go.Mesh3d(
                    i=i.tolist(),
                    j=j.tolist(),
                    k=c.tolist(),
                    color=style.layer_colour(layer, layers),
                    name=label,
                    legendgroup=label,
                    showlegend=not is_wall,
                    lighting=light,
                    lightposition={"x": 1e4, "y": -2e4, "z": 3e4},
                    hoverinfo="name",
                    **self._moving(shape, layer, surface),
                )
            )
        return made

    def moves(self, k: int) -> "list[go.Mesh3d]":
        """Return what differs in state k."""
        import plotly.graph_objects as go

        shape = self._playback.shapes[k]
        return [go.Mesh3d(**self._moving(shape, layer, part)) for layer, part, _ in self._parts]

    def _moving(self, shape: Shape, layer: str, surface: Surface) -> dict[str, Any]:
        points = self._grid.layer_points(shape, layer)[surface.source]
        rounded = points.round(_DIGITS)
        parts: dict[str, Any] = {name: rounded[:, k].tolist() for k, name in enumerate("xyz")}
        if self.scale is not None and self._grid.quantity is not None:
            values = self._grid.layer_values(shape, layer)[surface.source]
            painted = colour_map(self._grid.quantity)(self.scale(values), bytes=True)[:, :3]
            parts["vertexcolor"] = [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in painted]
        return parts


def _curve(playback: Playback) -> "list[go.Scatter]":
    """Return D/r against t_n, branch by branch, and the events."""
    import plotly.graph_objects as go

    line = {"color": style.CURVES[0]}
    lines = [
        go.Scatter(
            x=branch["t_n"].tolist(), y=branch["D_over_r"].tolist(), mode="lines", line=line,
            showlegend=False, hovertemplate="t_n %{x:.4f}, D/r %{y:.4f}<extra></extra>",
        )
        for branch in branches(playback.path)
    ]  # fmt: skip
    times = [float(event["t_n"]) for event in playback.events]
    lines += [
        go.Scatter(
            x=[t, t], y=[0, 1], mode="lines", line={"color": style.REFERENCE, "dash": "dot"},
            showlegend=False, hovertemplate=_plain(style.event_label(event)) + "<extra></extra>",
        )
        for t, event in zip(times, playback.events, strict=True)
    ]  # fmt: skip
    return lines


def _marker(playback: Playback, k: int) -> "go.Scatter":
    import plotly.graph_objects as go

    row = playback.path.iloc[k]
    return go.Scatter(
        x=[float(row["t_n"])],
        y=[float(row["D_over_r"])],
        mode="markers",
        marker={"size": 12, "color": style.CURVES[0], "line": {"color": "white", "width": 1}},
        showlegend=False,
        hoverinfo="skip",
        cliponaxis=False,
    )


def _colour_bar(quantity: str, scale: Normalize) -> "go.Scatter":
    """Return a trace of no points that brings the scale of colours."""
    import plotly.graph_objects as go

    low, high = float(scale.vmin or 0.0), float(scale.vmax or 1.0)
    even = np.linspace(low, high, 5)
    decades = np.array([-100.0, -10.0, -1.0, 0.0, 1.0, 10.0, 100.0])
    values = decades[(low <= decades) & (decades <= high)] if quantity == "stress" else even
    shares = np.linspace(0.0, 1.0, 33)
    colours = [to_hex(colour) for colour in colour_map(quantity)(shares)]
    bar = {
        "tickvals": [float(scale(value)) for value in values],
        "ticktext": [f"{value:.3g}" for value in values],
        "title": {"text": _plain(COLOUR_LABELS[quantity]), "side": "top"},
        "orientation": "h",
        "x": 0.3,
        "y": 0.0,
        "len": 0.4,
        "thickness": 12,
    }
    marker = {"color": [0.0], "cmin": 0.0, "cmax": 1.0, "showscale": True, "colorbar": bar}
    marker["colorscale"] = [[float(at), name] for at, name in zip(shares, colours, strict=True)]
    return go.Scatter(
        x=[None], y=[None], mode="markers", marker=marker, showlegend=False, hoverinfo="skip"
    )


def _plain(label: str) -> str:
    """Return a label of a figure without its mathematics marks."""
    for mathematics, plain in _PLAIN.items():
        label = label.replace(mathematics, plain)
    return label


def _title(playback: Playback, k: int) -> str:
    """Return what is said of state k: the case, the time, and the events since the last state."""
    t_n = playback.course.t_n
    since = t_n[k - 1] if k else -np.inf
    ends = k == len(t_n) - 1
    events = [
        style.event_label(event)
        for event in playback.events
        if since < float(event["t_n"]) <= t_n[k] or (ends and float(event["t_n"]) > t_n[k])
    ]
    if k and playback.course.branch[k] != playback.course.branch[k - 1]:
        events.append("after a jump")
    if not playback.stable[k]:
        events.append(UNSTABLE)
    said = [playback.title, f"t_n = {t_n[k]:.4f}", *events]
    return _plain(" &nbsp; ".join(said))


def _arrange(figure: "go.Figure", playback: Playback, kept: Sequence[int]) -> None:
    """Set axes, camera, slider and buttons."""
    reach = 1.02 * max(float(np.abs(f).max()) for s in playback.shapes for f in s.faces.values())
    hidden = {"visible": False, "range": [-reach, reach], "autorange": False}
    flat, up = np.cos(playback.elevation), np.sin(playback.elevation)
    eye = {"x": flat * np.cos(playback.camera), "y": flat * np.sin(playback.camera), "z": up}
    still = {
        "frame": {"duration": 0, "redraw": True},
        "mode": "immediate",
        "transition": {"duration": 0},
    }
    playing = still | {"frame": {"duration": 120, "redraw": True}, "fromcurrent": True}
    figure.update_layout(
        title={"text": _title(playback, kept[0]), "x": 0.02},
        template="plotly_white",
        margin={"l": 10, "r": 20, "t": 60, "b": 10},
        uirevision="keep",
        legend={"x": 0.01, "y": 0.98},
        scene={
            "xaxis": hidden,
            "yaxis": hidden,
            "zaxis": hidden,
            "aspectmode": "cube",
            "camera": {"eye": {axis: 1.25 * value for axis, value in eye.items()}},
            "uirevision": "keep",
        },
        xaxis={"title": "normalised time t<sub>n</sub>", "rangemode": "tozero"},
        yaxis={"title": "invagination depth D/r", "rangemode": "tozero"},
        sliders=[
            {
                "active": 0,
                "currentvalue": {"prefix": "t_n = "},
                "pad": {"t": 30, "l": 90},
                "steps": [
                    {
                        "label": f"{playback.course.t_n[k]:.4f}",
                        "method": "animate",
                        "args": [[str(k)], still],
                    }
                    for k in kept
                ],
            }
        ],
        updatemenus=[
            {
                "type": "buttons",
                "direction": "left",
                "x": 0.0,
                "y": 0.0,
                "pad": {"t": 50},
                "xanchor": "left",
                "yanchor": "top",
                "showactive": False,
                "buttons": [
                    {"label": "▶", "method": "animate", "args": [None, playing]},
                    {"label": "❚❚", "method": "animate", "args": [[None], still]},
                ],
            }
        ],
    )
