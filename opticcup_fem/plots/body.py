"""A cup as a body: its layers, true to their thickness, on one grid of material meridians.

All states of a run are put on the same grid, so that a body's triangles are made once and only its
points move, and the cut that opens it runs along material lines.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from opticcup_fem.observables import Observer
from opticcup_fem.sampling import directions, interface_colatitude
from opticcup_fem.snapshot import Floats, Integers, Snapshot, lagrange_basis

Triangles = NDArray[np.int32]

QUANTITIES = ("lambda3", "stress", "contact", "density")
"""What layers can be coloured by."""


@dataclass(frozen=True)
class Shape:
    """One state on the grid, in the cup's own axes.

    Attributes:
        faces: For each region the layers' faces, shape (n_phi, n_theta, n_layers + 1, 3).
        values: For each layer the coloured quantity, shape (n_phi, n_theta); empty without one.
    """

    faces: Mapping[str, Floats]
    values: Mapping[str, Floats]


def in_plane_stress(stress: Floats) -> Floats:
    """Return the mean in-plane Cauchy stress, half the trace, of components (..., 3)."""
    half: Floats = stress[..., :2].mean(axis=-1)
    return half


def _coloured(snapshot: Snapshot, quantity: str, layer: str) -> Floats:
    """Return a quantity in a layer at the nodes of the cells, shape (m, 10).

    That of contact is the size of its force per reference area, nought where none is known; the
    density is NaN in layers without a mass balance.
    """
    if quantity == "lambda3":
        return snapshot.thickness_stretch[layer]
    if quantity == "stress":
        return in_plane_stress(snapshot.stress[layer])
    if quantity == "density":
        unknown = np.full(snapshot.cells.shape, np.nan)
        return snapshot.growth.get(f"rho_{layer}", unknown)
    if snapshot.contact_traction is None:
        return np.zeros(snapshot.cells.shape)
    size: Floats = np.linalg.norm(snapshot.contact_traction, axis=1)[snapshot.cells]
    return size


class BodyGrid:
    """Puts the states of one mesh on a grid of material meridians.

    Attributes:
        phi: Azimuths of the meridians (rad); a whole turn or, cut open, three quarters of one.
        closed: Whether the last meridian is followed by the first.
        layers: Region and number in the region of each layer.
        thinnest: The layer that is thinnest in the state it was made from.
    """

    def __init__(
        self,
        snapshot: Snapshot,
        *,
        opening: float | None = None,
        n_phi: int = 72,
        n_cap: int = 18,
        n_oov: int = 30,
        quantity: str | None = None,
    ) -> None:
        """Find the grid's points on the mesh.

        Args:
            snapshot: Any state on the mesh (regions "cap" and "oov", a closed sphere).
            opening: Azimuth (rad) of the middle of the quarter that is left out; None keeps all.
            n_phi: Meridians of a whole turn.
            n_cap: Points of each meridian in the cap.
            n_oov: Points of each meridian in the OOV.
            quantity: A key of `QUANTITIES` to colour by.
        """
        self.closed, self.quantity = opening is None, quantity
        if opening is None:
            self.phi = np.linspace(0.0, 2 * np.pi, n_phi, endpoint=False)
        else:
            self.phi = opening + np.pi / 4 + np.linspace(0.0, 1.5 * np.pi, 3 * n_phi // 4 + 1)
        self._observer = Observer(snapshot)
        alpha = interface_colatitude(snapshot)
        # the shape bends most sharply at the interface: points crowd there
        theta = {
            "cap": alpha * np.sin(np.linspace(0, np.pi / 2, n_cap)),
            "oov": np.pi - (np.pi - alpha) * np.sin(np.linspace(0, np.pi / 2, n_oov))[::-1],
        }
        self.layers = {
            layer: (region, k)
            for region in theta
            for k, layer in enumerate(snapshot.layers[region])
        }
        self._shape = {region: (len(self.phi), len(values)) for region, values in theta.items()}
        self.thinnest = _thinnest(snapshot)
        self._maps = {
            region: self._nodes_to_grid(snapshot, region, values)
            for region, values in theta.items()
        }

    def _nodes_to_grid(self, snapshot: Snapshot, region: str, theta: Floats) -> sparse.csr_array:
        """Return the map from values at the nodes of a region's cells to the grid's points.

        At a node the cells' values, which differ by a hair as their normals do, are averaged.
        """
        points = directions(theta, self.phi[:, None]).reshape(-1, 3)
        found = self._observer.sampler.locate(points, region)
        cells = snapshot.cells_of(region)
        row = np.searchsorted(cells, found.cell)
        nodes, number = np.unique(snapshot.cells[cells], return_inverse=True)
        number = number.reshape(len(cells), -1)
        mean = sparse.csr_array(
            (np.ones(number.size), (number.ravel(), np.arange(number.size))),
            shape=(len(nodes), number.size),
        )
        mean = sparse.diags_array(1 / np.asarray(mean.sum(axis=1)).ravel()) @ mean
        basis = sparse.csr_array(
            (
                lagrange_basis(found.point).ravel(),
                (np.repeat(np.arange(len(points)), number.shape[1]), number[row].ravel()),
            ),
            shape=(len(points), len(nodes)),
        )
        return sparse.csr_array(basis @ mean)

    def __call__(self, snapshot: Snapshot) -> Shape:
        """Return a state on the grid."""
        frame = self._observer.frame(snapshot)
        faces, values = {}, {}
        for region, to_grid in self._maps.items():
            nodal = snapshot.faces[region].reshape(to_grid.shape[1], -1)
            on_grid = (to_grid @ nodal).reshape(*self._shape[region], -1, 3)
            faces[region] = np.asarray(frame(on_grid))
        if self.quantity is not None:
            for layer, (region, _) in self.layers.items():
                field = _coloured(snapshot, self.quantity, layer)[snapshot.cells_of(region)]
                values[layer] = (self._maps[region] @ field.ravel()).reshape(self._shape[region])
        return Shape(faces, values)

    def patches(self, layer: str) -> tuple[list["Surface"], list["Surface"]]:
        """Return the patches that make a layer's closed surface.

        Each patch has points and normals of its own, so that the layer's edges are sharp.

        Returns:
            The faces with the edge at the interface, and the walls where the body is cut open.
        """
        region, _ = self.layers[layer]
        n, m = self._shape[region]
        inner = np.arange(n * m).reshape(n, m)
        outer = inner + n * m
        edge, pole = (0, -1) if region == "oov" else (-1, 0)
        skin = [_sheet(face, self.closed, pole) for face in (inner, outer)]
        skin.append(_sheet(np.stack([inner[:, edge], outer[:, edge]], axis=1), self.closed, None))
        if self.closed:
            return skin, []
        return skin, [_sheet(np.stack([inner[k], outer[k]]), False, None) for k in (0, -1)]

    def outlines(self, layer: str) -> list[Integers]:
        """Return closed lines of `layer_points` round a layer's sections where it is cut open."""
        if self.closed:
            return []
        n, m = self._shape[self.layers[layer][0]]
        inner = np.arange(n * m).reshape(n, m)
        return [np.concatenate([inner[k], n * m + inner[k, ::-1], inner[k, :1]]) for k in (0, -1)]

    def layer_points(self, shape: Shape, layer: str) -> Floats:
        """Return the points of a layer's inner and outer face, shape (2 n_phi n_theta, 3)."""
        region, k = self.layers[layer]
        faces = shape.faces[region]
        return np.concatenate([faces[:, :, k].reshape(-1, 3), faces[:, :, k + 1].reshape(-1, 3)])

    def layer_values(self, shape: Shape, layer: str) -> Floats:
        """Return the coloured quantity at `layer_points`, shape (2 n_phi n_theta,)."""
        return np.tile(shape.values[layer].ravel(), 2)


@dataclass(frozen=True)
class Surface:
    """Triangles on some of the points of a layer.

    Attributes:
        source: For each point its number in `BodyGrid.layer_points`, shape (n,).
        triangles: Points of the triangles, shape (k, 3).
    """

    source: Integers
    triangles: Triangles


def layer_surfaces(grid: BodyGrid, layer: str) -> tuple[Surface, Surface]:
    """Return a layer's patches joined: its skin, and the walls of the cut."""
    skin, walls = grid.patches(layer)
    return _joined(skin), _joined(walls)


def _joined(patches: Sequence[Surface]) -> Surface:
    """Return patches as one surface; none give an empty one."""
    starts = np.append(0, np.cumsum([len(patch.source) for patch in patches])).astype(np.int32)
    none = Surface(np.empty(0, np.int64), np.empty((0, 3), np.int32))
    return Surface(
        np.concatenate([none.source, *(patch.source for patch in patches)]),
        np.concatenate(
            [none.triangles]
            + [patch.triangles + start for patch, start in zip(patches, starts, strict=False)]
        ),
    )


def _sheet(points: Integers, closed: bool, pole: int | None) -> Surface:
    """Return the triangles of a grid (n, m) of points.

    Args:
        points: Numbers of the grid's points.
        closed: Whether the last row is followed by the first.
        pole: The column (0 or -1) whose points are one point; it takes the number of the first.
    """
    n, m = points.shape
    local = np.arange(n * m).reshape(n, m)
    if pole is not None:
        local[:, pole] = local[0, pole]
    rows = np.vstack([local, local[:1]]) if closed else local
    a, b, c, d = rows[:-1, :-1], rows[1:, :-1], rows[1:, 1:], rows[:-1, 1:]
    triangles = np.concatenate(
        [np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([a, c, d], axis=-1).reshape(-1, 3)]
    )
    distinct = (np.diff(np.sort(triangles, axis=1), axis=1) > 0).all(axis=1)
    return Surface(points.ravel(), triangles[distinct].astype(np.int32))


def _thinnest(snapshot: Snapshot) -> str:
    """Return the layer with the smallest mean thickness."""
    thickness = {
        layer: float(np.linalg.norm(np.diff(snapshot.faces[region], axis=2), axis=3)[..., k].mean())
        for region, layers in snapshot.layers.items()
        for k, layer in enumerate(layers)
    }
    return min(thickness, key=lambda layer: thickness[layer])


def narrow_azimuth(snapshot: Snapshot) -> tuple[float, float]:
    """Return where the mouth is narrowest, and how round it is.

    Returns:
        The azimuth (rad, 0 to pi) across which the interface circle is narrowest, in the cup's own
        axes; and the ratio of its largest to its smallest root-mean-square extent, 1 for a circle.
    """
    observer = Observer(snapshot)
    phi = observer.phi
    alpha = interface_colatitude(snapshot)
    circle = observer.sampler.matrix(observer.sampler.locate(directions(alpha, phi), "cap"))
    points = observer.frame(snapshot)(circle @ snapshot.position)[:, :2]
    extents, axes = np.linalg.eigh(np.cov(points.T))
    narrow = float(np.arctan2(axes[1, 0], axes[0, 0]))
    return narrow % np.pi, float(np.sqrt(extents[1] / extents[0]))
