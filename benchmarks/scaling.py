"""Time one Newton iteration at several mesh sizes: the chick cup's first steps.

    docker/run python3 benchmarks/scaling.py [SCALE]...
    docker/run mpirun -n 2 python3 benchmarks/scaling.py [SCALE]...

SCALE multiplies the three cell sizes of the default mesh (default: 1 0.7 0.5; 0.33 is 100,000
unknowns).  Times are those of the first process.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

from timers import PETSC_EVENTS, Timers, peak_memory

from opticcup_fem import load_case
from opticcup_fem.studies.model import shell_of, stepping_of

CHICK = Path(__file__).parents[1] / "demos" / "chick.toml"
SIZES = ("cell_size_cap", "cell_size_interface", "cell_size_oov")
PHASES = ("forms", "constitutive", "condensation", "assembly", *PETSC_EVENTS, "rest", "total")


def main() -> None:
    """Measure every size and print a table, in milliseconds per iteration."""
    parser = argparse.ArgumentParser(description="Time Newton iterations on finer meshes.")
    parser.add_argument("scales", nargs="*", type=float, default=[1.0, 0.7, 0.5])
    timers = Timers()
    headings = ("cells", "unknowns", *PHASES, "per 1000 cells", "peak MB")
    if MPI.COMM_WORLD.rank == 0:
        print(f"milliseconds per Newton iteration, {MPI.COMM_WORLD.size} processes")
        print(" ".join(f"{heading:>{_width(heading)}}" for heading in headings), flush=True)
    for scale in sorted(parser.parse_args().scales, reverse=True):
        measure(scale, timers)


def measure(scale: float, timers: Timers) -> None:
    """Grow the cup to t_n = 0.03 on one mesh and print its line."""
    sizes = load_case(CHICK).mesh
    overrides = [f"mesh.{name}={scale * getattr(sizes, name)}" for name in SIZES]
    case = load_case(CHICK, [*overrides, "run.t_end=0.03"])
    shell = shell_of(case, MPI.COMM_WORLD)
    stepping = stepping_of(case, shell)
    state = shell.reference_state()
    timers.reset()
    for _ in stepping.follow(state, case.run.t_end):
        pass
    each = {phase: 1000 * t / timers.iterations for phase, t in timers.split().items()}
    cells = shell.comm.allreduce(shell.spaces.n_cells)
    unknowns = stepping.problem.matrix.getSize()[0]
    line = [f"{cells:{_width('cells')}}", f"{unknowns:{_width('unknowns')}}"]
    line += [f"{each[phase]:{_width(phase)}.1f}" for phase in PHASES]
    line += [f"{1000 * each['total'] / cells:{_width('per 1000 cells')}.1f}"]
    line += [f"{peak_memory():{_width('peak MB')}.0f}"]
    if shell.comm.rank == 0:
        print(" ".join(line), flush=True)


def _width(heading: str) -> int:
    return max(len(heading), 8)


if __name__ == "__main__":
    main()
