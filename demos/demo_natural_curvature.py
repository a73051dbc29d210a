# %% [markdown]
# # A bilayer disk bends: its natural curvature
#
# Two layers are glued together and the inner one grows. Alone it would only become larger; glued,
# the two must bend. How much is the natural curvature of the bilayer, which drives everything an
# optic cup does. You will learn how
#
# - layers make a section, and a section a shell;
# - growth is given layer by layer;
# - a shell that floats freely is held without forces;
# - a state is gathered from all ranks and measured.
#
# Run it with `docker/run python3 demos/demo_natural_curvature.py [--coarse]`, alone or under
# `mpirun`.

# %%
import sys

from mpi4py import MPI

import numpy as np
from scipy.optimize import brentq

from opticcup_fem import Layer, LinearGrowth, Section, Shell, capture, grow
from opticcup_fem.mesh import disk_mesh
from opticcup_fem.shell.supports import rigid_modes
from opticcup_fem.theory import natural_curvature

coarse = "--coarse" in sys.argv
comm = MPI.COMM_WORLD

# %% [markdown]
# ## What theory says
#
# A disk of radius 1 and thickness h has an inner layer (xi < 0) that grows in its plane by the
# factor e, and an outer one, a ninth as thick and fifty times as stiff, that does not. If the
# disk were free of stress in the mean, it would have the curvature kappa of (S18), the one that
# minimises the energy (S16) of the two layers. `natural_curvature(e_1, e_2, m, n)` returns kappa
# h, layer 1 being the outer one.
#
# A flat metric and a uniform curvature do not fit together (Gauss), but the misfit costs energy
# only in the order of the bow kappa/h squared. So choose the growth for a small bow:

# %%
h, m, n, bow = 0.05, 1 / 9, 50.0, 0.05
e = brentq(lambda e: float(natural_curvature(1.0, e, m, n)) - bow * h**2, 1.0, 1.1)

# %% [markdown]
# ## The shell
#
# Layers are listed from the inside to the outside. The growth of a layer is a law of normalised
# time; at t_n = 1 the inner layer has grown by e.

# %%
section = Section(
    [
        Layer("inner", thickness=h / (1 + m), shear_modulus=1.0, poisson_ratio=0.45, points=3),
        Layer("outer", thickness=h * m / (1 + m), shear_modulus=n, poisson_ratio=0.45, points=2),
    ]
)
laws = {"inner": LinearGrowth(e - 1), "outer": LinearGrowth(0.0)}
mesh = disk_mesh(1.0, 0.5 if coarse else 0.25, comm=comm)
shell = Shell(mesh, {"disk": section}, laws)

# %% [markdown]
# ## One step of growth
#
# Growth is an internal stress: the disk is in equilibrium with itself, and holding the six rigid
# motions of its unknowns takes no force.

# %%
*_, last = grow(shell, rigid_modes(shell), t_end=1.0, times=[0.5])

# %% [markdown]
# ## The curvature that it has
#
# The mean over the disk of half the trace of a^-1 b. The quadrature weights are those of the
# reference area; every rank sums over its own cells.


# %%
def mean_curvature() -> float:
    """Mean of tr(a^-1 b)/2 over the disk (collective)."""
    forms = shell.forms_at_points(last.state)  # a_11, a_22, a_12, b_11, b_22, b_12
    a_11, a_22, a_12, b_11, b_22, b_12 = np.moveaxis(forms, -1, 0)
    half_trace = (a_22 * b_11 + a_11 * b_22 - 2 * a_12 * b_12) / (2 * (a_11 * a_22 - a_12**2))
    sums = np.array([np.sum(half_trace * shell.weights), np.sum(shell.weights)])
    total, area = comm.allreduce(sums)
    return float(total / area)


# %%
kappa = mean_curvature()
ratio = kappa / (bow * h)

# %% [markdown]
# The rim rises over the centre, towards n, by kappa/2:

# %%
snapshot = capture(shell, last.state, last.t_n)
if snapshot is not None:
    radius = np.linalg.norm(snapshot.reference, axis=1)
    x = snapshot.position - snapshot.position[np.argmin(radius)]
    rim = np.isclose(radius, 1.0)
    rise = float(np.mean(x[rim, 2]))
    print(f"curvature {kappa:.6f}, (S18) {bow * h:.6f}: {100 * (ratio - 1):+.3f} %")
    print(f"the rim rises by {rise:.6f}, kappa/2 is {kappa / 2:.6f}")
