"""Meshes of curved surfaces: builders, tags, orientation and reference positions."""

from opticcup_fem.mesh.builders import cup_mesh, disk_mesh, open_cap_mesh
from opticcup_fem.mesh.msh_file import read_msh, write_msh
from opticcup_fem.mesh.refinement import Refinement
from opticcup_fem.mesh.strip import strip_mesh
from opticcup_fem.mesh.surface_mesh import SurfaceMesh
from opticcup_fem.mesh.surfaces import Plane, Sphere, Surface

__all__ = [
    "Plane",
    "Refinement",
    "Sphere",
    "Surface",
    "SurfaceMesh",
    "cup_mesh",
    "disk_mesh",
    "open_cap_mesh",
    "read_msh",
    "strip_mesh",
    "write_msh",
]
