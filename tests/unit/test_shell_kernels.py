"""Compiling kernels: what a killed compilation leaves behind does not stop the next one."""

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

from opticcup_fem import compiled
from opticcup_fem.mesh import strip_mesh
from opticcup_fem.shell.forms import ShellForms
from opticcup_fem.shell.kernels import Kernel
from opticcup_fem.shell.spaces import ShellSpaces


@pytest.fixture
def forms() -> ShellForms:
    mesh = strip_mesh(2.0, 1.0, 2, 1, comm=MPI.COMM_SELF)
    return ShellForms(ShellSpaces(mesh.mesh, mesh.orientation()))


def test_leftover_of_a_killed_compilation_is_cleared(
    forms: ShellForms, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """FFCx would wait ten minutes for a source file that nobody compiles any more."""
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    spaces = forms.spaces
    data = {forms.stress: np.ones((spaces.n_cells, len(forms.quadrature_points), 6))}
    first = Kernel(spaces.mesh.comm, forms.integrals["Fk"], spaces.coordinates)(data)
    for mark in tmp_path.glob("libffcx_forms_*.c.cached"):
        mark.unlink()
    again = Kernel(spaces.mesh.comm, forms.integrals["Fk"], spaces.coordinates)(data)
    assert np.array_equal(first, again)
    # constant moments against an orthonormal basis: only its constant, of value sqrt 2, answers
    per_cell = again.reshape(spaces.n_cells, -1, 3).sum(axis=2)[:, 0]
    assert per_cell == pytest.approx(3 * np.sqrt(2) / 2 * spaces.det_j)


def test_edges_may_be_summed_into_cells(forms: ShellForms) -> None:
    """Adding edge tensors into an array equals summing them afterwards."""
    spaces = forms.spaces
    rng = np.random.default_rng(3)
    n, k = spaces.n_cells, spaces.degree
    x = spaces.position.tabulate_dof_coordinates()[spaces.nodes]
    director = np.zeros((n, 3, k, 3))
    director[..., 2] = 1.0
    data = {
        forms.orientation: spaces.orientation,
        forms.sign: spaces.edge_sign,
        forms.r: x + 0.01 * rng.normal(size=x.shape),
        forms.alpha: 0.1 * rng.normal(size=(n, 3, k)),
        forms.director: director,
    }
    kernel = Kernel(spaces.mesh.comm, forms.integrals["L_edge"], spaces.coordinates)
    apart = kernel(data)
    start = rng.normal(size=(n, spaces.n_curvature))
    together = kernel(data, into=start.copy())
    assert np.allclose(together, start + apart.sum(axis=1), rtol=1e-13, atol=1e-15)
