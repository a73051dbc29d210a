"""`opticcup predict`: what becomes of one geometry, how near the boundary, what moves it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from opticcup_fem.case import Case, parse_case
from opticcup_fem.diagram.bisection import Bracket, bisect, changes
from opticcup_fem.diagram.regimes import Regime, regime, second_event
from opticcup_fem.diagram.tornado import Effect, effects
from opticcup_fem.studies.sweep.cache import Record, ResultCache
from opticcup_fem.studies.sweep.engine import Engine, engine_of
from opticcup_fem.studies.sweep.table import study_table, write_csv
from opticcup_fem.studies.sweep.tasks import task_of

HOURS = 20.0
"""Hours of t_n = 1 in the chick."""

CHANGE = 0.1
"""Relative change of each parameter."""

FACTORS = (0.4, 0.55, 0.7, 0.85, 1.0, 1.15, 1.35, 1.6, 2.0, 2.5)
"""R/h over its own value, among which the boundary is looked for."""

Tables = dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Geometry:
    """What a biologist measures.

    Attributes:
        radius: R in micrometres.
        thickness: h in micrometres.
        tables: The rest of the case; R/h in it is not looked at.
    """

    radius: float
    thickness: float
    tables: Tables

    def case(self, **factors: float) -> Case:
        """Return the case with some parameters multiplied.

        Args:
            factors: Factor of each parameter of ``PARAMETERS``.

        Raises:
            CaseError: The geometry cannot be.
        """
        tables = {name: dict(keys) for name, keys in self.tables.items()}
        ratio = self.radius / self.thickness
        for name, factor in factors.items():
            if name in ("R", "h"):
                ratio = ratio * factor if name == "R" else ratio / factor
                continue
            table, key = PARAMETERS[name].split(".")
            value = getattr(getattr(parse_case(tables), table), key) * factor
            # a tenth more than 0.48 is incompressible
            tables.setdefault(table, {})[key] = min(value, 0.5) if name == "nu" else value
        shape = {"radius_over_thickness": ratio, "radius_um": self.radius}
        tables["shape"] = tables.get("shape", {}) | shape
        tables["run"] = tables.get("run", {}) | {"model": "meridian"}
        return parse_case(tables, source="geometry")


PARAMETERS = {
    "R": "",
    "h": "",
    "alpha": "shape.opening_angle_deg",
    "m": "material.thickness_ratio",
    "n": "material.modulus_ratio",
    "nu": "material.poisson_ratio",
    "IOV growth": "growth.iov",
    "OOV growth": "growth.oov",
}
"""What is varied; R and h act through R/h alone."""


@dataclass(frozen=True)
class Forecast:
    """What becomes of a geometry.

    Attributes:
        case: The case.
        row: Its numbers.
        fate: Its regime.
        boundary: R/h between which the cup turns abnormal, None if it does not nearby.
        times: Effect of each parameter on t_n of the second event; empty where there is none.
        depths: The same on the largest D/r.
        fates: Regime with each parameter lowered and raised.
    """

    case: Case
    row: dict[str, Any]
    fate: Regime
    boundary: Bracket | None
    times: list[Effect]
    depths: list[Effect]
    fates: Mapping[str, tuple[Regime, Regime]]

    def sentences(self) -> list[str]:
        """Return the forecast in words."""
        shape = self.case.shape
        lines = [
            f"R/h = {shape.radius_over_thickness:.4g}, alpha = {shape.opening_angle_deg:g} deg, "
            f"theta_bar = {shape.theta_bar:.3f}: {_FATES[self.fate]}"
        ]
        events = (("1", "primary invagination"), ("2", "secondary invagination"))
        for suffix, name in events:
            t_n = self.row.get(f"t_{suffix}")
            if t_n is not None and (suffix == "1" or self.fate != "abnormal"):
                how = self.row[f"type_{suffix}"]
                lines.append(f"{name} ({how}) at t_n = {t_n:.4f} ({HOURS * t_n:.1f} h)")
        if self.row.get("t_b") is not None:
            t_n, m = self.row["t_b"], int(self.row["m_b"])
            lines.append(f"loss of symmetry (m = {m}) at t_n = {t_n:.4f} ({HOURS * t_n:.1f} h)")
        contact = self.row.get("t_contact")
        if contact is not None:
            lines.append(
                f"the shell touches itself at t_n = {contact:.4f}; nothing follows it there"
            )
        if self.row.get("reason"):
            lines.append(str(self.row["reason"]))
        lines.append(self._distance())
        turned = [
            f"{name} {sign}{100 * CHANGE:.0f} %: {fate}"
            for name, pair in self.fates.items()
            for sign, fate in zip("-+", pair, strict=True)
            if fate != self.fate
        ]
        lines.append(
            f"with one parameter changed: {'; '.join(turned)}"
            if turned
            else f"no single change of {100 * CHANGE:.0f} % turns it into another regime"
        )
        return lines

    def _distance(self) -> str:
        if self.boundary is None:
            ends = f"{FACTORS[0]:g} to {FACTORS[-1]:g}"
            return f"no boundary between normal and abnormal for {ends} times its R/h"
        ratio = self.case.shape.radius_over_thickness
        middle = self.boundary.middle
        side = "below" if ratio < middle else "above"
        return (
            f"the boundary lies at R/h = {middle:.3g} +- {self.boundary.half_width:.2g}: this cup "
            f"is {100 * abs(ratio / middle - 1):.0f} % {side} it"
        )


_FATES = {
    "normal": "normal cup, a second invagination deepens it",
    "abnormal": "abnormal cup, it buckles before it deepens",
    "invaginated": "invaginated cup that neither deepens again nor buckles",
    "evaginated": "no cup, the apex never sinks below the rim",
    "undecided": "undecided, the path ended before it could tell",
}


def run(
    geometry: Geometry, out_dir: Path, *, processes: int | None = None, quiet: bool = False
) -> Forecast | None:
    """Compute a forecast and write ``predict.csv`` and the tornado plot (collective under MPI).

    Args:
        geometry: The geometry.
        out_dir: Folder of the results; it exists.
        processes: Size of the pool, one a core by default.
        quiet: No progress bar.

    Returns:
        None on ranks that only helped.

    Raises:
        CaseError: The geometry cannot be.
    """
    with engine_of(ResultCache(), processes, shown=not quiet) as engine:
        if engine is None:
            return None
        forecast, table = _forecast(engine, geometry)
    from opticcup_fem.plots.tornado import tornado

    write_csv(study_table(*table), out_dir / "predict.csv")
    tornado(forecast, out_dir / "predict.png")
    return forecast


def _forecast(
    engine: Engine, geometry: Geometry
) -> tuple[Forecast, tuple[list[dict[str, Any]], list[Record]]]:
    changes: list[dict[str, float]] = [{}]
    changes += [{name: 1 + sign * CHANGE} for name in PARAMETERS for sign in (-1, 1)]
    cases = [geometry.case(**change) for change in changes]
    records = engine.run([task_of(case) for case in cases], "parameters")
    rows = [_row(record) for record in records]
    fates = [regime(row) for row in rows]
    numbers = {
        "times": [None if (e := second_event(row)) is None else e[1] for row in rows],
        "depths": [row.get("largest_D_over_r") for row in rows],
    }
    names = list(PARAMETERS)

    def of(values: Sequence[float | None]) -> list[Effect]:
        if values[0] is None:
            return []
        low, high = (
            dict(zip(names, values[1::2], strict=True)),
            dict(zip(names, values[2::2], strict=True)),
        )
        return effects(values[0], low, high)

    forecast = Forecast(
        cases[0],
        rows[0],
        fates[0],
        _boundary(engine, geometry),
        of(numbers["times"]),
        of(numbers["depths"]),
        dict(zip(names, zip(fates[1::2], fates[2::2], strict=True), strict=True)),
    )
    return forecast, ([{"changed": _words(change)} for change in changes], records)


def _words(change: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {100 * (f - 1):+.0f} %" for name, f in change.items()) or "nothing"


def _row(record: Record) -> dict[str, Any]:
    return {**record["row"], "status": record["status"], "reason": record.get("reason") or ""}


def _boundary(engine: Engine, geometry: Geometry) -> Bracket | None:
    """Return R/h between which the regime turns to or from abnormal nearest by, within 1 %."""
    ratio = geometry.radius / geometry.thickness

    def answers(questions: Sequence[float]) -> list[bool | None]:
        cases = [geometry.case(R=x / ratio) for x in questions]
        records = engine.run([task_of(case) for case in cases], "boundary")
        fates = [regime(_row(record)) for record in records]
        return [None if fate == "undecided" else fate == "abnormal" for fate in fates]

    places = [factor * ratio for factor in FACTORS if factor * ratio >= 2.0]
    brackets = changes(zip(places, answers(places), strict=True))
    if not brackets:
        return None
    # very thick cups may turn abnormal too: the boundary in question is the nearest
    bracket = min(brackets, key=lambda one: abs(math.log(one.middle / ratio)))
    found = bisect(
        {"R/h": bracket},
        {"R/h": 0.01 * bracket.middle},
        lambda questions: answers([x for _, x in questions]),
    )
    return found["R/h"]
