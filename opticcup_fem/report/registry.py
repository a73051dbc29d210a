"""The figures of the report by name, with the sets that each one needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from opticcup_fem.report.figures import coexistence, cups, diagram, material, plates, readings
from opticcup_fem.report.figures.base import Drawn
from opticcup_fem.report.results import Results

if TYPE_CHECKING:
    import pandas as pd

Draw = Callable[[Results, "pd.DataFrame | None"], Drawn]


@dataclass(frozen=True)
class Entry:
    """A figure: the sets of ``plan.SETS`` that it needs, and what draws it."""

    needs: tuple[str, ...]
    draw: Draw


def _plain(draw: Callable[[Results], Drawn]) -> Draw:
    return lambda results, _: draw(results)


def _chick(name: str) -> Draw:
    return lambda results, experiment: cups.chick_figure(results, experiment, name)


FIGURES: dict[str, Entry] = {
    "fig1": Entry(("chick",), _chick("fig1")),
    "fig2": Entry(("slenderness", "shapes"), _plain(cups.slenderness_figure)),
    "fig3": Entry(("slenderness",), _plain(cups.drive_figure)),
    "fig4": Entry(("slenderness", "angles", "coexistence"), _plain(diagram.phase_figure)),
    "s1": Entry(("shapes",), _plain(material.thickness_figure)),
    "s2": Entry(("chick",), _chick("s2")),
    "s3": Entry(("slenderness",), _plain(cups.apex_figure)),
    "s4": Entry(("plates",), _plain(plates.plate_figure)),
    "s5": Entry(("moduli", "stresses"), _plain(material.moduli_figure)),
    "s6": Entry(("evagination", "evaginated", "poisson"), _plain(material.limits_figure)),
    "readings": Entry(("slenderness", "readings"), _plain(readings.readings_figure)),
    "mass-off": Entry(("no_mass", "readings_off"), _plain(readings.mass_figure)),
    "coexistence": Entry(("coexistence", "slenderness"), _plain(coexistence.coexistence_figure)),
    "surface": Entry(("surface", "slenderness", "angles"), _plain(readings.surface_figure)),
}
"""In the report's order."""
