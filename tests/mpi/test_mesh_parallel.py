"""A distributed mesh is the serial mesh, in pieces: run with ``mpirun -n 2`` and ``-n 3``."""

import math
from pathlib import Path

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import numpy.typing as npt
import pytest
import ufl
from dolfinx import fem

from opticcup_fem.errors import MeshError
from opticcup_fem.mesh import Sphere, SurfaceMesh, cup_mesh, read_msh, write_msh
from opticcup_fem.mesh.distribute import distribute
from opticcup_fem.mesh.msh_file import gather
from opticcup_fem.mesh.triangulation import Triangulation

pytestmark = pytest.mark.mpi

WORLD = MPI.COMM_WORLD
ALPHA = math.radians(40.0)


def cup(comm: MPI.Comm) -> SurfaceMesh:
    return cup_mesh(ALPHA, 0.33, 0.18, 0.5, comm=comm)


def cubic(mesh: SurfaceMesh) -> fem.FunctionSpace:
    element = basix.ufl.element(
        "Lagrange",
        "triangle",
        3,
        lagrange_variant=basix.LagrangeVariant.equispaced,
        shape=(3,),
    )
    return fem.functionspace(mesh.mesh, element)


def owned_nodes(mesh: SurfaceMesh) -> npt.NDArray[np.float64]:
    """All nodes of the cubic reference position on every rank, sorted by place on the flat mesh."""
    space = cubic(mesh)
    count = space.dofmap.index_map.size_local
    flat = space.tabulate_dof_coordinates()[:count]
    curved = mesh.reference_position(space).x.array.reshape(-1, 3)[:count]
    parts = mesh.mesh.comm.allgather(np.hstack([flat, curved]))
    rows = np.concatenate(parts)
    return rows[np.lexsort(np.round(rows[:, :3], 9).T)]


def test_gathered_mesh_equals_the_serial_one() -> None:
    mesh = cup(WORLD)
    assert WORLD.allreduce(mesh.mesh.topology.index_map(2).size_local, op=MPI.MIN) > 0
    whole, expected = gather(mesh), gather(cup(MPI.COMM_SELF))
    assert expected is not None
    assert (whole is not None) == (WORLD.rank == 0)
    if whole is not None:
        for name in ("points", "cells", "cell_region", "edges", "edge_curve"):
            np.testing.assert_array_equal(getattr(whole, name), getattr(expected, name))
    assert mesh.report() == cup(MPI.COMM_SELF).report()
    assert (mesh.regions, mesh.curves) == ({"cap": 1, "oov": 2}, {"interface": 1})


def test_reference_position_equals_the_serial_one() -> None:
    rows = owned_nodes(cup(WORLD))
    np.testing.assert_allclose(rows, owned_nodes(cup(MPI.COMM_SELF)), rtol=0, atol=4e-15)


def test_every_rank_has_all_of_its_own_data() -> None:
    mesh = cup(WORLD)
    cells = mesh.mesh.topology.index_map(2)
    assert cells.num_ghosts == 0
    np.testing.assert_array_equal(mesh.orientation(), np.ones(cells.size_local))
    np.testing.assert_array_equal(mesh.cell_tags.indices, np.arange(cells.size_local))
    position = mesh.reference_position(cubic(mesh))
    before = position.x.array.copy()
    position.x.scatter_forward()
    np.testing.assert_array_equal(position.x.array, before)
    np.testing.assert_allclose(np.linalg.norm(before.reshape(-1, 3), axis=1), 1.0, rtol=4e-15)


def test_every_rank_knows_its_interface_edges() -> None:
    """Each cell next to the interface finds the edge tagged on its own rank, also at a cut."""
    mesh = cup(WORLD)
    topology = mesh.mesh.topology
    topology.create_connectivity(2, 1)
    edges = topology.connectivity(2, 1).array.reshape(-1, 3)
    height = mesh.corners()[..., 2]
    on_circle = np.isclose(height, math.cos(ALPHA), rtol=0, atol=1e-12)
    tagged = np.isin(edges, mesh.facet_tags.find(mesh.curves["interface"]))
    # edge e is opposite to vertex e
    expected = np.stack([on_circle[:, [1, 2]], on_circle[:, [0, 2]], on_circle[:, [0, 1]]], 1)
    np.testing.assert_array_equal(tagged, expected.all(axis=2))


def test_integrals_over_regions_do_not_depend_on_the_ranks() -> None:
    def areas(comm: MPI.Comm) -> list[float]:
        mesh = cup(comm)
        dx = ufl.Measure("dx", domain=mesh.mesh, subdomain_data=mesh.cell_tags)
        one = fem.Constant(mesh.mesh, 1.0)
        forms = [fem.form(one * dx(number)) for number in mesh.regions.values()]
        return [comm.allreduce(fem.assemble_scalar(form)) for form in forms]

    np.testing.assert_allclose(areas(WORLD), areas(MPI.COMM_SELF), rtol=1e-13)


def test_file_does_not_depend_on_the_ranks(tmp_path: Path) -> None:
    folder = WORLD.bcast(tmp_path, root=0)
    write_msh(cup(WORLD), folder / "parallel.msh")
    if WORLD.rank == 0:
        write_msh(cup(MPI.COMM_SELF), folder / "serial.msh")
        assert (folder / "parallel.msh").read_bytes() == (folder / "serial.msh").read_bytes()
    WORLD.barrier()
    copy = read_msh(folder / "parallel.msh", Sphere(1.0))
    assert copy.circles == {"interface"}
    assert copy.report() == cup(WORLD).report()


def test_errors_reach_every_rank() -> None:
    def fail() -> Triangulation:
        raise MeshError("only rank 0 knows why")

    with pytest.raises(MeshError, match="only rank 0 knows why"):
        distribute(fail, Sphere(1.0), WORLD)
    with pytest.raises(MeshError, match="there is no mesh file"):
        read_msh(Path("/nowhere/cup.msh"), Sphere(1.0))
    with pytest.raises(MeshError, match="cannot write the mesh"):
        write_msh(cup(WORLD), Path("/nowhere/cup.msh"))
