# %% [markdown]
# # From single cups to a scaling law
#
# When does a cup invaginate? The paper's answer is (3): the natural curvature at which it does
# grows linearly with theta_bar = alpha sqrt(R/h). Here the law is measured from a few cups of
# different slenderness. You will learn how
#
# - cases are varied in Python;
# - critical curvatures are read from a run's events;
# - a law is fitted and compared with the paper's.
#
# Run it with `docker/run python3 demos/demo_scaling_law.py [--coarse]`, alone or under `mpirun`.

# %%
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

from opticcup_fem import parse_case, read_events, run
from opticcup_fem.theory import PAPER_COEFFICIENTS, spring_ratio

coarse = "--coarse" in sys.argv
comm = MPI.COMM_WORLD

# %% [markdown]
# ## The law
#
# The cap is a shallow shell whose rim the OOV holds like a spring of the relative stiffness
# Gamma, (2). It snaps through when its natural curvature reaches, (3),
#
#     kappa_1 R = a_1 (1 + Gamma) theta_bar + b_1,   a_1 = 1.55, b_1 = -0.95.
#
# ## The cups
#
# Thick cups pass smoothly from one side to the other; from about theta_bar = 1.7 there is a fold,
# the limit point in t_n that the law is about. Each of these takes some seconds on the meridian
# model. It is the job of one process, also under `mpirun`; for many cups there is `opticcup
# sweep`.

# %%
ratios = (8.0, 13.0, 20.0) if coarse else (8.0, 9.0, 10.0, 11.0, 12.0, 14.0, 16.0, 18.0, 20.0)
theta_bar, kappa = [], []
for ratio in ratios:
    case = parse_case(
        {
            "shape": {"radius_over_thickness": ratio},
            "run": {"model": "meridian", "t_end": 0.06, "max_wavenumber": 2},
            "output": {"times": [0.06], "fields": False, "states": False, "picture": False},
        }
    )
    folder = Path("results/demo_scaling_law") / f"{ratio:g}"
    run(case, folder)
    if comm.rank == 0:
        first = next(e for e in read_events(folder) if e["kind"] == "primary_invagination")
        assert first["type"] == "fold"
        theta_bar.append(case.shape.theta_bar)
        kappa.append(first["kappa_cap_R"])
        print(f"R/h = {ratio:4g}: t_1 = {first['t_n']:.5f}, kappa_1 R = {kappa[-1]:.4f}")

# %% [markdown]
# ## The fit
#
# A straight line through the folds. An independent solver has a_1 = 1.619 and b_1 = -1.171 over
# R/h = 8 to 20, and the paper 1.55 and -0.95.

# %%
if comm.rank == 0:
    gamma = float(spring_ratio(case.material.thickness_ratio, case.material.modulus_ratio, 0.45))
    slope, b_1 = np.polyfit(theta_bar, kappa, 1)
    a_1 = float(slope / (1 + gamma))
    paper = PAPER_COEFFICIENTS
    print(f"a_1 = {a_1:.3f}, b_1 = {b_1:.3f}; paper {paper.a_1:g}, {paper.b_1:g}")
