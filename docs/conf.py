"""Sphinx: the documentation as a site (`make docs`), with warnings as errors.

The pages are Markdown that also reads well raw.  Demos become pages by Jupytext, and the reference
of the Python interface comes from the docstrings.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import jupytext

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.insert(0, str(ROOT))

import opticcup_fem  # noqa: E402

OUTSIDE = {"docker/README.md": "environment", "benchmarks/README.md": "benchmarks"}
"""Pages of other folders, and their names on the site."""

project = "opticcup_fem"
author = "the authors of opticcup_fem"
release = version = opticcup_fem.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.apidoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = f"opticcup_fem {version}"
html_copy_source = False
myst_heading_anchors = 3
myst_number_code_blocks: list[str] = []
pygments_style = "friendly"

apidoc_modules = [
    {
        "path": "../opticcup_fem",
        "destination": "_generated/api",
        "separate_modules": True,
        "module_first": True,
    }
]
autodoc_default_options = {
    "members": True,
    # a name is documented where it is written, not again where it can be imported from
    "ignore-module-all": True,
}
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True


def plain_docstring(lines: list[str]) -> None:
    """Turn plain prose into reStructuredText that says the same, in place.

    Formulas are indented blocks, and would be read as quotations; r_,a and |x| are names here,
    and would be read as references.
    """
    result: list[str] = []
    literal = table = False
    for line in lines:
        if re.fullmatch(r"=+( +=+)+", line):
            table = True
        elif not line.strip():
            table = False
        indent = len(line) - len(line.lstrip())
        starts = indent >= 4 and result and not result[-1] and not literal
        if starts and not _in_section(result):
            # the paragraph before announces a literal block
            result.insert(len(result) - 1, "")
            result.insert(len(result) - 1, "::")
            literal = True
        elif literal and line.strip() and indent < 4:
            literal = False
        result.append(line if literal or table else _escaped(line))
    lines[:] = result


def _in_section(lines: list[str]) -> bool:
    """Tell whether the last text line that is not indented is the title of a Google section."""
    plain = [line for line in lines if line and not line.startswith(" ")]
    return bool(plain) and re.fullmatch(r"[A-Z]\w+:", plain[-1]) is not None


def _escaped(line: str) -> str:
    parts = re.split(r"(``.+?``|:\w+:`.+?`|`[^`]+`_?)", line)
    for k in range(0, len(parts), 2):
        parts[k] = re.sub(r"(?<=\w)_(?=\W|$)", r"\\_", parts[k])
        parts[k] = parts[k].replace("|", r"\|").replace("*", r"\*")
    return "".join(parts)


def _process(
    _app: Any, what: str, _name: str, _object: Any, _options: Any, lines: list[str]
) -> None:
    plain_docstring(lines)
    if what in ("attribute", "data"):
        lines.insert(0, "")  # else Napoleon takes what stands before a colon for the type


def write_demo_pages() -> None:
    """Write docs/_generated/demos/*.md from demos/demo_*.py."""
    folder = DOCS / "_generated" / "demos"
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted((ROOT / "demos").glob("demo_*.py")):
        notebook = jupytext.read(path, fmt="py:percent")
        cells = [
            cell.source if cell.cell_type == "markdown" else f"```python\n{cell.source}\n```"
            for cell in notebook.cells
        ]
        page = folder / f"{path.stem.removeprefix('demo_')}.md"
        text = "\n\n".join(cells) + "\n"
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def write_outside_pages() -> None:
    """Copy pages that live beside what they describe to docs/_generated."""
    for page, name in OUTSIDE.items():
        (DOCS / "_generated" / f"{name}.md").write_text((ROOT / page).read_text(encoding="utf-8"))


def _link_outside(_app: Any, _page: str, source: list[str]) -> None:
    """Let links to those pages lead to their copies."""
    for page, name in OUTSIDE.items():
        source[0] = re.sub(rf"\]\((\.\./)+{page}\)", f"](/_generated/{name}.md)", source[0])


def setup(app: Any) -> None:
    """Connect the above."""
    write_demo_pages()
    write_outside_pages()
    app.connect("source-read", _link_outside)
    # before Napoleon's own handler
    app.connect("autodoc-process-docstring", _process, priority=400)
