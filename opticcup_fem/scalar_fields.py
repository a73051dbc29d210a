"""Numbers that vary over the shell and in time, as cases give them: evaluated with NumPy."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from opticcup_fem.errors import CaseError
from opticcup_fem.expressions import CONSTANTS, FUNCTIONS, parse_formula, variables_of

Array = NDArray[np.float64]

VARIABLES = ("theta", "phi", "t_n", "rho")
"""Colatitude from the apex and azimuth (radians, on the reference surface), time, rho/rho_0."""

_FUNCTIONS = {
    **{name: getattr(np, name) for name in FUNCTIONS if name not in ("min", "max", "step")},
    "min": np.minimum,
    "max": np.maximum,
    "step": lambda x: np.heaviside(x, 0.0),
}
_OPERATORS = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
}
_NODES = (ast.Expr, ast.BinOp, ast.UnaryOp, ast.Name, ast.Call)


class TimeSeries(Protocol):
    """A table in t_n, as ``case.TimeTable``."""

    @property
    def t_n(self) -> tuple[float, ...]:
        """Increasing normalised times."""
        ...

    @property
    def value(self) -> tuple[float, ...]:
        """Values there."""
        ...


class ScalarField:
    """A constant, a table in t_n (linear between, constant beyond), or a formula.

    Attributes:
        variables: Names that the value depends on.
    """

    def __init__(self, value: float | str | TimeSeries) -> None:
        """Prepare the evaluation.

        Args:
            value: As a case holds it.

        Raises:
            ValueError: The formula is none.
        """
        self._value = value
        self.variables: frozenset[str] = frozenset()
        self._tree: ast.expr | None = None
        if isinstance(value, str):
            self.variables = variables_of(value, VARIABLES)
            self._tree = parse_formula(value, VARIABLES)
        elif not isinstance(value, int | float):
            self.variables = frozenset({"t_n"})

    @property
    def is_zero(self) -> bool:
        """Whether it is the constant 0."""
        return isinstance(self._value, int | float) and self._value == 0

    def __call__(
        self,
        t_n: ArrayLike,
        theta: ArrayLike = 0.0,
        phi: ArrayLike = 0.0,
        rho: ArrayLike = 1.0,
    ) -> Array:
        """Return the values; what the field does not depend on does not shape them.

        Args:
            t_n: Normalised time.
            theta: Colatitudes, any shape.
            phi: Azimuths, same shape.
            rho: Densities over the initial one, same shape.
        """
        if isinstance(self._value, int | float):
            return np.asarray(float(self._value))
        if self._tree is None:
            assert not isinstance(self._value, str)
            return np.asarray(np.interp(np.asarray(t_n, float), self._value.t_n, self._value.value))
        names = {"theta": theta, "phi": phi, "t_n": t_n, "rho": rho}
        return self._evaluate({name: np.asarray(x, float) for name, x in names.items()})

    def _evaluate(self, names: dict[str, Any]) -> Array:
        from simpleeval import SimpleEval

        constants = {name: getattr(np, name) for name in CONSTANTS}
        evaluator = SimpleEval(
            operators=_OPERATORS, functions=_FUNCTIONS, names={**names, **constants}
        )
        evaluator.nodes = {kind: evaluator.nodes[kind] for kind in _NODES}
        # every number is a float: whole ones could grow without bounds
        evaluator.nodes[ast.Constant] = lambda node: np.float64(node.value)
        with np.errstate(all="ignore"):  # what is not finite is refused by ``over_shell``
            return np.asarray(evaluator.eval("", previously_parsed=self._tree), dtype=np.float64)

    def at(self, t_n: float, x: Array, rho: ArrayLike = 1.0) -> Array:
        """Return the values at points of the reference surface.

        Args:
            t_n: Normalised time.
            x: Points, shape (n, 3); the apex is at +z, a disk lies in the plane z = 0 and has its
                radius in the place of theta.
            rho: Densities there over the initial one, shape (n,).

        Returns:
            Shape (n,), or () where all points have the same value.
        """
        if not self.variables & {"theta", "phi"}:
            return self(t_n, rho=rho)
        theta, phi = angles(x)
        return self(t_n, theta, phi, rho)


def angles(x: Array) -> tuple[Array, Array]:
    """Return colatitude and azimuth of points (n, 3) of a sphere about the origin, or of a disk.

    Points of a disk, z = 0 for all, have their distance from the axis in the place of theta.
    """
    radius = np.hypot(x[:, 0], x[:, 1])
    flat = not np.any(x[:, 2])
    theta = radius if flat else np.arctan2(radius, x[:, 2])
    return theta, np.arctan2(x[:, 1], x[:, 0])


def require_values(field: ScalarField, key: str, t_end: float, above: float = -np.inf) -> None:
    """Refuse a field that is not finite, or too small, somewhere on a grid of the shell.

    Args:
        field: A field in theta, phi and t_n.
        key: Its name in sentences.
        t_end: It is looked at up to here.
        above: Its values lie above this.

    Raises:
        CaseError: It is not; the message names the place.
    """
    bound = f" above {above:.4g}" if np.isfinite(above) else ""
    _require(field, lambda value, t_n: value, key, t_end, above, f"it must be a number{bound}")


def require_growth(field: ScalarField, key: str, t_end: float) -> None:
    """Refuse a rate of growth with which 1 + rate t_n does not stay positive.

    Raises:
        CaseError: It does not; the message names the place.
    """
    meaning = "the growth factor 1 + rate t_n must stay positive"
    _require(field, lambda value, t_n: 1 + value * t_n, key, t_end, 0.0, meaning)


def _require(
    field: ScalarField,
    judged: Callable[[Array, float], Array],
    key: str,
    t_end: float,
    above: float,
    meaning: str,
) -> None:
    theta, phi = np.meshgrid(np.linspace(0, np.pi, 61), np.linspace(-np.pi, np.pi, 49))
    for t_n in np.linspace(0, t_end, 21):
        values = np.broadcast_to(field(t_n, theta, phi), theta.shape)
        with np.errstate(invalid="ignore"):
            wrong = ~(np.isfinite(values) & (judged(values, t_n) > above))
        if wrong.any():
            k = np.unravel_index(np.argmax(wrong), wrong.shape)
            raise CaseError(
                f"{key} is {values[k]:.4g} at theta = {theta[k]:.3g}, phi = {phi[k]:.3g}, "
                f"t_n = {t_n:.3g}, which is not possible: {meaning} everywhere"
            )
