"""Where the layers of a shell are, as their mass balance sees it."""

from __future__ import annotations

import numpy as np

from opticcup_fem.shell import closures
from opticcup_fem.shell.balance import Geometry, root_of_metric
from opticcup_fem.shell.model import Shell, ShellState
from opticcup_fem.shell.section import Section


def names_of(section: Section) -> list[str]:
    """Return the names of a section's layers."""
    return [layer.name for layer in section.layers]


def layer_geometry(shell: Shell, state: ShellState, layers: list[str]) -> dict[str, Geometry]:
    """Return where layers are in a state, at the shell's present growth.

    Raises:
        LostFibre: Some layer has no admissible state.
    """
    forms = shell.forms_at_points(state)
    n_points = forms.shape[1]
    thickness = {name: np.zeros((shell.spaces.n_cells, n_points)) for name in layers}
    inside = {name: np.zeros(shell.spaces.n_cells, dtype=bool) for name in layers}
    for name, section in shell.sections.items():
        cells = shell.region_cells(name)
        wanted = set(names_of(section)) & set(layers)
        if not wanted or len(cells) == 0:
            continue
        means = closures.mean_stretches(
            shell.closure,
            section,
            shell.growth[name],
            forms[cells].reshape(-1, 6),
            shell.a_ref[cells].reshape(-1, 3),
            shell.surface_mesh.surface.curvature,
        )
        for layer in wanted:
            thickness[layer][cells] = means[layer].reshape(-1, n_points)
            inside[layer][cells] = True
    return {
        name: Geometry(
            root_of_metric(forms[inside[name], :, :3].reshape(-1, 3)),
            thickness[name][inside[name]].ravel(),
        )
        for name in layers
    }
