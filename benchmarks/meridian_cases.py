"""Whole axisymmetric paths of a hundred cups: outcome, events and time of each, as CSV.

    python benchmarks/meridian_cases.py > cases.csv

Thickness rule, mesh and steps are the defaults; stability is counted in m = 0 .. 6.  Seconds are
processor time of the path with its spectra, without the compilation of the kernels.
"""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Iterator

from opticcup_fem.case import Case, parse_case
from opticcup_fem.meridian.contact import self_crossing
from opticcup_fem.studies.meridian import path_of

RATIOS = (5, 8, 10, 15, 20, 30)
FEWER = (5, 10, 20, 30)


def cases() -> Iterator[tuple[float, float, float, float, bool]]:
    """Yield (R/h, alpha in degrees, n, nu, mass change) of 100 cups."""
    for mass_change in (True, False):
        for ratio in RATIOS:
            for angle in (25, 40, 55):
                yield ratio, angle, 50, 0.45, mass_change
        for ratio in FEWER:
            for n in (5, 10, 20, 100, 200):
                yield ratio, 40, n, 0.45, mass_change
            for nu in (0.3, 0.4, 0.49):
                yield ratio, 40, 50, nu, mass_change


def case_of(ratio: float, angle: float, n: float, nu: float, mass_change: bool) -> Case:
    """Return one case."""
    return parse_case(
        {
            "shape": {"radius_over_thickness": float(ratio), "opening_angle_deg": float(angle)},
            "material": {"modulus_ratio": float(n), "poisson_ratio": float(nu)},
            "growth": {"mass_change": mass_change},
            "run": {"model": "meridian", "max_wavenumber": 6},
        }
    )


def main() -> None:
    """Follow every path and print a row for each."""
    writer = csv.writer(sys.stdout, lineterminator="\n")
    writer.writerow(
        "R_over_h,alpha_deg,n,nu,mass_change,states,t_n,limit_points,first_m,first_m_t_n,"
        "self_crossing_t_n,seconds,outcome".split(",")
    )
    for parameters in cases():
        path = path_of(case_of(*parameters))
        start = time.process_time()
        points = list(path.follow(1.0))
        seconds = time.process_time() - start
        followed = [p for p in points if p.followed]
        lost = [(p, m) for p in followed for m in range(2, 7) if p.negative[m]]
        shell = path.problem.shell
        crossed = [p.t_n for p in followed if self_crossing(shell, p.state) is not None]
        writer.writerow(
            [
                *parameters,
                len(points),
                f"{points[-1].t_n:.4f}",
                sum(p.path.is_fold for p in points),
                lost[0][1] if lost else "",
                f"{lost[0][0].t_n:.3f}" if lost else "",
                f"{crossed[0]:.3f}" if crossed else "",
                f"{seconds:.1f}",
                path.failure() or "reaches t_n = 1",
            ]
        )
        sys.stdout.flush()


if __name__ == "__main__":
    main()
