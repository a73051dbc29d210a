# %% [markdown]
# # A tissue of one's own: three layers and a law of growth
#
# The optic cup has a bilayer cap, and the paper lets its layers grow linearly in time. Other
# tissues have other layers and other laws. Neither needs a class: a layer is one line, a law a
# function. You will learn how
#
# - a law of growth is written;
# - a third layer is added to a section;
# - a case is run with them, and what its records then say;
# - to check such a change against a theory that fits on half a page.
#
# Run it with `docker/run python3 demos/demo_own_tissue.py [--coarse]`, alone or under `mpirun`.

# %%
import sys
from pathlib import Path

from mpi4py import MPI

import numpy as np

from opticcup_fem import (
    GrowthState,
    Layer,
    Section,
    Shell,
    capture,
    grow,
    parse_case,
    read_path,
    run,
    tissue_of,
)
from opticcup_fem.mesh import disk_mesh
from opticcup_fem.shell.supports import rigid_modes

coarse = "--coarse" in sys.argv
comm = MPI.COMM_WORLD

# %% [markdown]
# ## A law
#
# A law takes the normalised time and the points of the layer, and returns the growth factor e and
# the stress factor rho_r = J rho/rho_0 of (S12): e^2 where the density is preserved, 1 where mass
# does not count. `points.x` are the reference positions, shape (n, 3), for growth that varies
# from place to place. This one slows down, as growth does that depends on a nutrient:


# %%
def slowing(rate: float, pace: float = 3.0):
    """Growth that begins as 1 + rate t_n and ends at 1 + rate/pace."""

    def law(t_n, points):
        e = 1 + rate * (1 - np.exp(-pace * t_n)) / pace
        return GrowthState(e, e**2)

    return law


# %% [markdown]
# ## A check that fits on half a page
#
# A disk of three layers. For small growth it is a laminate: with the strain eps - xi kappa at the
# height xi (b > 0 bends towards n) and the growth g_i = e_i - 1, the stress in layer i is
# proportional to its modulus, mu_i (eps - xi kappa - g_i), as nu is the same everywhere. Force
# and moment vanish:
#
#     sum_i mu_i int_i (eps - xi kappa - g_i) dxi = 0,
#     sum_i mu_i int_i xi (eps - xi kappa - g_i) dxi = 0.

# %%
layers = [
    Layer("below", thickness=0.02, shear_modulus=1.0, poisson_ratio=0.45, points=2),
    Layer("middle", thickness=0.01, shear_modulus=8.0, poisson_ratio=0.45, points=2),
    Layer("above", thickness=0.02, shear_modulus=3.0, poisson_ratio=0.45, points=2),
]
rates = {"below": 4e-5, "middle": 0.0, "above": -2e-5}


# %%
def laminate_curvature(layers, growth) -> float:
    """Return kappa of the two equations above."""
    faces = np.cumsum([0.0, *(layer.thickness for layer in layers)])
    faces -= faces[-1] / 2
    moments = np.array([np.diff(faces**k) / k for k in (1, 2, 3)])  # of xi^0, xi^1, xi^2
    s_0, s_1, s_2 = moments * [layer.shear_modulus for layer in layers]
    matrix = [[s_0.sum(), -s_1.sum()], [s_1.sum(), -s_2.sum()]]
    g = np.array([growth[layer.name] for layer in layers])
    return float(np.linalg.solve(matrix, [s_0 @ g, s_1 @ g])[1])


# %% [markdown]
# The same disk as a shell. Its rim rises over its centre by kappa/2, towards n.

# %%
mesh = disk_mesh(1.0, 0.5 if coarse else 0.25, comm=comm)
shell = Shell(mesh, {"disk": Section(layers)}, {name: slowing(r) for name, r in rates.items()})
*_, last = grow(shell, rigid_modes(shell), t_end=0.5, times=[0.25], tolerance=1e-12)
snapshot = capture(shell, last.state, last.t_n)
grown = {name: slowing(r)(0.5, None).factor - 1 for name, r in rates.items()}
expected = laminate_curvature(layers, grown)
if snapshot is not None:
    radius = np.linalg.norm(snapshot.reference, axis=1)
    height = snapshot.position[:, 2]
    rise = np.mean(height[np.isclose(radius, 1.0)]) - height[np.argmin(radius)]
    kappa = float(2 * rise)
    print(f"curvature {kappa:.6e}, laminate {expected:.6e}: {100 * (kappa / expected - 1):+.3f} %")

# %% [markdown]
# ## The chick cup with a crust
#
# `tissue_of` returns what a case is made of. Replace what is to be different, and `run` does with
# it what `opticcup run` does with the case. The crust, a third layer outside the ECM, grows
# slowly and is soft. The axisymmetric model takes a second or two.

# %%
case = parse_case(
    {
        "run": {"model": "meridian", "t_end": 0.1 if coarse else 1.0, "max_wavenumber": 2},
        "output": {"picture": not coarse},
    }
)
tissue = tissue_of(case)
iov, ecm = tissue.sections["cap"].layers
crust = Layer("crust", thickness=0.02, shear_modulus=5.0, poisson_ratio=0.45, points=2)
crusted = tissue.with_layers("cap", [iov, ecm, crust], crust=slowing(0.5)).with_growth(
    iov=slowing(5.0)
)
folder = Path("results/demo_own_tissue")
outcome = run(case, folder, tissue=crusted)
if comm.rank == 0:
    print(outcome.message)
    print(read_path(folder)[["t_n", "D_over_r", "lambda_iov"]].iloc[-1].to_string())

# %% [markdown]
# The run folder's `case.toml` says that layers and growth were given from Python: it alone does
# not reproduce the run, this file does. `kappa_cap_R` in its records stays that of the case.
