"""The shape of a line in its own plane, as a person writes it: a formula, a list of points, or an SVG path."""

from __future__ import annotations

import ast
import io
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

import numpy as np
import pydantic
from scipy.interpolate import CubicSpline

from ideal_robot.arrays import Array, arc_lengths, interpolated
from ideal_robot.bounded_values import SVG_BYTES, SVG_DEPTH, SVG_ELEMENTS, read_text
from ideal_robot.errors import InputError
from scenes.scene_files.scene import Table

# A curve's height as a formula of ``x``: Python's own syntax, of which a short list is allowed.
#
# Without attributes, subscripts, strings and calls of anything but the functions below, an expression can only compute.

MAX_LENGTH = 500
"""Longest formula [characters]."""
FUNCTIONS: dict[str, Callable[..., Any]] = {
    name: getattr(np, name) for name in (
        "sin", "cos", "tan", "arcsin", "arccos", "arctan", "sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh",
        "sqrt", "exp", "expm1", "log", "log10", "log1p", "abs", "floor", "ceil", "sign", "arctan2", "minimum",
        "maximum", "where")}
"""Functions that a formula may call."""
NAMES = {"pi": np.pi, "e": np.e}
"""Names that a formula may hold besides ``x``."""
_ALLOWED = (ast.Expression, ast.Constant, ast.Name, ast.Load, ast.UnaryOp, ast.UAdd, ast.USub, ast.BinOp, ast.Add,
            ast.Sub, ast.Mult, ast.Div, ast.Mod, ast.Pow, ast.Compare, ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Call)


class _Checked(ast.NodeTransformer):
    """Raises ValueError for what is not allowed; makes floats of numbers, so that none grows, and of comparisons."""

    def visit(self, node: ast.AST) -> Any:
        """Checks a node and all below it."""
        if not isinstance(node, _ALLOWED):
            raise ValueError(f"{type(node).__name__} is not allowed")
        return super().visit(node)

    def visit_Constant(self, node: ast.Constant) -> Any:
        """A number as a float."""
        if type(node.value) not in (int, float):
            raise ValueError("only numbers are permitted as constants")
        return ast.Constant(float(node.value))  # type: ignore[arg-type]

    def visit_Name(self, node: ast.Name) -> Any:
        """``x`` or one of ``NAMES``."""
        if node.id != "x" and node.id not in NAMES:
            raise ValueError(f"unknown name {node.id}; known are x, {', '.join(NAMES)}")
        return node

    def visit_Call(self, node: ast.Call) -> Any:
        """A call of one of ``FUNCTIONS`` with as many values as it takes: one more would be where it writes to."""
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name not in FUNCTIONS:
            raise ValueError(f"unknown function; known are {', '.join(FUNCTIONS)}")
        count = getattr(FUNCTIONS[name], "nin", 3)
        if node.keywords or len(node.args) != count:
            raise ValueError(f"{name} takes {count} value{'s' if count > 1 else ''}")
        return ast.Call(node.func, [self.visit(argument) for argument in node.args], [])

    def visit_Compare(self, node: ast.Compare) -> Any:
        """0.0 or 1.0, so that steps can be added up."""
        return ast.BinOp(ast.Constant(1.0), ast.Mult(), self.generic_visit(node))  # type: ignore[arg-type]


def evaluated(formula: str, x: Array) -> Array:
    """The formula's values at every ``x``: ``(N,)``, finite.

    Args:
        formula: an expression of ``x``, ``pi``, ``e``, numbers, ``+ - * / % **``, comparisons and ``FUNCTIONS``.
        x: arguments of the function ``(N,)``.

    Raises:
        InputError: anything else in it, too long, too deep, or not finite somewhere.

    >>> evaluated("0.04*sin(2*pi*x/0.8)", np.array([0.0, 0.2]))
    array([0.  , 0.04])
    """
    shown = formula if len(formula) <= 60 else formula[:57] + "..."
    names = {**FUNCTIONS, **NAMES, "x": x, "__builtins__": {}}
    try:
        # Python normalises look-alike letters, so only ASCII is accepted.
        if len(formula) > MAX_LENGTH or not formula.isascii() or not formula.isprintable():
            raise ValueError(f"longer than {MAX_LENGTH} characters, or of other than plain ones")
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            tree = ast.fix_missing_locations(_Checked().visit(ast.parse(formula.strip(), mode="eval")))
            y = np.asarray(eval(compile(tree, "formula", "eval"), names))
        finite = bool(np.isrealobj(y) and np.isfinite(y).all())
    except (OverflowError, ZeroDivisionError):
        finite = False
    except (SyntaxError, TypeError, ValueError, RecursionError, MemoryError) as error:
        reason = getattr(error, "msg", None) or str(error) or type(error).__name__
        raise InputError(f"cannot be evaluated: {reason}; expected y [m] of x [m], e.g. 0.04*sin(2*pi*x/0.8)",
                         field="line.formula", value=shown) from error
    if not finite:
        raise InputError("is not finite over the whole length", field="line.formula", value=shown)
    return np.broadcast_to(y, x.shape)


MAX_PATH = 200_000
"""Longest ``d`` of a path [characters]."""
MAX_SEGMENTS = 5_000
"""Most segments of a path."""


def first_path(name: str, folder: Path) -> Any:
    """The first path of an .svg file, whose name is relative to the scene's folder and not outside it.

    Raises:
        InputError: outside the folder, missing, too large, with entities, or without a path.
    """
    file = folder / name
    try:
        inside = file.resolve().is_relative_to(folder.resolve())
        exists = file.is_file()
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError("not a usable file name", field="line.svg", value=name[:60]) from error
    if not inside:
        raise InputError("the SVG file must lie beside the scene or below; copy it there", field="line.svg",
                         value=name[:60])
    if not exists:
        raise InputError("no such SVG file", field="line.svg", value=name[:60])
    text = read_text(file, "an SVG file", limit=SVG_BYTES)
    if "<!ENTITY" in text:
        raise InputError("declares entities, which are not read; save it without them", file=file)
    try:
        d = _first_d(text, file)
        if d is not None:
            return parsed_path(d)
        # The file has no path element, but svgpathtools converts lines, polygons and ellipses to paths.
        import svgpathtools

        paths, _ = svgpathtools.svg2paths(io.StringIO(text))
    except (ET.ParseError, ExpatError, ValueError, KeyError, IndexError, RecursionError) as error:
        raise InputError(f"not a readable SVG file ({type(error).__name__}: {error})", file=file) from error
    if not paths:
        raise InputError("the SVG has no path", file=file)
    return paths[0]


def _first_d(text: str, file: Path) -> str | None:
    """``d`` of the first path element; read in pieces, so that deep nesting is refused before a tree is made of it."""
    reader: Any = ET.XMLPullParser(events=("start", "end"))
    depth = count = 0
    for start in range(0, len(text), 20_000):
        reader.feed(text[start : start + 20_000])
        for event, element in reader.read_events():
            depth, count = (depth + 1, count + 1) if event == "start" else (depth - 1, count)
            SVG_DEPTH.check(depth, file)
            SVG_ELEMENTS.check(count, file)
            if event == "start" and element.tag.rpartition("}")[2] == "path":
                return str(element.get("d", ""))
    reader.close()
    return None


def parsed_path(d: str) -> Any:
    """The path of a ``d`` attribute, as svgpathtools has it; InputError for a broken or too long one."""
    if len(d) > MAX_PATH:
        raise InputError(f"SVG path longer than {MAX_PATH} characters", field="line.svg", value=d[:30])
    import svgpathtools

    try:
        path = svgpathtools.parse_path(d)
    except Exception as error:  # svgpathtools raises exceptions of many types
        raise InputError(f"broken SVG path ({type(error).__name__}: {error})", field="line.svg",
                         value=d[:60]) from error
    if len(path) > MAX_SEGMENTS:
        raise InputError(f"SVG path of more than {MAX_SEGMENTS} pieces", field="line.svg", value=d[:30])
    return path


STEP = 0.0005
"""Spacing of the points that stand for the curve [m]; far below what a camera resolves."""

LONGEST = 100.0
"""Longest curve [m]: no arm follows more, and a slip of units must not fill the memory."""


class Shape(Table):
    """One of ``formula`` (y [m] as a function of x [m], with ``length``), ``points`` or ``svg``."""

    formula: str | None = None
    """y [m] of x [m], e.g. ``0.04*sin(2*pi*x/0.8)``, for x from 0 to ``length``."""
    length: float | None = pydantic.Field(default=None, gt=0, le=10)
    points: list[tuple[float, float]] | None = None
    """Corner points [m], joined by straight pieces with corners rounded by ``corner_radius``."""
    corner_radius: float = pydantic.Field(default=0.0, ge=0)
    svg: str | None = None
    """The ``d`` of an SVG path, or the path of an .svg file, whose first path is taken; y points down as in SVG."""
    svg_length: float | None = pydantic.Field(default=None, gt=0, le=10)
    """Length the SVG path is scaled to [m]; without it one SVG unit is one millimetre."""

    @pydantic.model_validator(mode="after")
    def _one_of(self) -> Shape:
        keys = [key for key in ("formula", "points", "svg") if getattr(self, key) is not None]
        if len(keys) != 1:
            raise ValueError(f"expected exactly one of formula, points and svg, got {', '.join(keys) or 'none'}")
        if self.formula is not None and self.length is None:
            raise ValueError("a formula needs length [m], the range of x")
        for key, of in (("length", "formula"), ("corner_radius", "points"), ("svg_length", "svg")):
            if getattr(self, key) and of != keys[0]:
                raise ValueError(f"{key} belongs to {of}, not to {keys[0]}; leave it out")
        return self

    def curve(self, folder: Path | None = None) -> Array:
        """Points of the curve every half millimetre of arc length, shape ``(N, 2)`` [m], starting at the origin.

        Raises:
            InputError: the formula cannot be evaluated, the SVG is broken, or the curve has no length.
        """
        if self.formula is not None:
            raw = _formula(self.formula, float(self.length or 0.0))
        elif self.points is not None:
            raw = _rounded(np.array(self.points, dtype=float), self.corner_radius)
        else:
            raw = _svg(str(self.svg), self.svg_length, folder)
        return _even(raw - raw[0])


def _formula(formula: str, length: float) -> Array:
    x = np.linspace(0.0, length, max(int(length / STEP), 200) + 1)
    return np.column_stack([x, evaluated(formula, x)])


def _rounded(corners: Array, radius: float) -> Array:
    """Straight pieces joined by circular arcs of ``radius`` (0: sharp corners)."""
    if len(corners) < 2 or np.any(np.linalg.norm(np.diff(corners, axis=0), axis=1) < 1e-6):
        raise InputError("expected at least two different points, none repeated", field="line.points")
    if radius <= 0:
        return corners
    pieces = [corners[:1]]
    for before, corner, after in zip(corners[:-2], corners[1:-1], corners[2:], strict=True):
        u = (before - corner) / np.linalg.norm(before - corner)
        v = (after - corner) / np.linalg.norm(after - corner)
        half = 0.5 * np.arccos(np.clip(u @ v, -1.0, 1.0))
        if half > np.pi / 2 - 1e-6:
            continue
        tangent = radius / np.tan(half)
        if tangent > 0.5 * min(np.linalg.norm(before - corner), np.linalg.norm(after - corner)) + 1e-12:
            raise InputError("the corners are too close for this radius", field="line.corner_radius", value=radius)
        centre = corner + (u + v) / np.linalg.norm(u + v) * radius / np.sin(half)
        start, end = corner + tangent * u - centre, corner + tangent * v - centre
        sweep = np.arctan2(start[0] * end[1] - start[1] * end[0], start @ end)
        angles = np.linspace(0.0, sweep, 60)
        pieces.append(centre + np.column_stack([np.cos(angles) * start[0] - np.sin(angles) * start[1],
                                                np.sin(angles) * start[0] + np.cos(angles) * start[1]]))
    pieces.append(corners[-1:])
    return np.vstack(pieces)


def _svg(svg: str, length: float | None, folder: Path | None) -> Array:
    import svgpathtools

    path: Any = first_path(svg, folder or Path.cwd()) if svg.endswith(".svg") else parsed_path(svg)
    if len(path) == 0:
        raise InputError("broken SVG path: it draws nothing", field="line.svg", value=svg[:60])
    if not path.iscontinuous():
        raise InputError("the SVG path has several parts; give one that is drawn without lifting the pen",
                         field="line.svg", value=svg[:60])
    fine = np.concatenate([segment.points(np.linspace(0.0, 1.0, 400)) if hasattr(segment, "points") and
                           not isinstance(segment, svgpathtools.Arc)
                           else np.array([segment.point(u) for u in np.linspace(0.0, 1.0, 400)]) for segment in path])
    xy = np.column_stack([fine.real, -fine.imag])
    total = float(np.sum(np.linalg.norm(np.diff(xy, axis=0), axis=1)))
    if not np.isfinite(total) or total <= 0:
        raise InputError("broken SVG path: it has no length", field="line.svg", value=svg[:60])
    return xy * (length / total if length else 1e-3)


def _even(raw: Array) -> Array:
    """The curve at even steps of arc length."""
    raw = raw[np.concatenate([[True], np.linalg.norm(np.diff(raw, axis=0), axis=1) > 1e-9])]
    s = arc_lengths(raw)
    if len(raw) < 2 or s[-1] < 20 * STEP:
        raise InputError("the line is shorter than 10 mm", field="line", value=float(s[-1]) if len(s) else 0.0)
    if not s[-1] <= LONGEST:
        raise InputError(f"the line is longer than {LONGEST:g} m; is the unit right?", field="line", value=float(s[-1]))
    even = np.linspace(0.0, s[-1], round(s[-1] / STEP) + 1)
    # Curves with few points are polygons and stay linear; finely sampled ones get a spline.
    if len(raw) > 300:
        return np.asarray(CubicSpline(s, raw)(even), dtype=float)
    return interpolated(even, s, raw)
