"""Reading cases with one clear sentence for every mistake, and writing them resolved."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, TypeGuard, get_args, get_origin

import tomlkit
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from opticcup_fem.case.checks import show
from opticcup_fem.case.tables import Case
from opticcup_fem.errors import CaseError


def load_case(path: str | Path, overrides: Sequence[str] = ()) -> Case:
    """Read and check a case file.

    Args:
        path: TOML file.
        overrides: Texts ``table.key=value``, applied in order; values are TOML, and a bare word
            counts as a string.

    Returns:
        The checked case with every default resolved.

    Raises:
        CaseError: If the file cannot be read, is not TOML, or holds a wrong key or value; the
            message is one sentence.
    """
    data = read_toml(path, "case file")
    for override in overrides:
        _apply_override(data, override)
    return parse_case(data, source=str(path))


def read_toml(path: str | Path, kind: str = "file") -> dict[str, Any]:
    """Return the tables of a TOML file.

    Args:
        path: The file.
        kind: What to call it where it is missing.

    Raises:
        CaseError: It cannot be read, or is not TOML.
    """
    try:
        return tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CaseError(f"{path}: there is no such {kind}") from None
    except OSError as error:
        raise CaseError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise CaseError(f"{path}: not a text file in UTF-8") from None
    except RecursionError:
        raise CaseError(f"{path}: not usable: its arrays are nested too deeply") from None
    except ValueError as error:  # wrong TOML, or a number of thousands of digits
        raise CaseError(f"{path}: not valid TOML: {_sentence_part(str(error))}") from None


def parse_case(data: Mapping[str, Any], source: str = "case") -> Case:
    """Check a nested mapping of tables and keys.

    Args:
        data: Tables of keys, as `tomllib` gives them.
        source: What to call the case in messages.

    Returns:
        The checked case with every default resolved.

    Raises:
        CaseError: If a key or value is wrong; the message is one sentence.

    >>> parse_case({"shape": {"radius_over_thickness": 15}}).shape.thickness * 15
    1.0
    """
    try:
        return Case.model_validate(dict(data))
    except ValidationError as error:
        # An unknown key first: it is the likely cause of whatever else is missing or wrong.
        details = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
        more = f" ({len(details) - 1} more mistakes follow)" if len(details) > 1 else ""
        raise CaseError(f"{source}: {_explain(details[0])}{more}") from None


def case_to_toml(case: Case, versions: Mapping[str, str] | None = None) -> str:
    """Return the resolved case as TOML, with meanings and units as comments.

    Args:
        case: The case.
        versions: Name and version of what computed it, written as comments; the text stays a
            valid case that gives back the same `case`.

    Returns:
        TOML text, ending in a newline.
    """
    document = tomlkit.document()
    document.add(tomlkit.comment("Resolved case of opticcup_fem: every default is written out."))
    document.add(tomlkit.comment("Lengths in units of R, stresses in units of mu_IOV, t_n in 20 h"))
    for name, version in (versions or {}).items():
        document.add(tomlkit.comment(f"{name} {version}"))
    for name, info in Case.model_fields.items():
        table = tomlkit.table()
        table.comment(info.description or "")
        section: BaseModel = getattr(case, name)
        for key, field in type(section).model_fields.items():
            item = tomlkit.item(_plain(getattr(section, key)))
            table.add(key, item.comment(field.description or ""))
        document.add(tomlkit.nl())
        document.add(name, table)
    return tomlkit.dumps(document)


def _plain(value: Any) -> Any:
    """Return a value as TOML knows it: arrays for tuples, inline tables for models."""
    if isinstance(value, BaseModel):
        table = tomlkit.inline_table()
        table.update({key: _plain(entry) for key, entry in value})
        return table
    return [_plain(entry) for entry in value] if isinstance(value, tuple) else value


def write_case(case: Case, path: str | Path, versions: Mapping[str, str] | None = None) -> None:
    """Write the resolved case, as `case_to_toml` gives it, to a file.

    Args:
        case: The case.
        path: File to write.
        versions: Name and version of what computed it.

    Raises:
        CaseError: If the file cannot be written.
    """
    try:
        Path(path).write_text(case_to_toml(case, versions), encoding="utf-8")
    except OSError as error:
        raise CaseError(f"{path}: cannot be written ({error.strerror})") from None


def _apply_override(data: dict[str, Any], override: str) -> None:
    name, equals, text = override.partition("=")
    *tables, key = (part.strip() for part in name.split("."))
    if not (equals and tables and all([*tables, key]) and text.strip()):
        raise CaseError(
            f"override {override!r}: write it as table.key=value, "
            "for example shape.radius_over_thickness=15"
        )
    section = data
    for table in tables:
        section = section.setdefault(table, {})
        if not isinstance(section, dict):
            raise CaseError(f"override {override!r}: {table} is not a table in this case")
    section[key] = _parse_value(text.strip())


def _parse_value(text: str) -> Any:
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        # TOML wants 0.45 where people write .45 on a command line; other bare words are strings.
        try:
            return float(text)
        except ValueError:
            return text
    return parsed["value"] if len(parsed) == 1 else text


def _explain(error: ErrorDetails) -> str:
    """Return the sentence for one of pydantic's errors: the key, the value, what is allowed."""
    loc = error["loc"]
    if error["type"] == "value_error" and not loc:
        return _sentence_part(error["msg"].removeprefix("Value error, "))
    if len(loc) == 1 and error["type"] != "extra_forbidden":
        key = str(loc[0])
        return f"{key} = {show(error['input'])} is not a table: write [{key}] and its keys below"
    model, where, rest = _table_of(loc)
    key, inside = str(rest[0]), rest[1:]
    name = where.format(key)
    if error["type"] == "extra_forbidden":
        return _explain_unknown(model, key, where)
    field = model.model_fields[key]
    if error["type"] == "missing" and not inside:
        return f"{name} is missing: {_allowed(field)}"
    is_entry = inside and error["type"] != "missing"
    place = f"entry {int(inside[0]) + 1} of {name}" if is_entry else name
    allowed = _allowed(field)
    if error["type"] == "value_error":
        allowed = _sentence_part(error["msg"].removeprefix("Value error, "))
        allowed += f" ({field.description})"
    return f"{place} = {show(error['input'])} is not possible: {allowed}"


def _explain_unknown(model: type[BaseModel], key: str, where: str) -> str:
    known = list(model.model_fields)
    close = difflib.get_close_matches(key, known, n=1)
    what = "table" if model is Case else "key"
    sentence = f"{where.format(key)} is not a known {what}"
    if close:
        return f"{sentence}; did you mean {where.format(close[0])}?"
    return f"{sentence}; known here: {', '.join(known)}"


def _table_of(
    loc: tuple[int | str, ...],
) -> tuple[type[BaseModel], str, tuple[int | str, ...]]:
    """Return the table in which an error lies, how its keys are called, and what follows in it.

    Keys of tables in an array are called, say, "radius in entry 1 of contact.obstacles".
    """
    model: type[BaseModel] = Case
    above, where = "", "{}"
    while len(loc) > 1:
        name, annotation = str(loc[0]), model.model_fields[str(loc[0])].annotation
        entry = next(iter(get_args(annotation)), None)
        if _is_table(annotation):
            model, loc, above = annotation, loc[1:], f"{above}{name}."
            where = above + "{}"
        elif len(loc) > 2 and _is_table(entry):
            where = f"{{}} in entry {int(loc[1]) + 1} of {above}{name}"
            model, loc = entry, loc[2:]
        else:
            break
    return model, where, loc


def _is_table(annotation: Any) -> TypeGuard[type[BaseModel]]:
    return isinstance(annotation, type) and issubclass(annotation, BaseModel)


def _allowed(field: FieldInfo) -> str:
    """Return what a key takes, in words, from its type, its bounds and its description."""
    annotation = field.annotation
    meaning = f" ({field.description})" if field.description else ""
    if annotation is bool:
        return f"give true or false{meaning}"
    if annotation in (int, float):
        noun = "a whole number" if annotation is int else "a number"
        return f"give {noun}{_bounds(field)}{meaning}"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return f"give a table of {', '.join(annotation.model_fields)}{meaning}"
    arguments = get_args(annotation)
    if get_origin(annotation) is Literal:
        return f"give one of {', '.join(show(a) for a in arguments)}{meaning}"
    if Ellipsis in arguments and isinstance(arguments[0], type):
        if issubclass(arguments[0], BaseModel):
            return f"give tables{meaning}"
    if Ellipsis in arguments:
        return f"give an array of numbers{_bounds(arguments[0])}{meaning}"
    noun = "numbers" if arguments[0] is float else "whole numbers"
    return f"give an array of {len(arguments)} {noun}{_bounds(arguments[0])}{meaning}"


def _bounds(annotated: Any) -> str:
    words = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
    metadata: list[Any] = []
    # A FieldInfo carries the bounds of `Field`, an Annotated type those of its entries.
    for entry in getattr(annotated, "metadata", getattr(annotated, "__metadata__", [])):
        metadata += entry.metadata if isinstance(entry, FieldInfo) else [entry]
    parts = [
        f"{word} {getattr(entry, name):g}"
        for name, word in words.items()
        for entry in metadata
        if getattr(entry, name, None) is not None
    ]
    return " " + " and ".join(parts) if parts else ""


def _sentence_part(text: str) -> str:
    return text.strip().rstrip(".")
