"""Single faults put into the text of a module: signs, limits, factors, comparisons, statements left out.

cosmic-ray and mutmut were tried first. mutmut leads every call through a function of its own, which numba does not
compile; cosmic-ray, with its fourteen dependencies, changes files of the checkout, knows one test command, trusts code
that was compiled from what stood there before, and has no operator for the faults that matter to an arm: a limit a
quarter too wide, a minimum instead of a maximum, a statement left out.
"""

from __future__ import annotations

import ast
import hashlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

_BINARY: dict[type[ast.AST], tuple[str, ...]] = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"), ast.Pow: ("**", "*")}
_COMPARED: dict[type[ast.AST], tuple[str, ...]] = {
    ast.Lt: ("<", "<=", ">="), ast.LtE: ("<=", "<", ">"), ast.Gt: (">", ">=", "<="), ast.GtE: (">=", ">", "<"),
    ast.Eq: ("==", "!="), ast.NotEq: ("!=", "=="), ast.Is: ("is", "is not"), ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"), ast.NotIn: ("not in", "in")}
_SWAPPED = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum", "any": "all", "all": "any",
            "sin": "cos", "cos": "sin", "floor": "ceil", "ceil": "floor", "argmin": "argmax", "argmax": "argmin"}
_LEFT_OUT = ("abs", "clip", "sqrt", "exp", "cumsum")
"""Calls that their first argument replaces."""
_WIDER, _COARSER, _SMALL = 1.25, 1000.0, 1e-4
"""Factor on a number with a decimal point, on a tolerance, and below what it is one; whole numbers become one more."""
_WORDS = ("plot", "summary", "__repr__")
"""Functions that only draw and word are left alone, as are texts."""


@dataclass(frozen=True)
class Mutant:
    """One fault.

    Attributes:
        file: module, relative to the root.
        place: function it stands in, dotted; empty at the module's level.
        line: first line.
        start, end: bytes of the file that are replaced.
        before, after: what stands there, and what replaces it.
        compiled: whether compiled code may hold it.
        number: among equal ones of the same place.
    """

    file: str
    place: str
    line: int
    start: int
    end: int
    before: str
    after: str
    compiled: bool
    number: int = 0

    @property
    def key(self) -> str:
        """What it is, wherever its line moves to."""
        mark = f" #{self.number + 1}" if self.number else ""
        return f"{self.file}:{self.place}: {' '.join(self.before.split())} → {' '.join(self.after.split())}{mark}"

    def rank(self, seed: int) -> bytes:
        """Its place in an order of chance that no change elsewhere touches."""
        return hashlib.sha256(f"{seed} {self.key}".encode()).digest()

    def put_into(self, source: bytes) -> bytes:
        """The file with the fault."""
        return source[: self.start] + self.after.encode() + source[self.end:]


def mutants_of(root: Path, file: str) -> list[Mutant]:
    """Every single fault of a module.

    Args:
        root: the checkout.
        file: the module, relative to it.
    """
    source = (root / file).read_bytes()
    counts: Counter[str] = Counter()
    mutants = []
    for mutant in _Sites(file, source).faults(ast.parse(source), "", True):
        mutants.append(replace(mutant, number=counts[mutant.key]))
        counts[mutant.key] += 1
    return mutants


class _Sites:
    """Goes through a module's syntax tree."""

    def __init__(self, file: str, source: bytes) -> None:
        self.file, self.source, self.starts = file, source, [0]
        for line in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))

    def span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return (self.starts[node.lineno - 1] + node.col_offset,
                self.starts[node.end_lineno - 1] + node.end_col_offset)

    def text(self, node: ast.expr | ast.stmt) -> str:
        begin, end = self.span(node)
        return self.source[begin:end].decode()

    def faults(self, node: ast.AST, place: str, compiled: bool) -> Iterator[Mutant]:
        """Those of a node and of what is in it."""
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            # A class's methods are not compiled; a function is where its decorator says so.
            compiled = any("jit" in ast.dump(mark) for mark in node.decorator_list)
            place = f"{place}.{node.name}".lstrip(".")
            if node.name in _WORDS:
                return
        if _worded(node):
            return
        if isinstance(node, ast.expr | ast.stmt):
            begin, end = self.span(node)
            for after in self._instead(node):
                yield Mutant(self.file, place, node.lineno, begin, end, self.text(node), after, compiled)
            yield from self._operators(node, place, compiled)
        if isinstance(node, ast.If | ast.IfExp | ast.While) and isinstance(
                node.test, ast.Name | ast.Attribute | ast.Call | ast.BoolOp):
            begin, end = self.span(node.test)
            before = self.text(node.test)
            yield Mutant(self.file, place, node.lineno, begin, end, before, f"(not ({before}))", compiled)
        for child in self._within(node):
            yield from self.faults(child, place, compiled)

    @staticmethod
    def _within(node: ast.AST) -> Iterator[ast.AST]:
        """What is in a node, without annotations and decorators."""
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield child

    def _instead(self, node: ast.expr | ast.stmt) -> Iterator[str]:
        """Texts that may stand instead of a node."""
        match node:
            case ast.Constant(value=bool(value)):
                yield str(not value)
            case ast.Constant(value=int(value)):
                yield str(value + 1)
            case ast.Constant(value=float(value)):
                yield repr(value * (_WIDER if abs(value) >= _SMALL else _COARSER) if value else 1.0)
            case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
                yield f"({self.text(operand)})"
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)):
                function = self.text(node.func)
                if name in _SWAPPED:
                    yield function[: len(function) - len(name)] + _SWAPPED[name] + self.text(node)[len(function):]
                if name in _LEFT_OUT and node.args:
                    yield f"({self.text(node.args[0])})"
            case ast.Expr(value=ast.Call()) | ast.AugAssign() | ast.Continue() | ast.Break() | ast.Raise():
                yield "pass"
            case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]):
                yield "pass"

    def _operators(self, node: ast.expr | ast.stmt, place: str, compiled: bool) -> Iterator[Mutant]:
        """Operators between two operands."""
        pairs: list[tuple[ast.expr, type[ast.AST], ast.expr, dict[type[ast.AST], tuple[str, ...]]]] = []
        match node:
            case ast.BinOp(left=left, op=op, right=right):
                pairs = [(left, type(op), right, _BINARY)]
            case ast.Compare(left=left, ops=ops, comparators=others):
                pairs = [(a, type(op), b, _COMPARED)
                         for a, op, b in zip([left, *others], ops, others, strict=False)]
            case ast.BoolOp(op=op, values=values):
                table: dict[type[ast.AST], tuple[str, ...]] = {ast.And: ("and", "or"), ast.Or: ("or", "and")}
                pairs = [(a, type(op), b, table) for a, b in pairwise(values)]
        begin, end = self.span(node)
        for a, kind, b, table in pairs:
            if kind not in table or isinstance(a, ast.JoinedStr) or isinstance(b, ast.JoinedStr):
                continue
            symbol, *instead = table[kind]
            if symbol in ("<", "<=", ">", ">=") and not (_counted(a) or _counted(b)):
                # Measured values never meet a limit exactly: with and without equality are the same.
                instead = instead[1:]
            gap_begin, gap_end = self.span(a)[1], self.span(b)[0]
            gap = self.source[gap_begin:gap_end]
            where = gap.find(symbol.encode())
            if where < 0:
                continue
            for other in instead:
                raw = (self.source[begin: gap_begin + where] + other.encode()
                       + self.source[gap_begin + where + len(symbol.encode()): end])
                yield Mutant(self.file, place, node.lineno, begin, end, self.text(node), raw.decode(), compiled)


def _counted(node: ast.expr) -> bool:
    """Whether an operand is a whole number."""
    return ((isinstance(node, ast.Constant) and isinstance(node.value, int))
            or (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "len")
            or (isinstance(node, ast.Attribute) and node.attr == "size"))


def _worded(node: ast.AST) -> bool:
    """Texts, what a dataclass shows of itself, and what only the type checker reads."""
    return (isinstance(node, ast.JoinedStr) or (isinstance(node, ast.keyword) and node.arg == "repr")
            or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)))
