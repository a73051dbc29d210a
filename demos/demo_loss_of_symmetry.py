# %% [markdown]
# # A slender cup loses its symmetry
#
# Past a slenderness the cup does not deepen: it buckles into a slit, and the eye is abnormal. The
# bifurcation is invisible on the axisymmetric path itself; one has to ask for the eigenvalues of
# each azimuthal wavenumber. You will learn how
#
# - the stability of an axisymmetric path is counted, wavenumber by wavenumber;
# - the loss of symmetry is localised and its mode classified;
# - the surface model is led to the same loss, and along the branch behind it.
#
# Run it with `docker/run python3 demos/demo_loss_of_symmetry.py [--coarse]`, alone or under
# `mpirun`. Without `--coarse` the branch on the surface takes some minutes.

# %%
import sys
from pathlib import Path

from mpi4py import MPI

from opticcup_fem import parse_case, read_events, read_path, run

coarse = "--coarse" in sys.argv
comm = MPI.COMM_WORLD
folder = Path("results/demo_loss_of_symmetry")

# %% [markdown]
# ## Wavenumber by wavenumber
#
# In the wave exp(i m phi) a cup's second variation is a small symmetric matrix K_m on the
# meridian. A negative eigenvalue of it is an unstable mode with m lobes, and counts twice on the
# surface, as cos and sin. (Where a pair crosses zero together, det K does not change its sign:
# count, never look at determinants.)

# %%
shape = {"radius_over_thickness": 15.0}
case = parse_case(
    {
        "shape": shape,
        "run": {"model": "meridian", "t_end": 0.3, "max_wavenumber": 3},
        "output": {"times": [0.3], "picture": not coarse, "states": not coarse},
    }
)
outcome = run(case, folder / "meridian")
if comm.rank == 0:
    print(outcome.message)
    rows = read_path(folder / "meridian")
    unstable = rows[["t_n", "negative_m0", "negative_m1", "negative_m2", "negative_m3"]]
    print(unstable[rows["t_n"] > 0.27].to_string(index=False))

# %% [markdown]
# ## Where, and with how many lobes
#
# Events of the part of the path that a growing cup never sees, behind its folds, are not
# `followed`. An independent axisymmetric solver has the first loss of stability at t_n = 0.2829
# with m = 2.

# %%
if comm.rank == 0:
    events = [e for e in read_events(folder / "meridian") if e.get("followed", True)]
    losses = [e for e in events if e["kind"] == "symmetry_breaking"]
    t_b, m_b = losses[0]["t_n"], losses[0]["wavenumber"]
    print(f"m = {m_b} at t_n = {t_b:.4f}; reference m = 2 at 0.2829")

# %% [markdown]
# ## The branch behind it
#
# On the surface, `run.follow = "branch"` keeps to the axisymmetric states up to the first loss
# and then follows what leaves them, by arc length, stable or not. The bifurcation is subcritical:
# the branch runs back in t_n.

# %%
if not coarse:
    tables = {
        "shape": shape,
        "run": {"follow": "branch", "t_end": 0.3},
        "output": {"times": [0.3]},
    }
    branch = run(parse_case(tables), folder / "branch")
    if comm.rank == 0:
        print(branch.message)
        path = read_path(folder / "branch")
        print(path[["t_n", "asymmetry", "stable"]].tail(8).to_string(index=False))
