"""The report as one file: pictures, tables and comparisons, nothing loaded from elsewhere."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from importlib import resources
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, StrictUndefined

from opticcup_fem.report.figures.base import Drawn
from opticcup_fem.whole_files import replace_text

if TYPE_CHECKING:
    import pandas as pd


def write_report(
    drawn: Sequence[Drawn], out_dir: Path, versions: Mapping[str, str], counts: str
) -> Path:
    """Write index.html.

    Args:
        drawn: The figures, saved in ``out_dir`` already.
        out_dir: The report's folder.
        versions: Name and version of what computed it.
        counts: How much was computed for it, in words.
    """
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    environment.filters["number"] = shown
    text = resources.files("opticcup_fem.report").joinpath("template.html").read_text("utf-8")
    page = environment.from_string(text).render(
        figures=[_figure(one) for one in drawn],
        comparisons=[(one, line) for one in drawn for line in one.comparisons],
        versions=versions,
        counts=counts,
    )
    replace_text(out_dir / "index.html", page)
    return out_dir / "index.html"


def _figure(one: Drawn) -> dict[str, Any]:
    picture = BytesIO()
    one.figure.savefig(picture, format="png", dpi=130)
    return {
        "name": one.name,
        "title": one.title,
        "text": one.text,
        "picture": base64.b64encode(picture.getvalue()).decode(),
        "tables": list(one.tables),
        "shown": {heading: _cells(table) for heading, table in one.shown.items()},
    }


def _cells(table: pd.DataFrame) -> dict[str, Any]:
    return {"columns": list(table.columns), "rows": table.to_numpy(dtype=object).tolist()}


def shown(value: Any) -> str:
    """Return a value as the report prints it: four digits, nothing for what is missing."""
    if value is None or value != value:
        return ""
    if isinstance(value, bool) or not hasattr(value, "__float__"):
        return str(value).replace("+-", "±")
    return f"{float(value):.4g}"
