"""Sparse pencils against LAPACK: zero diagonals, held and tied unknowns, no symmetry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from opticcup_fem.meridian.pencils import Motions, Pencil
from opticcup_fem.meridian.problem import assemble_dense

CELLS, SIZE = 12, 3
UNKNOWNS = 2 * np.arange(CELLS)[:, None] + np.arange(SIZE)
N_U = 2 * CELLS + 1


def motions() -> Motions:
    """Return motions with two unknowns held and two tied with opposite signs."""
    free = np.ones(N_U, dtype=bool)
    free[[4, 9, 11]] = False
    column = np.where(free, np.cumsum(free) - 1, -1)
    sign = np.ones(N_U)
    column[11], sign[11] = column[10], -1.0
    return Motions(column, sign)


def matrices(symmetric: bool, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return random cell matrices A without a diagonal, and positive definite ones M."""
    rng = np.random.default_rng(seed)
    stiffness, root = rng.normal(size=(2, CELLS, SIZE, SIZE))
    if symmetric:
        stiffness = stiffness + stiffness.transpose(0, 2, 1)
    stiffness[:, range(SIZE), range(SIZE)] = 0.0
    return stiffness, root @ root.transpose(0, 2, 1) + np.eye(SIZE)


@pytest.mark.parametrize("symmetric", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_counts_and_nearest_eigenvalues_are_those_of_lapack(symmetric: bool, seed: int) -> None:
    stiffness, mass = matrices(symmetric, seed)
    pencil = Pencil(motions(), UNKNOWNS, mass, symmetric)
    basis = motions().whole(np.eye(motions().size))
    # twice: the second state must take the place of the first
    for factor in (-1.0, 1.0):
        pencil.set(factor * stiffness)
        dense = [
            basis.T @ assemble_dense(UNKNOWNS, cells, N_U) @ basis
            for cells in (factor * stiffness, mass)
        ]
        values = linalg.eigvals(*dense)
        assert pencil.negative() == np.sum(values.real < 0)
        order = np.argsort(np.abs(values))
        nearest = np.sort(values[order][:1].real)
        found, vectors = pencil.nearest(1)
        np.testing.assert_allclose(found, nearest, rtol=1e-6)
        np.testing.assert_array_equal(vectors[[4, 9]], 0.0)
        np.testing.assert_array_equal(vectors[11], -vectors[10])
        if symmetric:
            ascending = np.sort(values.real)
            for index in (0, 7, len(values) - 1):
                assert pencil.eigenvalue(index) == pytest.approx(ascending[index], rel=1e-6)


def test_a_positive_definite_symmetric_part_needs_no_more() -> None:
    stiffness, mass = matrices(False, 4)
    pencil = Pencil(motions(), UNKNOWNS, mass, symmetric=False)
    pencil.set(stiffness + 10 * np.eye(SIZE))
    assert pencil.negative() == 0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_an_eigenvalue_at_zero_has_the_sign_of_the_count(seed: int) -> None:
    """A is shifted along M until one eigenvalue is zero up to rounding, on either side of it."""
    stiffness, mass = matrices(True, seed)
    pencil = Pencil(motions(), UNKNOWNS, mass)
    basis = motions().whole(np.eye(motions().size))
    dense = [basis.T @ assemble_dense(UNKNOWNS, part, N_U) @ basis for part in (stiffness, mass)]
    values = linalg.eigvalsh(*dense)
    index = len(values) // 2
    for shift in values[index] * (1 + np.array([-1e-13, -1e-15, 0.0, 1e-15, 1e-13])):
        pencil.set(stiffness - shift * mass)
        found = pencil.eigenvalue(index)
        assert abs(found) < 1e-9
        assert (found < 0) == (pencil.negative() > index)
        assert pencil.eigenvalue(index) == found
