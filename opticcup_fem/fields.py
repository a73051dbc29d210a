"""Field files for ParaView: cubic VTK cells with what the layers do at their nodes.

Every cell has nodes of its own, because thickness and stresses jump between layers and regions.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.snapshot import Floats, Integers, Snapshot
from opticcup_fem.whole_files import replace_text, replacing

VTK_NODES: Integers = np.array([0, 1, 2, 7, 8, 3, 4, 6, 5, 9])
"""Our node at each place of VTK's cubic Lagrange triangle (cell type 69): corners, then two nodes
on each of the edges (0, 1), (1, 2), (2, 0), then the interior node."""

_MIRRORED: Integers = np.array([0, 2, 1, 5, 6, 4, 3, 8, 7, 9])
"""The same for the cell with corners 1 and 2 exchanged."""


def write_fields(
    path: Path, snapshot: Snapshot, vectors: Mapping[str, Floats] | None = None
) -> None:
    """Write one state as a .vtu file of cubic Lagrange triangles that wind outwards.

    Point data (units R and mu_IOV): ``position``, ``displacement``, ``boundary_0`` (inner face)
    to ``boundary_N`` (outer face) as offsets from the middle surface, to warp by; for each layer
    ``lambda_3_<layer>`` and ``stress_<layer>``, NaN where the layer is absent.  Cell data:
    ``region``, and for each layer ``inner_face_<layer>``, the k of its inner ``boundary_k``, -1
    where the layer is absent.  Point data ``node`` numbers the points that are one node, and
    ``contact_traction`` is the force of contact per reference area, where contact is resisted;
    ``e_<layer>`` and ``rho_<layer>`` (over rho_0) are there where a mass balance is solved.

    Args:
        path: The file; replaced in one step once it is complete.
        snapshot: The state.
        vectors: More point data by name, at the snapshot's nodes, shape (n, 3).
    """
    import meshio

    order = np.where(snapshot.orientation[:, None] > 0, VTK_NODES, _MIRRORED)

    def per_cell(values: NDArray[Any]) -> NDArray[Any]:
        """Return cell-node values (m, 10, ...) in VTK's order, one row a point."""
        rows = values[np.arange(len(order))[:, None], order]
        return np.ascontiguousarray(rows.reshape(-1, *values.shape[2:]))

    position = snapshot.position[snapshot.cells]
    reference = snapshot.reference[snapshot.cells]
    data = {"position": per_cell(position), "displacement": per_cell(position - reference)}
    for k, offset in enumerate(_boundaries(snapshot, position)):
        data[f"boundary_{k}"] = per_cell(offset)
    for layer, stretch in snapshot.thickness_stretch.items():
        data[f"lambda_3_{layer}"] = per_cell(stretch)
    for layer, stress in snapshot.stress.items():
        data[f"stress_{layer}"] = per_cell(stress)
    for name, values in snapshot.growth.items():
        data[name] = per_cell(values)
    for name, values in (vectors or {}).items():
        data[name] = per_cell(values[snapshot.cells])
    if snapshot.contact_traction is not None:
        data["contact_traction"] = per_cell(snapshot.contact_traction[snapshot.cells])
    data["node"] = per_cell(snapshot.cells)
    cells = np.arange(order.size).reshape(order.shape)
    mesh = meshio.Mesh(
        data["position"],
        [("VTK_LAGRANGE_TRIANGLE", cells)],
        point_data=data,
        cell_data={name: [values] for name, values in _cell_data(snapshot).items()},
    )
    with replacing(path) as unfinished:
        mesh.write(unfinished, file_format="vtu", binary=True, compression=None)


def _cell_data(snapshot: Snapshot) -> dict[str, NDArray[np.int32]]:
    """Return the region and each layer's place in every cell, each (m,)."""
    data = {"region": snapshot.region.astype(np.int32)}
    for region, layers in snapshot.layers.items():
        for k, layer in enumerate(layers):
            place = data.setdefault(f"inner_face_{layer}", np.full(len(snapshot.cells), -1, "i4"))
            place[snapshot.cells_of(region)] = k
    return data


def _boundaries(snapshot: Snapshot, position: Floats) -> list[Floats]:
    """Return the offsets of the layers' faces, each (m, 10, 3), inside first.

    A region with fewer layers than another repeats its outer face, so that every one is finite.
    """
    count = 1 + max(len(layers) for layers in snapshot.layers.values())
    boundaries = [np.zeros_like(position) for _ in range(count)]
    for region, faces in snapshot.faces.items():
        cells = snapshot.cells_of(region)
        for k, boundary in enumerate(boundaries):
            boundary[cells] = faces[:, :, min(k, faces.shape[2] - 1)] - position[cells]
    return boundaries


def write_collection(path: Path, files: Sequence[tuple[float, str]]) -> None:
    """Write the .pvd file that lists field files by time; replaced in one step.

    Args:
        path: The collection.
        files: t_n and name, relative to the collection, of each field file.
    """
    entries = [
        f'    <DataSet timestep="{t_n!r}" group="" part="0" file={quoteattr(name)}/>'
        for t_n, name in files
    ]
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">',
        "  <Collection>",
        *entries,
        "  </Collection>",
        "</VTKFile>",
    ]
    replace_text(path, "\n".join(lines) + "\n")
