"""Coarse cups that tests compute in seconds."""

from collections.abc import Sequence

from opticcup_fem.case import Case, parse_case

COARSE = {"cell_size_cap": 0.34, "cell_size_interface": 0.16, "cell_size_oov": 0.45}
"""About 230 cells at 40 degrees: folds are a few per cent late, everything else is right."""


def coarse_case(
    radius_over_thickness: float = 5.0, t_end: float = 0.1, **tables: dict[str, object]
) -> Case:
    """Return a case on the coarse mesh; ``tables`` add or replace keys of its tables."""
    data: dict[str, dict[str, object]] = {
        "shape": {"radius_over_thickness": radius_over_thickness},
        "run": {"t_end": t_end},
        "mesh": dict(COARSE),
        "output": {"picture": False},
    }
    for name, keys in tables.items():
        data[name] = {**data.get(name, {}), **keys}
    return parse_case(data)


BETWEEN_PLATES = coarse_case(
    t_end=0.008,
    contact={
        "mode": "resist",
        "obstacles": [
            {"kind": "plate", "centre": [0.0, 0.0, -1.145], "velocity": [0.0, 0.0, 0.2]},
            {"kind": "plate", "centre": [0.0, 0.0, 1.145]},
        ],
    },
    solver={"initial_step": 0.001, "max_step": 0.001},
    output={"times": [0.008]},
)
"""Grows until it touches two plates, one of which moves; touches after its second state."""

SLIT = coarse_case(
    20.0,
    t_end=0.26,
    run={"keep_mirrors": True},
    contact={"mode": "resist"},
    output={"times": [0.26]},
)
"""Loses its symmetry near 0.248 and becomes a slit whose rims touch, between two mirrors."""


def coarse_arguments(keys: Sequence[str] = tuple(COARSE)) -> list[str]:
    """Return the coarse mesh as command-line overrides."""
    return [part for key in keys for part in ("--set", f"mesh.{key}={COARSE[key]}")]
