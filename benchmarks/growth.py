"""What growth by mass balance costs: runs of the chick cup, prescribed and by sources, with flux.

    docker/run python3 benchmarks/growth.py [--model MODEL] [--coarse FACTOR] [--to T] [--rounds N]

Prints states, iterations and processor time of each run, and both over those of the first.  Each
run has a process of its own; the time is the least of some rounds through all runs.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from mpi4py import MPI

import pandas as pd
from apart import measured_apart

from opticcup_fem import load_case
from opticcup_fem.studies.run import run

CHICK = Path(__file__).parents[1] / "demos" / "chick.toml"
EVEN = "10/(1 + 5*t_n)*rho"
UNEVEN = f"{EVEN}*(1 + 0.5*(cos(theta) - 0.883))"  # as much over the cap as an even one


def _balanced(source: str, diffusivity: float = 0.0) -> list[str]:
    return [f'mass.iov.source="{source}"', f"mass.iov.diffusivity={diffusivity}"]


RUNS = {
    "prescribed": [],
    "balance, even source": _balanced(EVEN),
    "balance, uneven source": _balanced(UNEVEN),
    "flux, D = .02": _balanced(UNEVEN, 0.02),
    "flux, D = .1": _balanced(UNEVEN, 0.1),
}


def main() -> None:
    """Run every case and print a table."""
    parser = argparse.ArgumentParser(description="Time growth by mass balance.")
    parser.add_argument("--model", default="surface", choices=["surface", "meridian"])
    parser.add_argument("--coarse", type=float, default=1.8, metavar="FACTOR", help="of cells")
    parser.add_argument("--to", type=float, default=0.2, metavar="T", help="last t_n")
    parser.add_argument("--rounds", type=int, default=3, metavar="N", help="through all runs")
    options = parser.parse_args()
    best: dict[str, tuple[int, int, float]] = {}
    for _ in range(options.rounds):
        for name, keys in RUNS.items():
            found = measured_apart(measure, keys, options.model, options.coarse, options.to)
            best[name] = min(best.get(name, found), found, key=lambda one: one[2])
    _, least, shortest = next(iter(best.values()))
    for name, (states, iterations, seconds) in best.items():
        ratios = f"{iterations / least:.2f}, {seconds / shortest:.2f}"
        counts = f"{states:4d} states {iterations:5d} iterations"
        print(f"{name:<24}{counts} {seconds:6.1f} s   {ratios}")


def measure(keys: list[str], model: str, coarse: float, t_end: float) -> tuple[int, int, float]:
    """Grow a cup and return states, iterations and processor seconds."""
    quiet = [f"output.{name}=false" for name in ("fields", "states", "picture")]
    keys = [*keys, *quiet, f'run.model="{model}"', f"run.t_end={t_end}"]
    mesh = load_case(CHICK, keys).mesh
    for name in ("cell_size_oov", "cell_size_interface"):
        keys.append(f"mesh.{name}={coarse * getattr(mesh, name)}")
    case = load_case(CHICK, keys)
    with tempfile.TemporaryDirectory() as folder:
        start = time.process_time()
        run(case, Path(folder), comm=MPI.COMM_SELF, quiet=True)
        seconds = time.process_time() - start
        path = pd.read_csv(Path(folder) / "path.csv")
    return len(path), int(path["newton_iterations"].sum()), seconds


if __name__ == "__main__":
    main()
