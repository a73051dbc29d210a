"""Numbers of a case that may vary: a constant, a table in t_n, or a formula."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from functools import partial
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, PlainSerializer, PlainValidator

from opticcup_fem.expressions import variables_of

PLACE_AND_TIME = ("theta", "phi", "t_n")
PLACE = ("theta", "phi")
STATE = ("theta", "phi", "t_n", "rho")


class TimeTable(BaseModel):
    """Values at normalised times, linear between them and constant beyond."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)

    t_n: tuple[float, ...]
    value: tuple[float, ...]


FieldValue = float | str | TimeTable


def read_field(
    value: Any, variables: Sequence[str], low: float | None, high: float | None = None
) -> FieldValue:
    """Return a value of a case as a number, a table or a formula.

    Args:
        value: As TOML has it.
        variables: What a formula may use; a table needs ``t_n`` among them.
        low: Numbers and entries of tables must not be below it.
        high: Nor above this.

    Raises:
        ValueError: It is none of these; the message is what to give instead.
    """
    if isinstance(value, TimeTable):
        return value
    if isinstance(value, str):
        if not value.strip():
            raise ValueError("the formula is empty")
        variables_of(value, variables)
        return value
    if isinstance(value, dict):
        if "t_n" not in variables:
            raise ValueError("it does not change with t_n; give a number or a formula in theta")
        return _table(value, low, high)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not math.isfinite(value) or not _is_between(value, low, high):
        bound = _bounds(low, high)
        table = ", a table {t_n = [...], value = [...]}" if "t_n" in variables else ""
        raise ValueError(
            f"give a number{bound}{table} or a formula in {', '.join(variables)} in quotes"
        )
    return float(value)


def _is_between(value: float, low: float | None, high: float | None) -> bool:
    return (low is None or value >= low) and (high is None or value <= high)


def _bounds(low: float | None, high: float | None) -> str:
    parts = [f"at least {low:g}"] if low is not None else []
    parts += [f"at most {high:g}"] if high is not None else []
    return f" of {' and '.join(parts)}" if parts else ""


def _table(value: dict[str, Any], low: float | None, high: float | None) -> TimeTable:
    columns = {}
    for name in ("t_n", "value"):
        column = value.get(name)
        if not isinstance(column, list | tuple) or not all(map(_is_finite, column)):
            raise ValueError("a table is {t_n = [...], value = [...]} with as many numbers in both")
        columns[name] = tuple(map(float, column))
    times, values = columns["t_n"], columns["value"]
    if len(value) > 2 or len(times) != len(values) or not times:
        raise ValueError("a table is {t_n = [...], value = [...]} with as many numbers in both")
    if any(later <= earlier for earlier, later in itertools.pairwise(times)):
        raise ValueError("the times of a table increase")
    if not all(_is_between(one, low, high) for one in values):
        raise ValueError(f"every value of the table is a number{_bounds(low, high)}")
    return TimeTable(t_n=times, value=values)


def _is_finite(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


def _plain(value: FieldValue) -> Any:
    return value.model_dump() if isinstance(value, TimeTable) else value


_WRITTEN = PlainSerializer(_plain)


def _read(
    variables: Sequence[str], low: float | None = None, high: float | None = None
) -> PlainValidator:
    return PlainValidator(partial(read_field, variables=variables, low=low, high=high))


FASTEST = 1000.0
"""Largest rate of growth: a thousandfold growth is a slip of the pen."""

Rate = Annotated[FieldValue, _read(PLACE_AND_TIME, -FASTEST, FASTEST), _WRITTEN]
"""A number, a table in t_n, or a formula in theta, phi, t_n."""

NonNegativeRate = Annotated[FieldValue, _read(PLACE_AND_TIME, 0.0), _WRITTEN]

Share = Annotated[FieldValue, _read(PLACE_AND_TIME, 1e-6, 1e6), _WRITTEN]
"""A positive number, a table in t_n, or a formula in theta, phi, t_n."""

Profile = Annotated[FieldValue, _read(PLACE, 1e-6, 1e6), _WRITTEN]
"""A positive number or a formula in theta, phi."""


def read_source(value: Any) -> FieldValue:
    """Return the source of a mass balance: "" for no balance, else as ``read_field``."""
    return "" if value == "" else read_field(value, STATE, None)


Source = Annotated[FieldValue, PlainValidator(read_source), _WRITTEN]
"""The same, in rho as well, or "" for none."""
