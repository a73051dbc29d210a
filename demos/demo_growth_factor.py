# %% [markdown]
# # A growth factor that spreads
#
# Tissue does not grow by decree. Here a factor is released at the centre of the cap; it spreads
# along the tissue, and swells it where it is. Growth is then solved for, by the balance of mass
# (S9), together with the shape. You will learn how
#
# - a source, a diffusivity and a flux through an edge are written in a case;
# - to check a balance against a solution in closed form;
# - to read what the layers' density does in a run's records;
# - how far a factor has to spread for a cup to invaginate.
#
# Run it with `docker/run python3 demos/demo_growth_factor.py [--coarse]`, alone or under `mpirun`.

# %%
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

from opticcup_fem import parse_case, read_path, run

coarse = "--coarse" in sys.argv
comm = MPI.COMM_WORLD
results = Path("results/demo_growth_factor")
meridian = {"model": "meridian", "max_wavenumber": 2}
quiet = {"picture": False, "fields": False, "states": False}

# %% [markdown]
# ## A balance that can be solved by hand
#
# A cap of opening angle alpha that does not grow: its factor takes no room (a specific volume of
# next to nothing). It is made everywhere at the rate S and leaves through the edge at the rate
# q = S tan(alpha/2), which is as much. What is left in the end solves
#
#     D Lap rho + S = 0 on the sphere,    -D rho'(alpha) = q,
#
# and that is rho = c + (2 S/D) ln cos(theta/2). Between the centre and the edge it falls by
# -(2 S/D) ln cos(alpha/2), whatever c. (The records' extremes are those at the quadrature points,
# just inside of both ends.)

# %%
S, D, alpha = 0.5, 1.0, np.radians(40)
steady = parse_case(
    {
        "shape": {"kind": "cap", "opening_angle_deg": 40},
        "growth": {"iov": 0.0, "ecm": 0.0, "oov": 0.0},
        "mass": {
            "iov": {
                "kind": "other",
                "specific_volume": 1e-6,
                "source": f"{S}",
                "diffusivity": D,
                "edge_flux": S * np.tan(alpha / 2),
            }
        },
        "run": meridian | {"t_end": 1.0},
        "output": quiet,
    }
)
outcome = run(steady, results / "steady")
if comm.rank == 0:
    last = read_path(results / "steady").iloc[-1]
    fall = last["rho_iov_max"] - last["rho_iov_min"]
    expected = -2 * S / D * np.log(np.cos(alpha / 2))
    print(f"from centre to edge {fall:.5f}, by hand {expected:.5f}")

# %% [markdown]
# The layer's mass stays what it was, and the balance of every step is closed to rounding:

# %%
if comm.rank == 0:
    path = read_path(results / "steady")
    print(f"mass {path['mass_iov'].iloc[0]:.6f} -> {path['mass_iov'].iloc[-1]:.6f}")
    print(f"largest error of a step {path['mass_error_iov'].max():.0e}")

# %% [markdown]
# ## How far must it spread?
#
# The chick cup of `demos/growth_factor.toml`: the same amount of factor is released in a spot at
# the apex and takes half of the tissue's volume per mass. It swells the IOV there, while the OOV
# grows as always. With a small diffusivity it stays where it was made; with a large one it is
# everywhere in the cap at once, as growth is in the paper.

# %%
found = {}
for diffusivity in (0.03, 0.3, 3.0):
    case = parse_case(
        {
            "mass": {
                "iov": {
                    "kind": "other",
                    "specific_volume": 0.5,
                    "source": "60*exp(-20*theta**2)",
                    "diffusivity": diffusivity,
                }
            },
            "run": meridian | {"t_end": 0.1 if coarse else 0.3},
            "output": quiet,
        }
    )
    folder = results / f"D_{diffusivity:g}"
    outcome = run(case, folder)
    if comm.rank == 0:
        found[diffusivity] = read_path(folder)
        row = found[diffusivity].iloc[-1]
        spread = f"e from {row['e_iov_min']:.2f} to {row['e_iov_max']:.2f}"
        print(f"D = {diffusivity:<5g} t_n = {row['t_n']:.2f}: {spread}, D/r {row['D_over_r']:.3f}")

# %% [markdown]
# Plot the depth of the cups. `opticcup movie RUN --density` shows where the factor is, for runs of
# the surface model that keep their states.

# %%
if comm.rank == 0 and not coarse:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for diffusivity, path in found.items():
        axes.plot(path["t_n"], path["D_over_r"], label=f"D = {diffusivity:g}")
    axes.set_xlabel("normalised time $t_n$")
    axes.set_ylabel("depth over radius, $D/r$")
    axes.legend(frameon=False)
    figure.savefig(results / "depth.png", dpi=150)
    print(results / "depth.png")
