"""A distributed mesh of flat triangles that stands for a smooth surface."""

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import numpy.typing as npt
from dolfinx import fem
from dolfinx.mesh import Mesh, MeshTags

from opticcup_fem.compat import cell_corners
from opticcup_fem.mesh.reference import place_on_surface
from opticcup_fem.mesh.surfaces import Surface
from opticcup_fem.mesh.triangulation import corner_angles

__all__ = ["SurfaceMesh"]


@dataclass(frozen=True)
class SurfaceMesh:
    """Flat triangles with vertices on a smooth surface, tagged by region and curve.

    Attributes:
        mesh: Triangles, first order, gdim 3.
        cell_tags: Region ids of the cells (dim 2).
        facet_tags: Curve ids of the edges on named curves (dim 1).
        regions: Region name to id, for example ``{"cap": 1, "oov": 2}``.
        curves: Curve name to id, for example ``{"interface": 1}``.
        surface: The surface on which the vertices lie.
        circles: Names of the curves that are circles about the z axis.
    """

    mesh: Mesh
    cell_tags: MeshTags
    facet_tags: MeshTags
    regions: dict[str, int]
    curves: dict[str, int]
    surface: Surface
    circles: frozenset[str] = frozenset()

    def corners(self) -> npt.NDArray[np.float64]:
        """Return the corner positions of owned and ghost cells, shape (cells, 3, 3)."""
        corners = self.mesh.geometry.x[cell_corners(self.mesh)]
        return np.asarray(corners, dtype=np.float64)

    def orientation(self) -> npt.NDArray[np.float64]:
        """Return +1 where ``cross(J_0, J_1)`` points along the surface's normal, else -1.

        J_0 and J_1 are the columns of a cell's Jacobian.

        Returns:
            Shape (owned and ghost cells,).
        """
        corners = self.corners()
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        outward = self.surface.normal(corners.mean(axis=1))
        sign: npt.NDArray[np.float64] = np.sign(np.einsum("ci,ci->c", cross, outward))
        return sign

    def reference_position(self, space: fem.FunctionSpace) -> fem.Function:
        """Return r_0 in ``space`` with every node on the surface (collective).

        Nodes of edges on a circle lie exactly on that circle; see `place_on_surface`.

        Args:
            space: Vector-valued Lagrange space of any degree on ``mesh``, three components.

        Raises:
            MeshError: The space is not a vector Lagrange space with three components.
        """
        circle_edges = np.concatenate(
            [np.empty(0, dtype=np.int32)]
            + [self.facet_tags.find(self.curves[name]) for name in sorted(self.circles)]
        )
        return place_on_surface(space, self.surface, circle_edges)

    def report(self) -> str:
        """Return one line with the counts of cells and edges and the range of angles (collective).

        For example ``518 cells (cap 178, oov 340); edges: interface 34; angles 33 to 92 degrees``.
        """
        comm = self.mesh.comm
        owned = [self.mesh.topology.index_map(dim).size_local for dim in range(3)]

        def count(tags: MeshTags, number: int, dim: int) -> int:
            return int(comm.allreduce(np.count_nonzero(tags.find(number) < owned[dim])))

        cells = ", ".join(f"{n} {count(self.cell_tags, i, 2)}" for n, i in self.regions.items())
        edges = ", ".join(f"{n} {count(self.facet_tags, i, 1)}" for n, i in self.curves.items())
        angles = np.degrees(corner_angles(self.mesh.geometry.x, cell_corners(self.mesh)))
        smallest = comm.allreduce(angles.min(initial=180.0), op=MPI.MIN)
        largest = comm.allreduce(angles.max(initial=0.0), op=MPI.MAX)
        return (
            f"{self.mesh.topology.index_map(2).size_global} cells ({cells}); edges: {edges}; "
            f"angles {smallest:.0f} to {largest:.0f} degrees"
        )
