"""STUDY.toml: a base case and axes along which its keys vary."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from opticcup_fem.case import Case, parse_case, read_toml
from opticcup_fem.errors import CaseError

MOST_POINTS = 100_000
"""A study of more points is taken for a slip of the pen."""


class Axis(BaseModel):
    """One axis: the values of one key, or of several keys that vary together."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True, allow_inf_nan=False)
    key: str | None = None
    keys: list[str] | None = None
    values: list[Any] | None = None
    start: float | None = Field(default=None, alias="from")
    stop: float | None = Field(default=None, alias="to")
    step: float | None = Field(default=None, gt=0)
    count: int | None = Field(default=None, ge=2, le=MOST_POINTS)
    scale: Literal["linear", "log"] = "linear"

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.key is None) == (self.keys is None):
            raise ValueError("give each axis one `key`, or `keys` that vary together")
        ranged = self.start is not None or self.stop is not None
        if (self.values is None) != ranged:
            raise ValueError("give an axis either `values`, or `from` and `to`")
        if self.values is not None:
            self._check_values(self.values)
        else:
            self._check_range()
        return self

    def _check_values(self, values: list[Any]) -> None:
        if not values:
            raise ValueError("an axis needs at least one value")
        if self.keys is not None:
            for value in values:
                if not isinstance(value, list) or len(value) != len(self.keys):
                    raise ValueError(
                        f"{value} is not possible: each entry of `values` is an array with one "
                        f"value for each of the {len(self.keys)} keys"
                    )

    def _check_range(self) -> None:
        if self.start is None or self.stop is None or self.keys is not None:
            raise ValueError("a range needs `from` and `to`, and a single `key`")
        if (self.step is None) == (self.count is None):
            raise ValueError("a range needs either `step` or `count`")
        if self.stop <= self.start:
            raise ValueError("`to` must lie above `from`")
        if not math.isfinite(self.stop - self.start):
            raise ValueError("`from` and `to` are too far apart")
        if self.step is not None and (self.stop - self.start) / self.step > MOST_POINTS:
            raise ValueError(f"`step` is too small: it would give more than {MOST_POINTS} values")
        if self.scale == "log" and (self.start <= 0 or self.count is None):
            raise ValueError("a logarithmic range needs `from` above 0, and `count`")

    @property
    def names(self) -> list[str]:
        """Keys that vary."""
        return [self.key] if self.key is not None else list(self.keys or [])

    def settings(self) -> list[dict[str, Any]]:
        """Return the values of the keys at each place of the axis."""
        if self.values is not None:
            if self.keys is None:
                return [{self.names[0]: value} for value in self.values]
            return [dict(zip(self.keys, value, strict=True)) for value in self.values]
        assert self.start is not None and self.stop is not None
        if self.scale == "log":
            numbers = np.geomspace(self.start, self.stop, self.count or 2)
        elif self.count is not None:
            numbers = np.linspace(self.start, self.stop, self.count)
        else:
            assert self.step is not None
            steps = int((self.stop - self.start) / self.step + 1e-9)
            numbers = self.start + self.step * np.arange(steps + 1)
        # 0.1 + 2 * 0.1 is meant to be 0.3
        return [{self.names[0]: float(f"{number:.12g}")} for number in numbers]


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")
    case: str | None = None
    base: dict[str, dict[str, Any]] = Field(default_factory=dict)
    combine: Literal["grid", "zip"] = "grid"
    axis: list[Axis] = Field(min_length=1)


@dataclass(frozen=True)
class Point:
    """One point of a study.

    Attributes:
        settings: The keys that vary, with their values here.
        case: The case, None where it cannot be.
        reason: Why it cannot be.
    """

    settings: dict[str, Any]
    case: Case | None
    reason: str = ""


@dataclass(frozen=True)
class Study:
    """A study, resolved.

    Attributes:
        keys: The keys that vary, in the order of the axes.
        points: Its points, the last axis varying fastest.
    """

    keys: tuple[str, ...]
    points: tuple[Point, ...]


def load_study(path: str | Path) -> Study:
    """Read a study file.

    Raises:
        CaseError: It cannot be read, is not TOML, or holds a wrong key or value.
    """
    path = Path(path)
    data = read_toml(path)
    base: dict[str, Any] = {}
    if isinstance(name := data.get("case"), str):
        base = read_toml(path.parent / name, "case file")
    return parse_study(data, base, source=str(path))


def parse_study(
    data: Mapping[str, Any], base: Mapping[str, Any] | None = None, source: str = "study"
) -> Study:
    """Check a study and resolve its points.

    Args:
        data: The tables of the study file.
        base: The tables of the case file that it names.
        source: What to call it in messages.

    Raises:
        CaseError: A key or value is wrong.  A combination of values that cannot be is a point
            with a reason.
    """
    try:
        file = _File.model_validate(dict(data))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        what = first["msg"].removeprefix("Value error, ")
        raise CaseError(f"{source}: {where or 'the file'}: {what}") from None
    base = base or {}
    if not all(isinstance(keys, Mapping) for keys in base.values()):
        parse_case(base, source=f"{source}: base case")
    tables = _merged(base, file.base)
    # studies are made of many axisymmetric paths; the surface is for who asks for it
    tables.setdefault("run", {}).setdefault("model", "meridian")
    keys = tuple(name for axis in file.axis for name in axis.names)
    _check_keys(keys, source)
    parse_case(tables, source=f"{source}: base case")
    points = tuple(_point(tables, setting) for setting in _combined(file, source))
    return Study(keys, points)


def _combined(file: _File, source: str) -> list[dict[str, Any]]:
    along = [axis.settings() for axis in file.axis]
    lengths = [len(settings) for settings in along]
    combinations: Sequence[tuple[dict[str, Any], ...]]
    if file.combine == "zip":
        if len(set(lengths)) > 1:
            raise CaseError(
                f'{source}: combine = "zip" needs axes of one length; theirs are '
                f"{', '.join(map(str, lengths))}"
            )
        combinations = list(zip(*along, strict=True))
    else:
        total = int(np.prod(lengths, dtype=float))
        if total > MOST_POINTS:
            raise CaseError(
                f"{source}: the study would have {total} points, more than {MOST_POINTS}; "
                "shorten an axis"
            )
        combinations = list(itertools.product(*along))
    return [{key: value for part in parts for key, value in part.items()} for parts in combinations]


def _check_keys(keys: Sequence[str], source: str) -> None:
    twice = [key for key in dict.fromkeys(keys) if keys.count(key) > 1]
    if twice:
        raise CaseError(f"{source}: {twice[0]} varies along two axes; leave one of them out")
    for key in keys:
        table, _, name = key.partition(".")
        field = Case.model_fields.get(table)
        known = () if field is None else getattr(field.annotation, "model_fields", ())
        if name not in known:
            raise CaseError(
                f"{source}: {key} is not a key of a case; write it as table.key, for example "
                "shape.radius_over_thickness"
            )


def _point(tables: Mapping[str, Any], settings: dict[str, Any]) -> Point:
    data = copy.deepcopy(dict(tables))
    for key, value in settings.items():
        table, _, name = key.partition(".")
        data.setdefault(table, {})[name] = value
    try:
        return Point(settings, parse_case(data, source="point"))
    except CaseError as error:
        return Point(settings, None, str(error).removeprefix("point: "))


def _merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    merged = copy.deepcopy(dict(base))
    for table, keys in over.items():
        merged[table] = {**merged.get(table, {}), **keys}
    return merged
