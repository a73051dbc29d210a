"""Reference positions of higher-order nodes on the smooth surface."""

import numpy as np
import numpy.typing as npt
from dolfinx import fem

from opticcup_fem.compat import cell_corners, interpolation_points
from opticcup_fem.errors import MeshError
from opticcup_fem.mesh.surfaces import Surface, axis_arc

__all__ = ["place_on_surface"]

Array = npt.NDArray[np.float64]

# the two vertices of the reference triangle's edges, as basix numbers them
_EDGE_VERTICES = ((1, 2), (0, 2), (0, 1))


def place_on_surface(
    space: fem.FunctionSpace, surface: Surface, circle_edges: npt.NDArray[np.int32]
) -> fem.Function:
    """Return the field of reference positions r_0, nodes on the surface (collective).

    A node at the fraction t of an edge goes to the fraction t of the arc between its ends: the arc
    of the circle for edges on a circle about the z axis, else the surface's shortest arc.  With
    s(t) the shift from chord to arc, a node with barycentric coordinates l_1, l_2 at the edge's
    ends moves by ``l_1 l_2/(t (1 - t)) s(t)``, t = (1 + l_2 - l_1)/2, summed over the cell's edges:
    a smooth map of the cell, for a cubic's interior node half the mean shift of the edge's nodes
    (for shallow arcs).  All nodes are then projected to the surface.

    Radial projection of the flat cell alone would make cubic cells with eight times the error of
    curvature, see docs/decisions/0004-flat-cells-exact-nodes.md.

    Args:
        space: Vector Lagrange space, three components, on a mesh of flat triangles.
        surface: The surface to project to.
        circle_edges: Local numbers of the edges that lie on circles about the z axis.

    Raises:
        MeshError: The space is not a vector Lagrange space with three components.
    """
    if space.dofmap.index_map_bs != 3 or not space.element.interpolation_ident:
        raise MeshError(
            "a reference position needs a vector Lagrange space with three components, not "
            f"{space.ufl_element()}"
        )
    mesh = space.mesh
    mesh.topology.create_connectivity(2, 1)
    edges = mesh.topology.connectivity(2, 1).array.reshape(-1, 3)
    corners = np.asarray(mesh.geometry.x[cell_corners(mesh)], dtype=np.float64)
    nodes = _curved_nodes(
        corners, np.isin(edges, circle_edges), surface, interpolation_points(space)
    )
    x = space.tabulate_dof_coordinates().copy()
    x[space.dofmap.list] = nodes
    position = fem.Function(space, name="reference_position")
    position.x.array[:] = surface.project(x).ravel()
    # a rank's own value of a shared node may differ in the last digit: the owner's counts
    position.x.scatter_forward()
    return position


def _curved_nodes(
    corners: Array, on_circle: npt.NDArray[np.bool_], surface: Surface, points: Array
) -> Array:
    """Return the nodes' positions before projection, shape (cells, nodes, 3).

    Args:
        corners: Corners of the cells, shape (cells, 3, 3).
        on_circle: Which edges of the cells lie on a circle, shape (cells, 3).
        surface: Gives the arcs of the other edges.
        points: Reference coordinates of a cell's nodes, shape (nodes, 2).
    """
    bary = np.column_stack([1.0 - points.sum(axis=1), points])
    x: Array = np.einsum("nv,cvi->cni", bary, corners)
    for edge, (first, last) in enumerate(_EDGE_VERTICES):
        t = 0.5 * (1.0 + bary[:, last] - bary[:, first])
        product, bubble = bary[:, first] * bary[:, last], t * (1.0 - t)
        weight = np.divide(product, bubble, out=np.zeros_like(t), where=product > 1e-14)
        p, q = corners[:, None, first], corners[:, None, last]
        chord = p + t[:, None] * (q - p)
        circle = on_circle[:, edge, None, None]
        arc = np.where(circle, axis_arc(p, q, t), surface.arc(p, q, t))
        x += weight[:, None] * (arc - chord)
    return x
