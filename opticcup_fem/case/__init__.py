"""Cases: what a run computes, read from TOML, checked, and written back resolved."""

from opticcup_fem.case.files import case_to_toml, load_case, parse_case, read_toml, write_case
from opticcup_fem.case.tables import (
    Case,
    Closure,
    Growth,
    Material,
    Mesh,
    Output,
    Run,
    Shape,
    Solver,
)

__all__ = [
    "Case",
    "Closure",
    "Growth",
    "Material",
    "Mesh",
    "Output",
    "Run",
    "Shape",
    "Solver",
    "case_to_toml",
    "load_case",
    "parse_case",
    "read_toml",
    "write_case",
]
