# %% [markdown]
# # A geometry of one's own: an oval cap
#
# The eye field of an embryo is not round. The surface model takes any triangulation whose
# vertices lie on a sphere or a plane, with named regions. Here Gmsh cuts an oval cap out of a
# sphere. You will learn how
#
# - a mesh with named regions and curves is made with Gmsh, and read;
# - a shell is made of it, without a case;
# - a new geometry is checked against a known one;
# - states are written for ParaView.
#
# Run it with `docker/run python3 demos/demo_own_geometry.py [--coarse]`, alone or under `mpirun`.

# %%
import sys
from pathlib import Path

from mpi4py import MPI

import gmsh
import numpy as np

from opticcup_fem import (
    Shell,
    capture,
    grow,
    parse_case,
    read_path,
    run,
    tissue_of,
    write_fields,
)
from opticcup_fem.mesh import Sphere, read_msh
from opticcup_fem.shell.supports import rigid_modes

coarse = "--coarse" in sys.argv
comm = MPI.COMM_WORLD
folder = Path("results/demo_own_geometry")
t_end = 0.1

# %% [markdown]
# ## The mesh
#
# An elliptic cylinder along z cuts the unit sphere into the cap and the rest, the OOV. Gmsh finds
# the pieces (`fragment`); two of the surfaces lie on the sphere, and the one with the larger z is
# the cap. Physical groups carry the names. On the curve of the cut, vertices are off the sphere
# by the tolerance of the CAD kernel, and are moved onto it: the shell's midsurface is the sphere
# and no approximation.


# %%
def oval_mesh(path: Path, long_axis: float, short_axis: float) -> None:
    """Write the unit sphere with an oval cap as a Gmsh file; on one process."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    cad, mesh = gmsh.model.occ, gmsh.model.mesh
    sphere = cad.addSphere(0, 0, 0, 1)
    ellipse = cad.addEllipse(0, 0, 0, long_axis, short_axis)  # the long axis along x
    disk = cad.addPlaneSurface([cad.addCurveLoop([ellipse])])
    cylinder = [entity for entity in cad.extrude([(2, disk)], 0, 0, 2) if entity[0] == 3]
    cad.fragment([(3, sphere)], cylinder)
    cad.synchronize()
    surfaces = [tag for _, tag in gmsh.model.getEntities(2)]
    on_sphere = [tag for tag in surfaces if gmsh.model.getType(2, tag) == "Sphere"]
    oov, cap = sorted(on_sphere, key=lambda tag: cad.getCenterOfMass(2, tag)[2])
    outline = gmsh.model.getBoundary([(2, cap)], oriented=False)
    gmsh.model.addPhysicalGroup(2, [cap], 1, "cap")
    gmsh.model.addPhysicalGroup(2, [oov], 2, "oov")
    gmsh.model.addPhysicalGroup(1, [tag for _, tag in outline], 1, "interface")
    # small cells on the outline, where the shell bends most
    size = 0.36 if coarse else 0.2
    for _, tag in outline:
        mesh.setTransfiniteCurve(tag, 1 + round(2 * cad.getMass(1, tag) / size))
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 0)
    mesh.generate(2)
    tags, positions, _ = mesh.getNodes()
    for tag, x in zip(tags, positions.reshape(-1, 3), strict=True):
        if abs(np.linalg.norm(x) - 1) < 1e-3:
            mesh.setNode(tag, x / np.linalg.norm(x), [])
    gmsh.write(str(path))
    gmsh.finalize()


# %% [markdown]
# ## The shell
#
# Layers and growth are the chick's. `grow` yields the stable equilibria on the way; a free shell
# is held by six components, far apart and without force. The state at the end is gathered on the
# first rank.

# %%
tissue = tissue_of(parse_case({}))


# %%
def grown(name: str, long_axis: float, short_axis: float):
    """Return the snapshot at the end on the first rank, None on the others (collective)."""
    path = folder / f"{name}.msh"
    if comm.rank == 0:
        folder.mkdir(parents=True, exist_ok=True)
        oval_mesh(path, long_axis, short_axis)
    comm.barrier()
    surface_mesh = read_msh(path, Sphere(), circles=())
    report = surface_mesh.report()
    shell = Shell(surface_mesh, tissue.sections, tissue.laws)
    *_, last = grow(shell, rigid_modes(shell), t_end)
    snapshot = capture(shell, last.state, last.t_n)
    if snapshot is not None:
        print(f"{name}: {report}")
        write_fields(folder / f"{name}.vtu", snapshot)
    return snapshot


# %%
def height(snapshot) -> float:
    """Distance of the apex from the bottom pole, over R."""
    ends = [np.argmin(np.linalg.norm(snapshot.reference - [0, 0, z], axis=1)) for z in (1, -1)]
    return float(np.linalg.norm(np.subtract(*snapshot.position[ends])))


# %% [markdown]
# ## Round first
#
# A new geometry is worth something once it gives what is known. With equal semi-axes, sin 40
# degrees, the cap is the chick's, and the axisymmetric model knows its height.

# %%
round_cup = grown("round", np.sin(np.radians(40)), np.sin(np.radians(40)))
reference = run(
    parse_case(
        {
            "run": {"model": "meridian", "t_end": t_end, "max_wavenumber": 2},
            "output": {"times": [t_end], "picture": False, "fields": False, "states": False},
        }
    ),
    folder / "meridian",
)
if round_cup is not None:
    expected = float(read_path(folder / "meridian")["apex_height_over_R"].iloc[-1])
    round_height = height(round_cup)
    print(f"height of the round cup {round_height:.4f}, of the axisymmetric one {expected:.4f}")

# %% [markdown]
# ## Then oval
#
# The same area of the outline in projection, a third longer than wide.

# %%
oval_cup = grown("oval", 0.742, 0.557)
if oval_cup is not None:
    x, y, z = oval_cup.reference.T
    on_outline = np.isclose((x / 0.742) ** 2 + (y / 0.557) ** 2, 1, atol=0.02) & (z > 0)
    widths = [np.ptp(x[on_outline], axis=0) for x in (oval_cup.reference, oval_cup.position)]
    before, after = (float(width[0] / width[1]) for width in widths)
    print(f"height of the oval cup {height(oval_cup):.4f}")
    print(f"length over width of its outline: {before:.3f} before, {after:.3f} after growth")

# %% [markdown]
# `results/demo_own_geometry/*.vtu` opens in ParaView: colour by `lambda_3_iov`, warp by
# `boundary_0`.
