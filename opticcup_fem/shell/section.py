"""Layers of a shell and the sections that they make, with their thickness quadrature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from opticcup_fem.errors import CaseError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Layer:
    """One homogeneous layer of compressible neo-Hookean tissue (S8).

    Attributes:
        name: Key of the layer in growth laws, records and pictures.
        thickness: Reference thickness, unit of length of the mesh.
        shear_modulus: Lamé constant mu of the ungrown tissue, unit of stress.
        poisson_ratio: Poisson's ratio nu; one half is the incompressible limit J = 1.
        points: Number of Gauss points through the thickness.
    """

    name: str
    thickness: float
    shear_modulus: float
    poisson_ratio: float
    points: int

    def __post_init__(self) -> None:
        """Refuse values without a meaning.

        Raises:
            CaseError: A value is out of range; the message names it.
        """
        for field, value, low in (
            ("thickness", self.thickness, 0.0),
            ("shear_modulus", self.shear_modulus, 0.0),
            ("points", self.points, 0),
        ):
            if not value > low:
                raise CaseError(f"layer {self.name!r}: {field} is {value}; it must be positive.")
        if not -1.0 < self.poisson_ratio <= 0.5:
            raise CaseError(
                f"layer {self.name!r}: poisson_ratio is {self.poisson_ratio}; "
                "it must lie above -1, and 0.5 is the largest."
            )

    @property
    def is_incompressible(self) -> bool:
        """Whether J = 1 is imposed, and there is no first Lamé constant."""
        return self.poisson_ratio == 0.5

    @property
    def contraction(self) -> float:
        """nu/(1 - nu) = lambda/(lambda + 2 mu): thinning in plane stress per areal strain."""
        return self.poisson_ratio / (1 - self.poisson_ratio)

    @property
    def lame(self) -> float:
        """First Lamé constant, lambda = 2 mu nu / (1 - 2 nu), of a compressible layer."""
        return 2 * self.shear_modulus * self.poisson_ratio / (1 - 2 * self.poisson_ratio)


@dataclass(frozen=True)
class Section:
    """Layers from the inside (xi = -h/2) to the outside (xi = +h/2) of a shell."""

    layers: tuple[Layer, ...]

    def __init__(self, layers: Sequence[Layer]) -> None:
        """Stack ``layers``, the innermost first.

        Raises:
            CaseError: There is no layer, or two share a name.
        """
        names = [layer.name for layer in layers]
        if not names or len(set(names)) != len(names):
            raise CaseError(f"a section needs one or more layers of different names, not {names}.")
        object.__setattr__(self, "layers", tuple(layers))

    @cached_property
    def thickness(self) -> float:
        """Total thickness h."""
        return sum(layer.thickness for layer in self.layers)

    @cached_property
    def boundaries(self) -> Array:
        """Heights of the layer faces, shape (n_layers + 1,), from -h/2 to h/2."""
        return np.asarray(self.face_places([1.0] * len(self.layers)))

    def face_places(self, factors: Sequence[Array | float]) -> list[Array | float]:
        """Return the heights at rest of the layer faces, the middle of all layers at 0.

        Args:
            factors: Factor on the thickness of each layer, all of one shape.
        """
        places: list[Array | float] = [0.0]
        for layer, factor in zip(self.layers, factors, strict=True):
            places.append(places[-1] + layer.thickness * factor)
        return [place - places[-1] / 2 for place in places]

    def face_heights(
        self, stretches: Sequence[Array], factors: Sequence[Array | float] | None = None
    ) -> Array:
        """Return the current heights of the layer faces over the mid-surface, inside first.

        Args:
            stretches: Mean thickness stretch of each layer, all of one shape.
            factors: Factor on the thickness at rest of each layer, 1 by default.

        Returns:
            Shape (..., n_layers + 1).
        """
        factors = factors or [1.0] * len(self.layers)
        at_rest = [one.thickness * f for one, f in zip(self.layers, factors, strict=True)]
        thicknesses = [h * stretch for h, stretch in zip(at_rest, stretches, strict=True)]
        first = np.zeros((1, *np.shape(thicknesses[0])))
        above_bottom = np.concatenate([first, np.cumsum(thicknesses, axis=0)])
        middle = sum(
            np.clip(-low, 0.0, h) * stretch
            for h, low, stretch in zip(at_rest, self.face_places(factors), stretches, strict=False)
        )
        heights: Array = np.moveaxis(above_bottom - middle, 0, -1)
        return heights

    @cached_property
    def gauss_points(self) -> tuple[tuple[Array, Array], ...]:
        """Heights and weights of the Gauss points of each layer, innermost first."""
        rules = []
        for layer, low in zip(self.layers, self.boundaries, strict=False):
            x, w = np.polynomial.legendre.leggauss(layer.points)
            half = layer.thickness / 2
            rules.append((low + half * (1 + x), half * w))
        return tuple(rules)

    def gauss_points_of(
        self, factors: Sequence[Array | float]
    ) -> Sequence[tuple[Array | list[Array | float], Array | list[Array | float]]]:
        """Return heights and weights of each layer's Gauss points at uneven thickness.

        Args:
            factors: Factor on the thickness of each layer, 1 or of shape (n,).
        """
        if all(isinstance(factor, float) and factor == 1.0 for factor in factors):
            return self.gauss_points
        rules = []
        for layer, factor, low in zip(
            self.layers, factors, self.face_places(factors), strict=False
        ):
            x, w = np.polynomial.legendre.leggauss(layer.points)
            half = layer.thickness * factor / 2
            heights: list[Array | float] = [low + half * (1 + float(one)) for one in x]
            rules.append((heights, [half * float(one) for one in w]))
        return rules
