"""A curve's height as a formula of ``x``, read by a small grammar of its own: nothing of it is ever run as a program.

The text is parsed to Python's syntax tree and each node is looked up in the tables below; what is not in them is
refused. Numbers are floats from the start, so that powers overflow at once instead of growing.
"""

from __future__ import annotations

import ast
import operator
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError

MAX_LENGTH = 500
"""Longest formula [characters]."""
MAX_DEPTH = 40
"""Deepest nesting of operations and parentheses."""
MAX_NODES = 400
"""Most nodes of the syntax tree."""
MAX_NUMBER = 1e9
"""Largest magnitude of a number written in a formula."""
MAX_EXPONENT = 32.0
"""Largest magnitude of an exponent."""

NAMES = {"pi": np.pi, "e": np.e}
"""Names a formula may hold besides ``x``."""

FUNCTIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    **{name: (1, getattr(np, name)) for name in (
        "sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh",
        "sqrt", "exp", "expm1", "log", "log10", "log1p", "abs", "floor", "ceil", "sign")},
    "arctan2": (2, np.arctan2), "minimum": (2, np.minimum), "maximum": (2, np.maximum), "where": (3, np.where),
}
"""Functions a formula may call: how many arguments, and what computes them."""

_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Mod: np.fmod,
}
_UNARY: dict[type[ast.unaryop], Callable[[Any], Any]] = {ast.UAdd: operator.pos, ast.USub: operator.neg}
_COMPARE: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: np.less, ast.LtE: np.less_equal, ast.Gt: np.greater, ast.GtE: np.greater_equal,
}


class _RefusedError(ValueError):
    """What in a formula is not allowed."""


def evaluated(formula: str, x: Array, field: str = "line.formula") -> Array:
    """The formula at every ``x``.

    Args:
        formula: an expression of ``x``, ``pi``, ``e``, numbers, ``+ - * / % **``, comparisons and ``FUNCTIONS``.
        x: where ``(N,)``.
        field: the key it was given under, for the message.

    Returns:
        ``(N,)``, finite.

    Raises:
        InputError: anything else in it, too long, too deep, or not finite somewhere.

    >>> evaluated("0.04*sin(2*pi*x/0.8)", np.array([0.0, 0.2]))
    array([0.  , 0.04])
    """
    shown = formula if len(formula) <= 60 else formula[:57] + "..."
    try:
        tree = _parsed(formula)
        with np.errstate(all="ignore"):
            y = np.broadcast_to(np.asarray(_value(tree, x), dtype=float), x.shape)
    except _RefusedError as refused:
        raise InputError(f"cannot be evaluated: {refused}; expected y [m] of x [m], e.g. 0.04*sin(2*pi*x/0.8)",
                         field=field, value=shown) from refused
    if not np.all(np.isfinite(y)):
        raise InputError("is not finite over the whole length", field=field, value=shown)
    return y


def _parsed(formula: str) -> ast.expr:
    if len(formula) > MAX_LENGTH:
        raise _RefusedError(f"longer than {MAX_LENGTH} characters")
    # Python folds look-alike letters into plain ones; only what can be told apart by eye is read.
    if not formula.isascii() or not formula.isprintable():
        raise _RefusedError("holds characters other than plain ones")
    depth = 0
    for character in formula:
        depth += (character in "([{") - (character in ")]}")
        if depth > MAX_DEPTH:
            raise _RefusedError(f"nested deeper than {MAX_DEPTH}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(formula.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise _RefusedError(f"not a formula ({getattr(error, 'msg', type(error).__name__)})") from error
    level, count, deep = [tree], 0, 0
    while level:
        count, deep = count + len(level), deep + 1
        if count > MAX_NODES or deep > MAX_DEPTH:
            raise _RefusedError(f"more than {MAX_NODES} parts or nested deeper than {MAX_DEPTH}")
        level = [child for node in level for child in ast.iter_child_nodes(node) if isinstance(child, ast.expr)]
    return tree


def _value(node: ast.expr, x: Array) -> Any:
    if isinstance(node, ast.Constant):
        return _number(node.value)
    if isinstance(node, ast.Name):
        if node.id == "x":
            return x
        if node.id in NAMES:
            return np.float64(NAMES[node.id])
        raise _RefusedError(f"unknown name {node.id}; known are x, {', '.join(NAMES)}")
    if isinstance(node, ast.UnaryOp) and type(node.op) in _UNARY:
        return _UNARY[type(node.op)](_value(node.operand, x))
    if isinstance(node, ast.BinOp):
        return _binary(node, x)
    if isinstance(node, ast.Compare) and len(node.ops) == 1 and type(node.ops[0]) in _COMPARE:
        # As 0.0 and 1.0, so that steps can be added up.
        return 1.0 * _COMPARE[type(node.ops[0])](_value(node.left, x), _value(node.comparators[0], x))
    if isinstance(node, ast.Call):
        return _called(node, x)
    raise _RefusedError(f"{type(node).__name__} is not allowed")


def _number(value: object) -> Any:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise _RefusedError("only numbers may be written out")
    if not abs(value) <= MAX_NUMBER:
        raise _RefusedError(f"a number is larger than {MAX_NUMBER:g}")
    return np.float64(value)


def _binary(node: ast.BinOp, x: Array) -> Any:
    left, right = _value(node.left, x), _value(node.right, x)
    if isinstance(node.op, ast.Pow):
        if not np.all(np.abs(right) <= MAX_EXPONENT):
            raise _RefusedError(f"an exponent is larger than {MAX_EXPONENT:g}")
        return np.power(left, right)
    if isinstance(node.op, ast.Div):
        # By a number written out: times its reciprocal, as the lines of the shipped scenes have always been computed.
        return left * (1.0 / right) if isinstance(node.right, ast.Constant) else left / right
    if type(node.op) in _BINARY:
        return _BINARY[type(node.op)](left, right)
    raise _RefusedError(f"{type(node.op).__name__} is not allowed")


def _called(node: ast.Call, x: Array) -> Any:
    name = node.func.id if isinstance(node.func, ast.Name) else None
    if name not in FUNCTIONS:
        raise _RefusedError(f"unknown function; known are {', '.join(FUNCTIONS)}")
    count, function = FUNCTIONS[name]
    if node.keywords or len(node.args) != count:
        raise _RefusedError(f"{name} takes {count} value{'s' if count > 1 else ''}")
    return function(*(_value(argument, x) for argument in node.args))
