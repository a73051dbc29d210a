# %% [markdown]
# # The chick optic cup, on two models
#
# A sphere of radius 50 um and thickness 10 um: its cap, 40 degrees wide, is a soft layer that
# grows five times faster than the stiff matrix outside it. It invaginates. You will learn how
#
# - what `opticcup run` does is done in Python;
# - the surface and the meridian model are run on one case;
# - paths and events are read back.
#
# Run it with `docker/run python3 demos/demo_chick_cup.py [--coarse]`, alone or under `mpirun`.

# %%
import sys
from pathlib import Path

from mpi4py import MPI

from opticcup_fem import parse_case, read_events, read_path, run

coarse = "--coarse" in sys.argv
comm = MPI.COMM_WORLD

# %% [markdown]
# ## The case
#
# The paper's baseline is the default of every key, so that only what differs is written. Coarse,
# the cup grows to t_n = 0.1 (two hours) on large cells; otherwise to the end, 20 hours, through
# the second invagination, which is a snap.

# %%
tables = {
    "run": {"t_end": 0.1 if coarse else 1.0},
    "output": {"times": [0.1], "states": not coarse},
    "contact": {"mode": "stop"},  # as in the paper: from t_n = 0.74 on layers may overlap
}
if coarse:
    tables["mesh"] = {"cell_size_cap": 0.34, "cell_size_interface": 0.2, "cell_size_oov": 0.45}
folder = Path("results/demo_chick_cup")
surface = run(parse_case(tables), folder / "surface")

# %% [markdown]
# ## The same cup as a curve
#
# The meridian model knows the same layers, growth and closure, and gives the path in seconds. It
# needs no mesh of the surface.

# %%
tables.pop("mesh", None)
tables["run"]["model"] = "meridian"
meridian = run(parse_case(tables), folder / "meridian")

# %% [markdown]
# ## Against the reference
#
# An independent axisymmetric solver has D/r = 0.3763 and lambda_IOV = 1.2838 at t_n = 0.1, and
# the first invagination, the steepest descent of the apex, at t_n = 0.064.

# %%
REFERENCE = {"D_over_r": 0.3763, "lambda_iov": 1.2838}
if comm.rank == 0:
    print(surface.message, meridian.message, sep="\n")
    found = {}
    for model in ("surface", "meridian"):
        rows = read_path(folder / model)
        row = rows[rows["t_n"] == 0.1].iloc[0]
        found[model] = {name: float(row[name]) for name in REFERENCE}
        for name, value in REFERENCE.items():
            print(f"{model} {name}: {found[model][name]:.4f}, reference {value:.4f}")
    first = [e for e in read_events(folder / "meridian") if e["kind"] == "primary_invagination"]
    t_1 = first[0]["t_n"]
    print(f"first invagination at t_n = {t_1:.4f}, reference 0.0640")
