"""Case files and study files as hypothesis makes them up: near right ones, and far from them."""

import json
from typing import Any

from hypothesis import strategies as st

from opticcup_fem.case import Case

EDGES = [
    *("0", "-0.0", "1", "-1", "2", "40", "1e-320", "1e308", "-1e308", "inf", "-inf", "nan"),
    *("9223372036854775808", "1" + 400 * "0", "0x1F", "1_000", "true", "false", '""', '"5"', "'a'"),
    *("1979-05-27", "07:32:00", "1979-05-27T07:32:00Z", "[]", "{}", "[[]]", "[1, 'a', {b = 2}]"),
    *(
        '"cup"',
        '"cap"',
        '"disk"',
        '"meridian"',
        '"surface"',
        '"paper"',
        '"closed-form"',
        '"resist"',
    ),
    *('"branch"', '"log"', '"zip"', '"grid"', '"axis"', '"shape.radius_over_thickness"'),
    "[{kind = 'sphere', centre = [0, 0, 3]}]",
    "[{kind = 'plate', centre = [0, 0], size = 3}]",
    "[0.1, 0.2, 0.05]",
    5000 * "9",
    2000 * "[" + 2000 * "]",
    "[2, 5, 5]",
]
"""Values that may be right or wrong, as TOML spells them."""

KEYS = [
    (table, key)
    for table, info in Case.model_fields.items()
    for key in info.annotation.model_fields  # type: ignore[union-attr]
]

NUMBERS = st.one_of(
    st.integers().map(str),
    st.integers(0, 20).map(str),
    st.floats().map(repr),
    st.floats(0, 2).map(repr),
    st.floats(2, 100).map(repr),
)

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)

SCALARS = st.one_of(st.sampled_from(EDGES), NUMBERS, TEXT.map(json.dumps))


def _nested(values: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    arrays = st.lists(values, max_size=4).map(lambda parts: f"[{', '.join(parts)}]")
    names = st.sampled_from(["kind", "centre", "radius", "x"])
    tables = st.dictionaries(names, values, max_size=3).map(
        lambda keys: "{" + ", ".join(f"{key} = {value}" for key, value in keys.items()) + "}"
    )
    return arrays | tables


VALUES = st.recursive(SCALARS, _nested, max_leaves=6)


def _text(entries: dict[tuple[str, str], str]) -> str:
    """Return tables and their keys as TOML."""
    tables: dict[str, list[str]] = {}
    for (table, key), value in entries.items():
        tables.setdefault(table, []).append(f"{key} = {value}")
    return "\n".join(f"[{table}]\n" + "\n".join(lines) for table, lines in tables.items()) + "\n"


NAMES = st.one_of(
    st.sampled_from(KEYS),
    st.tuples(
        st.sampled_from(["shape", "mash", "run", "a.b", '""']), st.sampled_from(["x", "kind"])
    ),
)

SINGLE = st.tuples(st.sampled_from(KEYS), NUMBERS | VALUES).map(lambda one: _text(dict([one])))
"""One known key, the others at their defaults: what gets past the other checks."""

SEVERAL = st.dictionaries(NAMES, VALUES, max_size=8).map(_text)
"""Known keys, most of them, with whatever values."""


@st.composite
def _damaged(draw: st.DrawFn, right: str) -> str:
    """Return a right text with characters replaced, left out or doubled."""
    text = right
    for _ in range(draw(st.integers(1, 6))):
        start = draw(st.integers(0, len(text)))
        length = draw(st.integers(0, 8))
        middle = draw(
            st.sampled_from(["", "=", "[", "]", '"', "\n", ".", "e", "-", "0", "\x00"]) | TEXT
        )
        text = text[:start] + middle + text[start + length :]
    return text


def files(right: str) -> st.SearchStrategy[bytes]:
    """Return file contents: damaged forms of a right text, assembled ones, and any bytes."""
    texts = SINGLE | _damaged(right) | SEVERAL
    return texts.map(lambda text: text.encode("utf-8")) | st.binary(max_size=60)


def _axis(keys: dict[str, str]) -> str:
    return "\n".join(["[[axis]]", *(f"{key} = {value}" for key, value in keys.items())])


AXES = st.dictionaries(
    st.sampled_from(["key", "keys", "values", "from", "to", "step", "count", "scale", "x"]),
    st.one_of(
        SCALARS,
        st.sampled_from([f'"{table}.{key}"' for table, key in KEYS]),
        st.lists(SCALARS, max_size=3).map(lambda parts: f"[{', '.join(parts)}]"),
    ),
    max_size=5,
).map(_axis)

RANGES = st.tuples(
    st.sampled_from(KEYS), NUMBERS, NUMBERS, st.sampled_from(["step", "count"]), NUMBERS
).map(
    lambda one: _axis(
        {"key": f'"{one[0][0]}.{one[0][1]}"', "from": one[1], "to": one[2], one[3]: one[4]}
    )
)

TOPS = st.sampled_from(["", 'case = "bad.toml"']) | st.dictionaries(
    st.sampled_from(["case", "combine", "base", "base.run", "base.shape.kind", "axis"]),
    SCALARS,
    max_size=2,
).map(lambda keys: "\n".join(f"{key} = {value}" for key, value in keys.items()))

ASSEMBLED_STUDIES = st.tuples(TOPS, st.lists(AXES | RANGES, max_size=3)).map(
    lambda parts: "\n".join([parts[0], *parts[1]]) + "\n"
)


def study_files(right: str) -> st.SearchStrategy[bytes]:
    """Return contents of study files, like those of ``files``."""
    texts = _damaged(right) | ASSEMBLED_STUDIES
    return texts.map(lambda text: text.encode("utf-8")) | st.binary(max_size=60)


def overrides() -> st.SearchStrategy[Any]:
    """Return texts of the option ``--set``."""
    known = st.tuples(st.sampled_from(KEYS), VALUES).map(
        lambda one: f"{one[0][0]}.{one[0][1]}={one[1]}"
    )
    return known | TEXT
