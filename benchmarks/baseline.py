"""Time the baseline: the chick cup from t_n = 0 to 1 on one core, with all its output.

    docker/run python3 benchmarks/baseline.py [--cold] [--set TABLE.KEY=VALUE]...

--cold compiles the kernels afresh, in an empty cache.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

CHICK = Path(__file__).parents[1] / "demos" / "chick.toml"
START = time.perf_counter()


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description="Time the chick cup.")
    parser.add_argument("--cold", action="store_true", help="compile the kernels afresh")
    parser.add_argument("--set", action="append", default=[], help="override a key of the case")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if arguments.cold:
            os.environ["XDG_CACHE_HOME"] = folder  # before dolfinx looks for its cache
        measure(arguments.set, Path(folder) / "run")


def measure(overrides: list[str], folder: Path) -> None:
    """Run the case and print where the time went."""
    from timers import Timers, peak_memory, table

    from opticcup_fem import load_case
    from opticcup_fem.records import read_path
    from opticcup_fem.studies import cup

    timers = Timers()
    imports = time.perf_counter() - START
    timers.reset()
    outcome = cup.run(load_case(CHICK, overrides), folder, quiet=True)
    split, cpu = timers.split(), timers.cpu
    rows = read_path(folder)
    print(outcome.message)
    print(f"\nimports {imports:.1f} s, then")
    print(table(split))
    print(f"{'processor time':30}{cpu:8.2f} s")
    print(f"\naccepted states         {len(rows)}")
    print(f"iterations in path.csv  {rows['newton_iterations'].sum()}")
    print(f"tangents assembled      {timers.iterations}")
    print(f"factorisations          {timers.factorisations}")
    print(f"peak memory             {peak_memory():.0f} MB")


if __name__ == "__main__":
    main()
