"""What is computed for the report: sets of cups by name.

All are the chick cup of the paper but for what a set varies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from opticcup_fem.case import Case, parse_case
from opticcup_fem.studies.sweep.cache import Task
from opticcup_fem.studies.sweep.tasks import task_of

TIMES = (0.1, 0.2, 0.4, 0.5, 0.7, 1.0)
RATIOS = tuple(float(ratio) for ratio in range(5, 21))
BY_ANGLE = {
    30.0: (5, 6, 8, 10, 12, 14, 16, 18, 20, 24, 28, 32),
    35.0: (5, 6, 8, 9, 10, 11, 12, 13, 14, 16, 18, 20, 24),
    45.0: (5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 16, 18, 20),
    50.0: (5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 16, 18, 20),
}
"""R/h at each opening angle; 40 degrees has ``RATIOS``."""

WAVES, WAVES_OFF = 6, 16
"""Wavenumbers of the stability analysis; without mass change the rim wrinkles at high ones."""

READINGS: dict[str, dict[str, Any]] = {
    "layer-stretch (3, 6, 8)": {"closure": "layer-stretch", "thickness_points": [3, 6, 8]},
    "layer-stretch (2, 3, 3)": {"closure": "layer-stretch", "thickness_points": [2, 3, 3]},
    "paper (2, 3, 3)": {"closure": "paper", "thickness_points": [2, 3, 3]},
    "paper (3, 6, 8)": {"closure": "paper", "thickness_points": [3, 6, 8]},
    "closed-form (2, 5, 5)": {"closure": "closed-form", "thickness_points": [2, 5, 5]},
    "condensed (2, 5, 5)": {"closure": "condensed", "thickness_points": [2, 5, 5]},
}
"""Closures and thickness rules beside the default, layer-stretch with (2, 5, 5)."""

READING_RATIOS = (5.0, 7.0, 9.0, 11.0, 13.0, 14.0, 15.0, 17.0, 20.0)


@dataclass(frozen=True)
class Planned:
    """One thing to compute.

    Attributes:
        settings: What is special about it.
        task: The task.
    """

    settings: dict[str, Any]
    task: Task


def chick(**settings: Any) -> Case:
    """Return the paper's cup with some settings.

    Args:
        settings: ``ratio``, ``alpha_deg``, ``mass_change``, ``times``, ``t_end``, ``waves``,
            ``model``, and keys of the table material.
    """
    given = dict(settings)
    take = given.pop
    return parse_case(
        {
            "shape": {
                "radius_over_thickness": float(take("ratio", 5.0)),
                "opening_angle_deg": float(take("alpha_deg", 40.0)),
            },
            "growth": {"mass_change": take("mass_change", True)},
            "run": {
                "model": take("model", "meridian"),
                "t_end": take("t_end", 1.0),
                "max_wavenumber": take("waves", WAVES),
            },
            "output": {"times": list(take("times", TIMES))},
            "contact": {"mode": "stop"},  # the letter's cups resist none
            "material": given,
        }
    )


def planned(kind: str = "cup", **settings: Any) -> Planned:
    """Return a cup of the paper with some settings as a thing to compute."""
    return Planned(settings, task_of(chick(**settings), kind))


def _grid(**fixed: Any) -> list[Planned]:
    return [planned(ratio=ratio, alpha_deg=40.0, **fixed) for ratio in RATIOS]


def _angles() -> list[Planned]:
    return [
        planned(ratio=float(ratio), alpha_deg=angle)
        for angle, ratios in BY_ANGLE.items()
        for ratio in ratios
    ]


def ratio_of(theta_bar: float, alpha_deg: float = 40.0) -> float:
    """Return R/h of a cup with a given theta_bar = alpha sqrt(R/h)."""
    import math

    return round((theta_bar / math.radians(alpha_deg)) ** 2, 4)


def _plates() -> list[Planned]:
    points = []
    for ratio in (8.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0):
        parameters = {
            "radius_over_thickness": ratio,
            "thickness_ratio": 1 / 9,
            "modulus_ratio": 50.0,
            "poisson_ratio": 0.45,
        }
        points.append(Planned({"ratio": ratio}, Task.of("plate", "meridian", parameters)))
    return points


MODULI = (20.0, 50.0, 100.0)
POISSON = (0.40, 0.45, 0.49)
LIMITS = (0.40, 0.42, 0.44, 0.45, 0.46, 0.47, 0.48, 0.49, 0.50)
THICK, THIN = 1.85, 3.04
"""theta_bar of the two shells of Fig. S6(b)."""


def _moduli(kind: str, times: Sequence[float]) -> list[Planned]:
    pairs = [(n, 0.45) for n in MODULI] + [(50.0, nu) for nu in POISSON if nu != 0.45]
    return [planned(kind, modulus_ratio=n, poisson_ratio=nu, times=times) for n, nu in pairs]


def _poisson() -> list[Planned]:
    return [
        planned(ratio=ratio_of(theta), alpha_deg=40.0, poisson_ratio=nu)
        for theta in (THICK, THIN)
        for nu in LIMITS
    ]


def _readings() -> list[Planned]:
    return [
        planned(ratio=ratio, alpha_deg=40.0, **reading)
        for reading in READINGS.values()
        for ratio in READING_RATIOS
    ]


def _readings_off() -> list[Planned]:
    return [
        planned(ratio=ratio, alpha_deg=40.0, mass_change=False, waves=WAVES_OFF, **reading)
        for name, reading in READINGS.items()
        if name in ("paper (2, 3, 3)", "condensed (2, 5, 5)")
        for ratio in (5.0, 10.0, 15.0, 20.0)
    ]


_DEEPENING = (0.1, 0.36, 0.38, 0.4, 0.42, 0.44, 0.5)
"""Normalised times of a cup whose apex sinks a second time: a smooth event lies between states."""

SURFACE = (
    (35.0, 14.0, (0.1, 0.6)),
    (30.0, 14.0, (0.1, 0.6)),
    (40.0, 7.0, _DEEPENING),
    (40.0, 10.0, _DEEPENING),
    (40.0, 16.0, (0.1, 0.35)),
    (45.0, 14.0, (0.1, 0.35)),
)
"""(alpha in degrees, R/h, times) of the cups that the surface model repeats, two a regime."""


def _surface() -> list[Planned]:
    return [
        planned(model="surface", alpha_deg=angle, ratio=ratio, t_end=times[-1], times=times)
        for angle, ratio, times in SURFACE
    ]


SLITS: dict[str, Any] = {
    "ratios": [17.0, 16.0, 15.0, 14.0, 13.5, 13.0, 12.5, 12.0, 11.5],
    "times": [0.31, 0.34, 0.37, 0.27, 0.22, 0.18, 0.14, 0.11],
    "before": 0.25,
    "case": {
        "mesh": {"cell_size_cap": 0.34, "cell_size_interface": 0.12, "cell_size_oov": 0.3},
        "contact": {"mode": "resist"},
    },
}
"""Parameters of ``studies.coexistence``, on a mesh of 546 cells."""


def _coexistence() -> list[Planned]:
    settings = {"ratios": SLITS["ratios"], "mesh": "546 cells"}
    return [Planned(settings, Task.of("coexistence", "coexistence", SLITS))]


FINE = tuple(round(0.025 * k, 3) for k in range(1, 41))

SETS: dict[str, Callable[[], list[Planned]]] = {
    "coexistence": _coexistence,
    "surface": _surface,
    "chick": lambda: [planned(mass_change=on, times=FINE) for on in (True, False)],
    "slenderness": _grid,
    "angles": _angles,
    "no_mass": lambda: _grid(mass_change=False, waves=WAVES_OFF),
    "shapes": lambda: [
        planned("layers", ratio=5.0, times=(0.01, 0.1, 0.45, 0.6, 1.0)),
        planned("layers", ratio=15.0, times=(0.01, 0.1, 0.28)),
    ],
    "plates": _plates,
    "moduli": lambda: _moduli("cup", FINE),
    "stresses": lambda: _moduli("layers", (0.1, 0.4, 0.65, 1.0)),
    "evagination": lambda: [planned(modulus_ratio=n) for n in (10.0, 20.0, 50.0, 100.0)],
    "evaginated": lambda: [planned("layers", modulus_ratio=10.0, times=(0.1, 0.5, 1.0))],
    "poisson": _poisson,
    "readings": _readings,
    "readings_off": _readings_off,
}
"""Every set, those with the longest tasks first."""
