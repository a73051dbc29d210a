"""What contact costs and changes: runs with contact resisted and looked away from.

    docker/run python3 benchmarks/contact.py [R/h]... [--case FILE] [--coarse FACTOR] [--to T]

Prints processor time up to the first touch and behind it, and by how much the states differ that
touch nothing (they should not).  Each run has a process of its own.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from mpi4py import MPI

import numpy as np
from apart import measured_apart

from opticcup_fem import load_case
from opticcup_fem.studies.model import shell_of, stepping_of

CHICK = str(Path(__file__).parents[1] / "demos" / "chick.toml")

State = tuple[float, float, bool, np.ndarray]
"""Normalised time, processor time, whether anything touches, positions."""


def main() -> None:
    """Run every case twice and print a table."""
    parser = argparse.ArgumentParser(description="Time runs with and without contact.")
    parser.add_argument("ratios", nargs="*", type=float, metavar="R/h", help="the case's if none")
    parser.add_argument("--coarse", type=float, default=1.0, metavar="FACTOR", help="of cells")
    parser.add_argument("--to", type=float, default=1.0, metavar="T", help="last t_n")
    parser.add_argument(
        "--case", default=CHICK, metavar="FILE", help="case, chick.toml if not given"
    )
    options = parser.parse_args()
    own = load_case(options.case).shape.radius_over_thickness
    for ratio in options.ratios or [own]:
        off, on = (
            measured_apart(measure, options.case, ratio, mode, options.coarse, options.to)
            for mode in ("off", "resist")
        )
        first = next((k for k, state in enumerate(on) if state[2]), len(on))
        touch = on[first][0] if first < len(on) else np.inf
        print(f"R/h = {ratio:g}: {len(off)} and {len(on)} states; first touch at t_n = {touch:g}")
        same = min(first, len(off))
        apart = max(float(np.abs(off[k][3] - on[k][3]).max()) for k in range(same))
        times = max(abs(off[k][0] - on[k][0]) for k in range(same))
        print(f"  before: states differ by {apart:.1e} R, times by {times:.1e}")
        before = [_seconds(states, -1.0, on[first - 1][0]) for states in (off, on)]
        print(
            f"  before: {before[0]:.1f} s and {before[1]:.1f} s, ratio {before[1] / before[0]:.3f}"
        )
        if first < len(on):
            after = [_seconds(states, on[first - 1][0], 2.0) for states in (off, on)]
            print(
                f"  after: {after[0]:.1f} s and {after[1]:.1f} s, ratio {after[1] / after[0]:.2f}"
            )


def _seconds(states: list[State], start: float, end: float) -> float:
    """Return the processor time of the states in a half-open range of t_n."""
    return sum(seconds for t_n, seconds, _, _ in states if start < t_n <= end)


def measure(file: str, ratio: float, mode: str, coarse: float, t_end: float) -> list[State]:
    """Grow the cup of a case file and return its states."""
    keys = [f"shape.radius_over_thickness={ratio}", f'contact.mode="{mode}"', f"run.t_end={t_end}"]
    mesh = load_case(file, keys).mesh
    for name in ("cell_size_oov", "cell_size_interface"):
        keys.append(f"mesh.{name}={coarse * getattr(mesh, name)}")
    case = load_case(file, keys)
    shell = shell_of(case, MPI.COMM_SELF)
    stepping = stepping_of(case, shell)
    found, start = [], time.process_time()
    for point in stepping.follow(shell.reference_state(), case.run.t_end, case.output.times):
        touches = point.state.contact is not None and point.state.contact.touches
        found.append((point.t_n, time.process_time() - start, touches, point.state.r))
        start = time.process_time()
    return found


if __name__ == "__main__":
    main()
