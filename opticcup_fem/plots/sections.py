"""Meridian cross-sections to scale: true thickness, layers coloured."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from opticcup_fem.plots import style
from opticcup_fem.records import SectionedState
from opticcup_fem.sections import Section
from opticcup_fem.snapshot import Floats


def opposite_sections(state: SectionedState) -> list[tuple[Section, Section]]:
    """Return the pairs of meridians that make whole sections through the axis."""
    half = len(state.sections) // 2
    return list(zip(state.sections[:half], state.sections[half:], strict=True))


def _width(pair: tuple[Section, Section]) -> float:
    """Return the distance across the cap's edge."""
    ends = [section.parts["cap"].midsurface[-1] for section in pair]
    return float(np.linalg.norm(ends[0] - ends[1]))


def across(state: SectionedState) -> tuple[Section, Section]:
    """Return the section to show: the first plane, or across a mouth that is not round."""
    pairs = opposite_sections(state)
    widths = [_width(pair) for pair in pairs]
    round_mouth = max(widths) - min(widths) < 0.02 * max(widths)
    return pairs[0] if round_mouth else pairs[int(np.argmin(widths))]


def in_plane(points: Floats, phi: float) -> Floats:
    """Return positions (..., 3) as distance from the axis towards azimuth phi, and height."""
    return np.stack(
        [points[..., 0] * np.cos(phi) + points[..., 1] * np.sin(phi), points[..., 2]], axis=-1
    )


def draw_section(axes: Axes, state: SectionedState) -> None:
    """Fill the layers of one state's section; all lengths in R."""
    pair = across(state)
    layers = tuple(name for part in pair[0].parts.values() for name in part.layers)
    for section in pair:
        for part in section.parts.values():
            faces = in_plane(part.faces, pair[0].phi)
            thickest = np.linalg.norm(np.diff(faces, axis=1), axis=2).mean(axis=0).max()
            for k, layer in enumerate(part.layers):
                outline = np.concatenate([faces[:, k], faces[::-1, k + 1]])
                thin = np.linalg.norm(faces[:, k + 1] - faces[:, k], axis=1).mean() < thickest
                colour = style.layer_colour(layer, layers)
                # an edge in its own colour keeps a thin layer visible in a small picture
                axes.add_patch(
                    Polygon(
                        outline,
                        facecolor=colour,
                        edgecolor=colour,
                        linewidth=0.6 if thin else 0.3,
                        zorder=2 if thin else 1,
                    )
                )
    style.plain_axes(axes)


def bounds(state: SectionedState) -> tuple[float, float, float]:
    """Return the largest distance from the axis, the lowest and the highest point of a state."""
    faces = [part.faces for section in state.sections for part in section.parts.values()]
    reach = max(float(np.hypot(x[..., 0], x[..., 1]).max()) for x in faces)
    heights = np.concatenate([x[..., 2].ravel() for x in faces])
    return reach, float(heights.min()), float(heights.max())


@dataclass(frozen=True)
class KeyState:
    """A state to show, and why: "start", "before primary invagination", ..., "end", or ""."""

    state: SectionedState
    why: str


def key_states(
    states: Sequence[SectionedState], events: Sequence[dict[str, Any]], most: int = 6
) -> list[KeyState]:
    """Return the states to show: start, just before and after each event, end, and between.

    Args:
        states: All states with sections, in the order of the path.
        events: The run's events.
        most: How many states to show at most; at least 2.
    """
    why: dict[int, str] = {0: "start"}
    if len(states) > 1:
        why[len(states) - 1] = "end"
    t = np.array([state.t_n for state in states])
    if np.any(np.diff(t) < 0):  # a path that goes back in t_n: times do not tell its states apart
        shown = np.unique(np.linspace(0, len(states) - 1, most).round().astype(int)).tolist()
        return [KeyState(states[k], why.get(k, "")) for k in shown]
    for item in sorted(events, key=lambda e: float(e["t_n"])):
        low, high = item.get("t_n_range", (item["t_n"], item["t_n"]))
        name = str(item["kind"]).replace("_", " ")
        before = int(np.flatnonzero(t <= low).max(initial=0))
        after = np.flatnonzero((t >= high) & (np.arange(len(t)) > before))
        for k, word in ((before, "before"), (int(after[0]) if len(after) else 0, "after")):
            if len(why) < most:
                why.setdefault(k, f"{word} {name}")
    while len(why) < min(most, len(states)):
        distance = np.abs(t[:, None] - t[list(why)]).min(axis=1)
        distance[list(why)] = -1.0
        why[int(np.argmax(distance))] = ""
    return [KeyState(states[k], why[k]) for k in sorted(why)]
