"""Computes the sets of the plan and the transitions between their points."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from opticcup_fem.diagram.bisection import Bracket, bisect, first_change
from opticcup_fem.diagram.regimes import regime
from opticcup_fem.errors import OpticCupError
from opticcup_fem.report.plan import BY_ANGLE, SETS, Planned, planned
from opticcup_fem.studies.sweep.cache import Record
from opticcup_fem.studies.sweep.engine import Engine
from opticcup_fem.studies.sweep.rows import empty_row

Row = dict[str, Any]


@dataclass(frozen=True)
class Computed:
    """A planned thing and its record."""

    settings: dict[str, Any]
    record: Record

    @property
    def row(self) -> Row:
        """Settings, numbers and status in one; ``ratio`` and ``angle`` as the fits want them."""
        settings = {"alpha_deg": 40.0, "ratio": 5.0, **self.settings}
        ending = {"status": self.record["status"], "reason": self.record.get("reason") or ""}
        angle = math.radians(float(settings["alpha_deg"]))
        return {**settings, "angle": angle, **empty_row(), **self.record.get("row", {}), **ending}

    @property
    def states(self) -> list[dict[str, Any]]:
        """The states of a task ``layers``; raises OpticCupError where it has none."""
        return self._listed("states", "no output time was reached")

    @property
    def pairs(self) -> list[dict[str, Any]]:
        """The pairs of a task ``coexistence``; raises OpticCupError where it has none."""
        return self._listed("pairs", "none was asked for")

    def _listed(self, name: str, otherwise: str) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.record.get(name, [])
        if not found:
            reason = self.record.get("reason") or otherwise
            raise OpticCupError(f"no {name} of the cup {self.settings}: {reason}")
        return found


@dataclass
class Results:
    """What was computed.

    Attributes:
        sets: Records of each set.
        transitions: Brackets by name, in R/h but for "evagination", which is in n.
        asked: Every cup that a bisection looked at, by transition: its row.
    """

    sets: dict[str, list[Computed]] = field(default_factory=dict)
    transitions: dict[str, Bracket] = field(default_factory=dict)
    asked: dict[str, list[Row]] = field(default_factory=dict)

    def rows(self, name: str) -> list[Row]:
        """Return the rows of a set."""
        return [one.row for one in self.sets[name]]


def compute(engine: Engine, names: Iterable[str]) -> Results:
    """Compute sets, all of their tasks as one batch; then the transitions that they bracket."""
    chosen = [name for name in SETS if name in set(names)]
    plans: dict[str, list[Planned]] = {name: SETS[name]() for name in chosen}
    tasks = [one.task for plan in plans.values() for one in plan]
    records = iter(engine.run(tasks, "cups of the report"))
    results = Results()
    for name, plan in plans.items():
        results.sets[name] = [Computed(one.settings, next(records)) for one in plan]
    _bisect(engine, results)
    return results


_TOLERANCE = {"theta_s": 0.03, "theta_b": 0.03, "evagination": 0.1}
"""Half widths wanted: of theta_s and theta_b in R/h over R/h at 10, of n."""


def _bisect(engine: Engine, results: Results) -> None:
    """Localise the transitions between neighbouring cups of the sets."""
    brackets: dict[str, Bracket] = {}
    if "slenderness" in results.sets:
        rows = results.rows("slenderness")
        rows += results.rows("angles") if "angles" in results.sets else []
        for angle in sorted({row["alpha_deg"] for row in rows}):
            of_angle = [row for row in rows if row["alpha_deg"] == angle]
            for kind in ("theta_s", "theta_b"):
                found = first_change((row["ratio"], _answer(kind, row)) for row in of_angle)
                if found is not None:
                    brackets[f"{kind} {angle:g}"] = found
    if "evagination" in results.sets:
        rows = results.rows("evagination")
        found = first_change((row["modulus_ratio"], _answer("evagination", row)) for row in rows)
        if found is not None:
            brackets["evagination"] = found

    def ask(questions: Sequence[tuple[str, float]]) -> list[bool | None]:
        plans = [_question(name, x) for name, x in questions]
        records = engine.run([one.task for one in plans], "bisection")
        answers = []
        for (name, _), plan, record in zip(questions, plans, records, strict=True):
            row = Computed(plan.settings, record).row
            results.asked.setdefault(name, []).append(row)
            answers.append(_answer(name.split()[0], row))
        return answers

    tolerance = {name: _TOLERANCE[name.split()[0]] for name in brackets}
    results.transitions = bisect(brackets, tolerance, ask)


def _answer(kind: str, row: Row) -> bool | None:
    """Return what a bisection asks of a cup."""
    if kind == "theta_s":
        return None if row.get("type_1") is None else row["type_1"] == "fold"
    fate = regime(row)
    if fate == "undecided":
        return None
    return fate == "abnormal" if kind == "theta_b" else fate != "evaginated"


def _question(name: str, x: float) -> Planned:
    kind, _, angle = name.partition(" ")
    if kind == "evagination":
        return planned(modulus_ratio=x)
    # a loss of symmetry at the transition lies at t_n of about 0.3, secondary events at 0.4
    last = 0.15 if kind == "theta_s" else 0.45
    waves = 2 if kind == "theta_s" else 4
    return planned(ratio=x, alpha_deg=float(angle), t_end=last, waves=waves, times=(last,))


ANGLES = (40.0, *BY_ANGLE)
"""All opening angles of the phase diagram."""
