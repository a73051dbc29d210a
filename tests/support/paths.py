"""Stable paths of an independent solver, sampled as an adaptive run would record them.

`tests/data/stable_path_R<R/h>.csv` holds the branches that a run with growing t_n follows: its
states up to each limit point, then those of the branch onto which the shell falls there.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.interpolate import make_interp_spline

DATA = Path(__file__).parents[1] / "data"


@dataclass(frozen=True)
class Branch:
    """One branch, finely interpolated: increasing t_n, apex height c, D/r, kappa_cap R."""

    t_n: np.ndarray
    c: np.ndarray
    depth: np.ndarray
    kappa: np.ndarray


def stable_branches(radius_over_thickness: int) -> list[Branch]:
    """Return the branches of a stable path in order."""
    table = pd.read_csv(DATA / f"stable_path_R{radius_over_thickness}.csv")
    branches = []
    for _, rows in table.groupby("branch"):
        t, c = rows["t_n"].to_numpy(), rows["apex_height_over_R"].to_numpy()
        arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(t) / 0.1, np.diff(c)))])
        fine = np.linspace(0.0, arc[-1], 20001)
        t_fine = np.maximum.accumulate(make_interp_spline(arc, t)(fine))
        others = (np.interp(fine, arc, rows[name]) for name in ("D_over_r", "kappa_cap_R"))
        branches.append(Branch(t_fine, make_interp_spline(arc, c)(fine), *others))
    return branches


def recorded_path(
    branches: list[Branch],
    *,
    max_move: float,
    max_step: float,
    bracket: float,
    seed: int,
    t_end: float = 1.0,
) -> list[dict[str, float | bool]]:
    """Return rows as an adaptive run records them.

    Args:
        branches: The stable path.
        max_move: Steps in which the apex moves farther are cut.
        max_step: Longest step in t_n.
        bracket: Steps over a limit point are cut until they are this short, then the run jumps.
        seed: Of the steps' irregularity and of the rounding error, 1e-6 in c.
        t_end: Where the run stops; multiples of 0.1 are landed on.
    """
    rng = np.random.default_rng(seed)
    rows: list[dict[str, float | bool]] = []
    t, step, k, jump = 0.0, 0.01 * rng.uniform(0.5, 1.0), 0, False
    while True:
        on = branches[k]
        c, depth, kappa = (float(np.interp(t, on.t_n, x)) for x in (on.c, on.depth, on.kappa))
        rows.append(
            {
                "t_n": t,
                "apex_height_over_R": c + 1e-6 * rng.normal(),
                "D_over_r": depth,
                "kappa_cap_R": kappa,
                "jump": jump,
            }
        )
        if t >= t_end - 1e-9:
            return rows
        jump, step = False, min(step * rng.uniform(1.2, 1.6), max_step)
        while True:
            landing = 0.1 * (np.floor(t / 0.1 + 1e-9) + 1)
            new = min(t + step, landing, t_end)
            over_limit_point = new > on.t_n[-1] and k < len(branches) - 1
            if over_limit_point and new - t < bracket:
                k, jump = k + 1, True
                break
            if not over_limit_point and abs(np.interp(new, on.t_n, on.c) - c) <= max_move:
                break
            step = 0.45 * (new - t)
        t = float(new)
