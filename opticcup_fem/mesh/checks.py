"""What a mesh builder refuses, each with one sentence that says what to do."""

import numpy as np

from opticcup_fem.errors import MeshError

__all__ = ["check_angle", "check_symmetry", "edge_count", "positive"]

FEWEST_EDGES = 8
"""A circle of fewer edges does not stand for a circle, not even with cubic elements."""

MOST_MIRRORS = 8
"""With more mirror planes through a pole its triangles have angles below 22 degrees."""


def positive(**values: float) -> tuple[float, ...]:
    """Return the values, or refuse the first that is not a positive number."""
    for name, value in values.items():
        if not (np.isfinite(value) and value > 0):
            raise MeshError(f"{name} is {value:g}; give a finite number above 0")
    return tuple(values.values())


def check_angle(angle: float) -> None:
    """Refuse an opening angle that leaves no cap or no opening."""
    if not 0.0 < angle < np.pi:
        raise MeshError(
            f"the opening angle is {angle:g} rad; give radians between 0 and pi (180 degrees)"
        )


def edge_count(circle: float, size: float, name: str, radius: float, symmetry: int = 0) -> int:
    """Return the number of edges on a circle of a given radius, both in units of ``radius``.

    It is a multiple of 2 ``symmetry``: every mirror line meets the circle in two vertices.
    """
    edges = round(2.0 * np.pi * circle / size)
    if symmetry:
        edges = 2 * symmetry * max(1, round(edges / (2 * symmetry)))
    if edges < FEWEST_EDGES:
        largest = radius * 2.0 * np.pi * circle / FEWEST_EDGES
        raise MeshError(
            f"the mesh is too coarse: {name} = {size * radius:g} gives {edges} edges on a circle "
            f"of radius {circle * radius:.4g}, at least {FEWEST_EDGES} are needed; "
            f"set {name} to {largest:.3g} or less"
        )
    return edges


def check_symmetry(symmetry: int) -> None:
    """Refuse a number of mirror planes that leaves wedges too sharp for triangles."""
    if not 0 <= symmetry <= MOST_MIRRORS:
        raise MeshError(
            f"symmetry is {symmetry}; give the number of mirror planes, 1 to {MOST_MIRRORS}, or 0"
        )
