"""The first path of an .svg file beside a scene; nothing else of the file is used and nothing it names is fetched."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

from ideal_robot.bounded_values import read_text
from ideal_robot.errors import InputError

MAX_BYTES = 5_000_000
"""Largest SVG file [bytes]."""
MAX_PATH = 200_000
"""Longest ``d`` of a path [characters]."""
MAX_SEGMENTS = 5_000
"""Most segments of a path."""
MAX_DEPTH = 100
"""Deepest nesting of groups."""


def first_path(name: str, folder: Path) -> Any:
    """The first path of an .svg file.

    Args:
        name: of the file, relative to ``folder`` and not outside it.
        folder: of the scene.

    Raises:
        InputError: outside the folder, missing, too large, with entities, or without a path.
    """
    file = folder / name
    try:
        inside = file.resolve().is_relative_to(folder.resolve())
        there = file.is_file()
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError("not a usable file name", field="line.svg", value=name[:60]) from error
    if not inside:
        raise InputError("the SVG file must lie beside the scene or below; copy it there", field="line.svg",
                         value=name[:60])
    if not there:
        raise InputError("no such SVG file", field="line.svg", value=name[:60])
    text = read_text(file, "an SVG file", limit=MAX_BYTES)
    if "<!ENTITY" in text:
        raise InputError("declares entities, which are not read; save it without them", file=file)
    try:
        d = _first_d(text, file)
        if d is not None:
            return parsed_path(d)
        # No path element: svgpathtools makes paths of lines, polygons and ellipses.
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
    depth = 0
    for start in range(0, len(text), 20_000):
        reader.feed(text[start : start + 20_000])
        for event, element in reader.read_events():
            depth += 1 if event == "start" else -1
            if depth > MAX_DEPTH:
                raise InputError(f"groups nested deeper than {MAX_DEPTH}", file=file)
            if event == "start" and element.tag.rpartition("}")[2] == "path":
                return str(element.get("d", ""))
    reader.close()
    return None


def parsed_path(d: str) -> Any:
    """The path of a ``d`` attribute, as svgpathtools has it.

    Raises:
        InputError: broken, or longer than ``MAX_PATH`` and ``MAX_SEGMENTS``.
    """
    if len(d) > MAX_PATH:
        raise InputError(f"SVG path longer than {MAX_PATH} characters", field="line.svg", value=d[:30])
    import svgpathtools

    try:
        path = svgpathtools.parse_path(d)
    except Exception as error:  # svgpathtools raises whatever its tokens lead to
        raise InputError(f"broken SVG path ({type(error).__name__}: {error})", field="line.svg",
                         value=d[:60]) from error
    if len(path) > MAX_SEGMENTS:
        raise InputError(f"SVG path of more than {MAX_SEGMENTS} pieces", field="line.svg", value=d[:30])
    return path
