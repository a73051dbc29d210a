"""Loops over pairs of parts of a shell's faces, in C (``pairs.c``), compiled once.

There are tens of thousands of pairs in every state that touches itself; array operations would
spend their time on moving them through memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from opticcup_fem.compiled import c_library
from opticcup_fem.snapshot import Floats, Integers

DECLARATIONS = """
void balls(int64_t n_pieces, int64_t n, const int64_t* corners, const double* x, double bulge,
           double* out);
void normals(int64_t n_triangles, const int64_t* triangles, int64_t n_vertices, const double* x,
             double* out);
void pieces(int64_t n_pieces, int64_t n, const int64_t* corners, const double* start,
            const double* end, const double* normals_at_start, const double* normals_at_end,
            double bulge, double spread, double* out);
int64_t near_patches(int64_t n_cells, int64_t per_cell, const double* cells, const double* patches,
                     const double* rest, const int64_t* order, const double* low,
                     const double* high, double reach, double exempt, int64_t capacity,
                     int64_t* pairs);
void sagittas(int64_t n_triangles, const int64_t* triangles, const double* balls, const double* x,
              const double* normals, double spread, double* out);
int64_t near_curved(int64_t n_pairs, const int64_t* pairs, const int64_t* triangles,
                    const double* balls, const double* sagittas, const double* x, double reach,
                    int64_t* found);
int64_t near_points(int64_t n_pairs, const int64_t* pairs, const int64_t* first, const double* x,
                    const double* rest, const double* balls, double reach, double exempt,
                    int64_t capacity, int64_t* found);
int64_t within(int64_t n_pairs, const int64_t* pairs, const double* x, double reach,
               int64_t* which, double* apart);
void stiffness(int64_t n_pairs, const int64_t* pairs, const double* values,
               const int64_t* block_of_pair, int64_t n_points, const double* basis,
               const int64_t* block_of_point, double* own, double* blocks);
double least_distance(int64_t n_pairs, const int64_t* pairs, const int64_t* triangles,
                      const double* balls, const double* x, double least);
double free_share(int64_t n_pairs, const int64_t* pairs, const int64_t* triangles,
                  const double* balls, const double* start, const double* end, double reach,
                  double apart);
"""

PIECE = 12
"""Numbers of a piece: centres of its ball at the start and the end of a way, radius, axis of the
cone that holds its normals, cosine and sine of the cone's half angle, at most a right one."""

BULGE = 1.15
"""Radius of a curved piece over that of its corners: a bound for looking."""

SPREAD = 1.3
"""Angle of a curved piece's normals from their mean, or a triangle's, over that at its corners."""

FIRST_CAPACITY = 1_000_000
"""Pairs there is room for at first: memory that is not written to costs nothing."""


@cache
def library() -> tuple[Any, Any]:
    """Return cffi's (ffi, library) of the loops, compiled where the cache lacks them."""
    source = (Path(__file__).parent / "pairs.c").read_text(encoding="utf-8")
    return c_library("pairs", DECLARATIONS, source)


def _call(name: str, *arguments: Floats | Integers | float) -> Any:
    """Call a function of the library, arrays as pointers; those it writes must be contiguous."""
    ffi, loops = library()
    passed = []
    for argument in arguments:
        if isinstance(argument, np.ndarray):
            real = argument.dtype == np.float64
            kind = np.float64 if real else np.int64
            contiguous = np.ascontiguousarray(argument, dtype=kind)
            passed.append(ffi.from_buffer("double*" if real else "int64_t*", contiguous))
        else:
            passed.append(argument)
    return getattr(loops, name)(*passed)


def _found(search: Callable[[int, Integers], int]) -> Integers:
    """Return all pairs that a search finds, which is told how many it may write, and where."""
    capacity = FIRST_CAPACITY
    while True:
        pairs = np.empty((capacity, 2), dtype=np.int64)
        count = search(capacity, pairs)
        if count <= capacity:
            return pairs[:count].copy()
        capacity = count


def balls(corners: Integers, x: Floats) -> Floats:
    """Return balls around curved pieces: centres and radii, shape (n, 4).

    Args:
        corners: Vertices of each piece, shape (n, k).
        x: Places, shape (n_vertices, 3).
    """
    found = np.empty((len(corners), 4))
    _call("balls", *corners.shape, corners, x, BULGE, found)
    return found


def normals(triangles: Integers, x: Floats) -> Floats:
    """Return the normals of triangles at their vertices, shape (n_vertices, 3).

    Args:
        triangles: Corners of all, shape (n_triangles, 3).
        x: Places, shape (n_vertices, 3).
    """
    found = np.empty(x.shape)
    _call("normals", len(triangles), triangles, len(x), x, found)
    return found


def pieces(corners: Integers, start: Floats, end: Floats, around: Sequence[Floats]) -> Floats:
    """Return pieces on a straight way, shape (n, ``PIECE``).

    Args:
        corners: Vertices of each piece, shape (n, k).
        start: Places at the start, shape (n_vertices, 3).
        end: Places at the end.
        around: Normals at the vertices, at the start and at the end.
    """
    found = np.empty((len(corners), PIECE))
    _call("pieces", *corners.shape, corners, start, end, *around, BULGE, SPREAD, found)
    return found


def distances(x: Floats, pairs: Integers) -> Floats:
    """Return the distances of pairs of points x (n, 3), shape (n_pairs,)."""
    first, second = pairs.T
    square = np.zeros(len(pairs))
    for component in x.T:  # by columns: pairs are many
        square += (component[first] - component[second]) ** 2
    apart: Floats = np.sqrt(square)
    return apart


def farthest(one: Floats, other: Floats) -> float:
    """Return by how much places differ at most."""
    change = one - other
    return float(np.sqrt(np.einsum("...i,...i->...", change, change).max()))


def sagittas(triangles: Integers, around: Floats, x: Floats) -> Floats:
    """Return how far curved patches are from their triangles at most, shape (n_triangles,).

    Args:
        triangles: Their corners, those of all patches there are, shape (n_triangles, 3).
        around: Balls around the patches, shape (n_triangles, 4).
        x: Places, shape (n_vertices, 3).
    """
    found = np.empty(len(triangles))
    _call("sagittas", len(triangles), triangles, around, x, normals(triangles, x), SPREAD, found)
    return found


def near_curved(
    pairs: Integers, triangles: Integers, around: Floats, x: Floats, reach: float
) -> Integers:
    """Return those of some pairs of curved patches that may be nearer than the reach.

    Args:
        pairs: Shape (n, 2).
        triangles: Corners of all patches, shape (n_triangles, 3).
        around: Balls around them, shape (n_triangles, 4).
        x: Places, shape (n_vertices, 3).
        reach: What is near.
    """
    found = np.empty((len(pairs), 2), dtype=np.int64)
    high = sagittas(triangles, around, x)
    count = _call("near_curved", len(pairs), pairs, triangles, around, high, x, reach, found)
    return found[:count]


def near_patches(
    cells: Floats, patches: Floats, rest: Floats, reach: float, exempt: float
) -> Integers:
    """Return the pairs of patches of one face that may look at each other and come near.

    Args:
        cells: The cells as pieces, shape (n_cells, ``PIECE``).
        patches: Their patches as pieces, cell by cell, shape (n_patches, ``PIECE``).
        rest: Balls around the patches in the reference position, shape (n_patches, 4).
        reach: What is near.
        exempt: Patches that are nowhere farther apart in the reference position are left out.

    Returns:
        Shape (n, 2), pairs of the same two cells one after the other.
    """
    ends = cells[:, [0, 3]]
    room = cells[:, 6] + reach / 2
    low, high = ends.min(axis=1) - room, ends.max(axis=1) + room
    order = np.argsort(low, kind="stable")
    per_cell = len(patches) // len(cells)
    return _found(
        lambda capacity, pairs: _call(
            "near_patches",
            len(cells), per_cell, cells, patches, rest, order, low, high, reach, exempt,
            capacity, pairs,
        )
    )  # fmt: skip


def near_points(
    pairs: Integers,
    first: Integers,
    x: Floats,
    rest: Floats,
    around: Floats,
    reach: float,
    exempt: float,
) -> Integers:
    """Return the pairs of points in pairs of patches that are near each other.

    Args:
        pairs: The patches, shape (n_pairs, 2).
        first: Number of the first point of each patch, and of all, shape (n_patches + 1,).
        x: Places of the points, shape (n_points, 3).
        rest: Their reference places.
        around: Balls around the patches, shape (n_patches, 4).
        reach: What is near.
        exempt: Points that are no farther apart in the reference position are left out.

    Returns:
        Shape (n, 2), the first in the first patch.
    """
    return _found(
        lambda capacity, found: _call(
            "near_points",
            len(pairs), pairs, first, x, rest, around, reach, exempt, capacity, found,
        )
    )  # fmt: skip


def within(pairs: Integers, x: Floats, reach: float) -> tuple[Integers, Floats]:
    """Return which pairs of points are nearer than the reach, and their differences (n, 3)."""
    which, apart = np.empty(len(pairs), dtype=np.int64), np.empty((len(pairs) + 1, 3))
    count = _call("within", len(pairs), pairs, x, reach, which, apart)
    return which[:count], apart[:count]


def stiffness(
    pairs: Integers,
    values: Floats,
    block_of_pair: Integers,
    basis: Floats,
    block_of_point: Integers,
    n_blocks: int,
) -> Floats:
    """Return the blocks of the sum of (x_i - x_j) . s (x_i - x_j) over pairs of points.

    Args:
        pairs: Pairs (i, j), shape (n_pairs, 2).
        values: Components 11, 12, 13, 22, 23, 33 of s, shape (n_pairs, 6).
        block_of_pair: Block of what i and j do to each other, that of i first, shape (n_pairs,).
        basis: Basis of each point's cell there, shape (n_points, 10).
        block_of_point: Block of what each point does to itself, negative for none.
        n_blocks: Number of blocks.

    Returns:
        Shape (n_blocks, 10, 6, 10).
    """
    own, blocks = np.zeros((len(basis), 6)), np.zeros((n_blocks, 10, 6, 10))
    _call(
        "stiffness",
        len(pairs), pairs, values, block_of_pair, len(basis), basis, block_of_point, own, blocks,
    )  # fmt: skip
    return blocks


def least_distance(
    pairs: Integers, triangles: Integers, around: Floats, x: Floats, most: float
) -> float:
    """Return the least distance of pairs of triangles that do not cross, ``most`` at most.

    Args:
        pairs: Shape (n, 2).
        triangles: Corners of all, shape (n_triangles, 3).
        around: Balls around them, shape (n_triangles, 4).
        x: Places, shape (n_vertices, 3).
        most: A distance.
    """
    return float(_call("least_distance", len(pairs), pairs, triangles, around, x, most))


def free_share(
    pairs: Integers, triangles: Integers, around: Floats, start: Floats, end: Floats, apart: float
) -> float:
    """Return the share of a straight way on which pairs of triangles stay apart, 0 to 1.

    It may be some thousandths less than there is.  Triangles advance as far as the plane across
    their shortest distance allows, again and again (conservative advancement: B. Mirtich,
    Impulse-based Dynamic Simulation of Rigid Body Systems, 1996).

    Args:
        pairs: Shape (n, 2).
        triangles: Corners of all, shape (n_triangles, 3).
        around: Balls around them at the start, shape (n_triangles, 4).
        start: Places at the start, where no two of them cross, shape (n_vertices, 3).
        end: Places at the end.
        apart: Distance to be kept.
    """
    reach = apart + 2 * farthest(start, end)
    arguments = (pairs, triangles, around, start, end, reach, float(apart))
    return float(_call("free_share", len(pairs), *arguments))
