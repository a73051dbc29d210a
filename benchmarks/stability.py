"""What watching the stability costs: runs with and without critical points, in processor time.

    docker/run python3 benchmarks/stability.py [R/h]...

A plain run counts negative eigenvalues too, in the factor that it has anyway; it does not compute
eigenvalues and modes, and does not localise and classify critical points.  Each run has a process
of its own, so that its largest memory is its own (default: R/h = 5 and 10, to t_n = 1).
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from mpi4py import MPI

from apart import measured_apart
from timers import peak_memory

from opticcup_fem import load_case
from opticcup_fem.studies.model import shell_of, stepping_of

CHICK = Path(__file__).parents[1] / "demos" / "chick.toml"


def main() -> None:
    """Run every case twice and print a table."""
    parser = argparse.ArgumentParser(description="Time runs with and without critical points.")
    parser.add_argument("ratios", nargs="*", type=float, default=[5.0, 10.0], metavar="R/h")
    print(f"{'R/h':>5} {'watched':>8} {'seconds':>8} {'peak MB':>8} {'states':>7} {'critical':>9}")
    for ratio in parser.parse_args().ratios:
        seconds = [_in_own_process(ratio, watched) for watched in (False, True)]
        print(f"{ratio:5g} {'ratio':>8} {seconds[1] / seconds[0]:8.2f}", flush=True)


def _in_own_process(ratio: float, watched: bool) -> float:
    """Measure one run, print its line and return its processor time."""
    seconds, memory, states, critical = measured_apart(measure, ratio, watched)
    name = "yes" if watched else "no"
    line = f"{ratio:5g} {name:>8} {seconds:8.1f} {memory:8.0f} {states:7d}"
    print(f"{line} {len(critical):9d}  {', '.join(critical)}", flush=True)
    return seconds


def measure(ratio: float, watched: bool) -> tuple[float, float, int, list[str]]:
    """Grow a cup on its default mesh; return seconds, MB, states and critical points."""
    case = load_case(CHICK, [f"shape.radius_over_thickness={ratio}"])
    shell = shell_of(case, MPI.COMM_SELF)
    stepping = stepping_of(case, shell)
    if not watched:
        stepping.critical = None
    states, critical = 0, []
    start = time.process_time()
    for point in stepping.follow(shell.reference_state(), case.run.t_end, case.output.times):
        states += 1
        critical += [f"{one.kind} {one.t_n:.5f}" for one in point.critical]
    return time.process_time() - start, peak_memory(), states, critical


if __name__ == "__main__":
    main()
