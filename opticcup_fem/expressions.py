"""Formulas in case files: which are allowed, checked without evaluating anything.

Only arithmetic, a few functions and named variables pass; no attribute, index, text, comparison or
keyword does.  ``scalar_fields`` evaluates them with simpleeval.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence

FUNCTIONS = ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh", "abs", "min", "max", "step")
"""Functions of formulas; step(x) is 1 where x > 0, else 0."""

TWO_ARGUMENTS = ("min", "max")

CONSTANTS = ("pi",)

LONGEST = 500
"""Longest formula, in characters."""

OPERATORS = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow, ast.USub, ast.UAdd)
_STRUCTURE = (ast.BinOp, ast.UnaryOp, ast.Load)


def parse_formula(text: str, variables: Sequence[str]) -> ast.expr:
    """Return the syntax tree of a formula.

    Args:
        text: The formula.
        variables: Names that it may use.

    Raises:
        ValueError: It is no formula in these names; the message is a clause.

    >>> parse_formula("1 + phi", ["theta"])
    Traceback (most recent call last):
    ...
    ValueError: the formula knows no phi; it may use theta and pi
    """
    if len(text) > LONGEST:
        raise ValueError(f"a formula has at most {LONGEST} characters")
    try:
        body = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError("it is not a formula such as 1 + 0.5*cos(theta)") from None
    _check(body, variables)
    return body


def variables_of(text: str, variables: Sequence[str]) -> frozenset[str]:
    """Return which of the ``variables`` a formula uses.

    Raises:
        ValueError: See ``parse_formula``.
    """
    names = {n.id for n in ast.walk(parse_formula(text, variables)) if isinstance(n, ast.Name)}
    return frozenset(names & set(variables))


def _check(tree: ast.expr, variables: Sequence[str]) -> None:
    called = {id(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            _check_call(node)
        elif isinstance(node, ast.Name) and id(node) not in called:
            if node.id not in variables and node.id not in CONSTANTS:
                known = " and ".join([", ".join(variables), *CONSTANTS])
                raise ValueError(f"the formula knows no {node.id}; it may use {known}")
        elif isinstance(node, ast.Constant):
            if type(node.value) not in (int, float):
                raise ValueError("a formula holds numbers only, no texts or truth values")
        elif not isinstance(node, (*OPERATORS, *_STRUCTURE, ast.Name)):
            raise ValueError("a formula knows + - * / ** and brackets, nothing else")


def _check_call(node: ast.Call) -> None:
    name = node.func.id if isinstance(node.func, ast.Name) else None
    if name not in FUNCTIONS:
        called = ast.unparse(node.func)
        raise ValueError(f"there is no function {called}; there are {', '.join(FUNCTIONS)}")
    wanted = 2 if name in TWO_ARGUMENTS else 1
    if len(node.args) != wanted or node.keywords:
        raise ValueError(f"{name} takes {wanted} argument{'s' if wanted > 1 else ''}")
