"""Where the faces of a shell are: vectors from the nodes of the mid-surface to both faces."""

from __future__ import annotations

import numpy as np

from opticcup_fem.contact.gather import NodeGather
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.recovery import layer_faces
from opticcup_fem.snapshot import Floats, Integers


def nodal_means(values: Floats, cells: Integers, n_nodes: int) -> Floats:
    """Return means over the cells at each node.

    Args:
        values: At the nodes of the cells, shape (m, 10, ...).
        cells: Nodes of the cells, shape (m, 10).
        n_nodes: Number of nodes.
    """
    sums = np.zeros((n_nodes, *values.shape[2:]))
    np.add.at(sums, cells, values)
    count = np.bincount(cells.ravel(), minlength=n_nodes)
    means: Floats = sums / count.reshape(-1, *([1] * (sums.ndim - 1)))
    return means


def face_offsets(shell: Shell, state: ShellState, gather: NodeGather) -> Floats:
    """Return the vectors from the nodes to the faces of a state's layers (collective).

    A face lies a half of the shell, h lambda_3 of its layers, off the mid-surface along the normal;
    at a node the mean over its cells, which may differ in normal and section.

    Returns:
        Inner and outer face, at all nodes on rank 0, shape (n, 2, 3); elsewhere no node.
    """
    vectors = np.empty((shell.spaces.n_cells, shell.spaces.nodes.shape[1], 2, 3))
    for region in shell.sections:
        cells = shell.region_cells(region)
        faces = layer_faces(shell, state, region)[:, :, [0, -1]]
        vectors[cells] = faces - state.r[shell.spaces.nodes[cells]][:, :, None]
    together = gather.cell_values(vectors)
    n_nodes = int(gather.cells.max()) + 1 if len(gather.cells) else 0
    return nodal_means(together, gather.cells, n_nodes)
