r"""Deformations that keep mirror planes: all images of an unknown are one unknown.

Under a reflection S that maps the reference surface onto itself such a deformation obeys

    r(S X) = S r(X),      d(S X) = S d(X),

X a place on the surface and d a director.  With S (t x d) = det(S) (S t) x (S d), the second is

    alpha(S X) = det(S) s alpha(X),

s = +1 where the edge at S X runs along the image of the edge at X, -1 where it runs against it.
So every unknown is a sign times that of the image of its place in x_i >= 0, and what would leave a
plane vanishes: on x_i = 0 the component r_i, and the angles of the edges that lie in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from opticcup_fem.errors import MeshError
from opticcup_fem.shell.model import Shell
from opticcup_fem.shell.spaces import GlobalNumbering

Array = NDArray[np.float64]

NEAR = 1e-8
"""Distance within which two places are one, unit of length of the mesh."""


def fold(shell: Shell, numbering: GlobalNumbering, planes: Sequence[int]) -> GlobalNumbering:
    """Return the numbering in which all images are one unknown (collective).

    Args:
        shell: A shell whose mesh has the planes x_i = 0 for mirrors.
        numbering: Numbers of all its unknowns.
        planes: The components i.

    Raises:
        MeshError: A plane is no mirror of the mesh.
    """
    spaces, numbers = shell.spaces, numbering.local_to_global
    split = 3 * spaces.n_nodes
    n_nodes = spaces.position.dofmap.index_map.size_local
    nodes = _Images(shell.comm, shell.reference, n_nodes, planes)
    places, tangents = (
        field.reshape(-1, 3)
        for field in (
            shell.directors.places(shell.reference),
            shell.directors.tangents(shell.reference),
        )
    )
    n_points = spaces.mesh.topology.index_map(1).size_local * spaces.degree
    points = _Images(shell.comm, places, n_points, planes)
    along = np.sum(points.flips * tangents * points.of(tangents), axis=1)
    turned = np.sign(np.round(along)) * np.prod(points.flips, axis=1)
    return _renumbered(
        shell.comm,
        numbering,
        np.concatenate(
            [nodes.of(numbers[:split].reshape(-1, 3)).ravel(), points.of(numbers[split:])]
        ),
        np.concatenate([nodes.flips.ravel(), turned]),
    )


class _Images:
    """Images in x_i >= 0 of places that the ranks own in parts.

    Attributes:
        flips: Diagonals of the reflections, shape (n, 3); 0 where a place lies on the plane.
    """

    def __init__(
        self, comm: MPI.Intracomm, places: Array, owned: int, planes: Sequence[int]
    ) -> None:
        self._comm, self._owned = comm, owned
        self.flips = np.ones_like(places)
        for i in planes:
            on_plane = np.abs(places[:, i]) < NEAR
            self.flips[:, i] = np.where(on_plane, 0.0, np.sign(places[:, i]))
        distance, self._at = cKDTree(self._everywhere(places)).query(self.flips * places)
        farthest = comm.allreduce(float(np.max(distance, initial=0.0)), MPI.MAX)
        if farthest > NEAR:
            names = " and ".join("xyz"[i] + " = 0" for i in planes)
            raise MeshError(
                f"the mesh is not its own mirror image in {names}: where a node should lie, the "
                f"nearest one is {farthest:.2g} away; take mesh.symmetry = 4 and no imperfection."
            )

    def _everywhere(self, values: NDArray[Any]) -> NDArray[Any]:
        return np.concatenate(self._comm.allgather(values[: self._owned]))

    def of(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return, for all places, what their images have (collective)."""
        found: NDArray[Any] = self._everywhere(values)[self._at]
        return found


def _renumbered(
    comm: MPI.Intracomm, numbering: GlobalNumbering, image: NDArray[Any], sign: Array
) -> GlobalNumbering:
    """Number the unknowns that are their own images, in the order that they have (collective).

    Args:
        comm: Communicator.
        numbering: Numbers of all unknowns.
        image: Number of the image of every local unknown.
        sign: Its factor on the image.
    """
    owned = numbering.owned_local
    own_image = image[owned] == numbering.local_to_global[owned]
    kept = image[owned][own_image]
    every = np.concatenate(comm.allgather(kept))
    return GlobalNumbering(
        np.searchsorted(every, image).astype(np.int32), len(kept), owned[own_image], sign
    )
