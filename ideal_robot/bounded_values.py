"""Reads foreign files within bounds: the table of limits for all files, and readers of JSON and TOML.

Small files can unfold to large ones: a chunk of zeros, a row of a million commas, a list of empty lists. So a reader
counts the content before it allocates memory, in the packed file or piece by piece, and refuses more than these limits
(docs/security.md).
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

from ideal_robot.errors import InputError


class Limit(NamedTuple):
    """A row of the table of limits: at most ``most`` of ``what``, and ``why`` that is enough."""

    most: int
    what: str
    why: str

    def check(self, count: float, file: str | Path | None, remedy: str = "") -> None:
        """Raises InputError for a ``count`` above the limit.

        Args:
            count: number that a file holds or claims to hold.
            file, remedy: for the message.
        """
        if count > self.most:
            raise InputError(f"holds {count:.0f} {self.what}; at most {self.most} are read"
                             + (f": {remedy}" if remedy else ""), file=file)


JSON_BYTES = Limit(50_000_000, "bytes of a model or another JSON file", "a model of 30 joints takes 2 MB")
JSON_VALUES = Limit(2_000_000, "values of a JSON or TOML file", "they take 0.2 GB and ten seconds")
JSON_DEPTH = Limit(30, "levels of lists and tables", "models have five")
TOML_BYTES = Limit(2_000_000, "bytes of a scene or drive data", "the longest shipped one has 2 kB")
URDF_BYTES = Limit(20_000_000, "bytes of a URDF", "shipped ones have up to 12 kB")
URDF_ELEMENTS = Limit(20_000, "elements of a URDF", "shipped ones have up to 295")
URDF_DEPTH = Limit(30, "levels of a URDF", "a URDF has five")
URDF_JOINTS = Limit(40, "moving joints", "identification's matrices grow with their square")
SVG_BYTES = Limit(5_000_000, "bytes of an SVG file", "a path of 200,000 characters is the longest read")
SVG_ELEMENTS = Limit(50_000, "elements of an SVG file before its path", "without a path they take two seconds")
SVG_DEPTH = Limit(100, "levels of an SVG file", "groups of groups of a drawing program")
RSI_BYTES = Limit(65_536, "bytes of an RSI configuration", "a controller's has two to six thousand")
TABLE_VALUES = Limit(400_000_000, "values of a table", "four hours of 50 columns at 500 Hz, 3.2 GB on the disk")
TABLE_COLUMNS = Limit(5_000, "columns of a table", "a recording of six joints has up to 80")
TABLE_LINE = Limit(1_000_000, "bytes of a line of a CSV file", "5,000 columns of 25 characters take 125 kB")
TABLE_WORDS = Limit(20_000_000, "bytes of a recording's metadata", "a model within takes 2 MB")
TABLE_UNFOLDING = Limit(50, "times the size of a Parquet file, beyond 160 MB",
                        "columns of zeros take nothing, times and positions do not compress")
BAG_UNFOLDING = Limit(20, "times the size of a bag, beyond 64 MB", "500,000 messages of a joint pass in any case")
BAG_MESSAGE = Limit(100_000, "bytes of a message of joint states, or of a definition", "30 joints take 2 kB")
BAG_WORDS = Limit(1_000_000, "bytes of a bag's metadata.yaml", "a topic takes half a kilobyte")
PICTURE_PIXELS = Limit(64_000_000, "pixels of a picture", "8000 × 8000")
REPLAY_BYTES = Limit(200_000_000, "bytes of an unpacked replay", "that of a shipped line takes 0.4 MB")
ALL = tuple(value for value in list(globals().values()) if isinstance(value, Limit))
_FREE = {TABLE_UNFOLDING: 160_000_000, BAG_UNFOLDING: 64_000_000}  # free amounts, as the texts of these limits say


def check_unfolding(limit: Limit, unpacked: float, packed: float, file: Path) -> None:
    """Raises InputError for a file that unpacks to far more than its size.

    Args:
        limit: ``TABLE_UNFOLDING`` or ``BAG_UNFOLDING``.
        unpacked, packed: unpacked and packed size [bytes].
        file: for the message.
    """
    if unpacked > _FREE[limit] + limit.most * packed:
        raise InputError(f"unfolds to more than {_FREE[limit] / 1e6:.0f} MB and {limit.most} times its size; write it "
                         "without compression, or cut it into pieces", file=file)


# JSON and TOML: checked on the text before a parser sees it, and on the values before an array is made of them.

MAX_NUMBER = 1e15
"""Largest magnitude of a number; nothing that an arm has comes near it in SI units."""

_QUOTED = re.compile(r'"(?:[^"\\\n]++|\\[^\n]?)*+"?|\'[^\'\n]*+\'?')
"""A text in quotes, or the rest of a line whose quote never closes: whatever is read, each place is looked at once."""
_MANY_PARTS = re.compile(rf"(?<![\w\"'.-])(?:[\w\"'-]++\s*+\.\s*+){{{10 * JSON_DEPTH.most},}}")
"""A key of very many parts; it begins where a word begins, or long words would be looked at again and again."""


def read_text(path: Path, what: str, limit: Limit = JSON_BYTES) -> str:
    """The text of a UTF-8 file; raises InputError if it is no plain file, too large, or not UTF-8.

    Args:
        path: the file.
        what: expected kind of file, for the message, e.g. ``"a model file"``.
        limit: of its size.
    """
    try:
        if not path.is_file():
            raise InputError(f"no such file; expected {what}", file=path)
        if path.stat().st_size > limit.most:
            raise InputError(f"larger than {limit.most / 1e6:.3g} MB; is this {what}?", file=path)
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read as {what} ({_short(error)})", file=path) from error


def read_json(path: Path, what: str) -> Any:
    """The checked values of a JSON file; raises InputError as ``read_text`` and ``parsed_json`` do."""
    return parsed_json(read_text(path, what), path, what)


def parsed_json(text: str, file: str | Path | None, what: str) -> Any:
    """The checked values of a JSON text; raises InputError if it is none, or beyond the bounds, see ``checked``.

    Args:
        text: of any length.
        file, what: its file, and the expected kind (``"a model file"``), for the message.
    """
    _few_and_shallow(text, file, what)
    return _parsed(json.loads, text, file, what)


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """The checked values of a TOML file; raises InputError as ``read_text`` and ``checked`` do."""
    text = read_text(path, what, limit=TOML_BYTES)
    _few_and_shallow(text, path, what)
    if _MANY_PARTS.search(text):
        raise InputError(f"a key of more than {JSON_DEPTH.most} parts", file=path)
    table: dict[str, Any] = _parsed(tomllib.loads, text, path, what)
    return table


def _parsed(loads: Callable[[str], Any], text: str, file: str | Path | None, what: str) -> Any:
    try:
        values = loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not a readable {what.removeprefix('a ')} ({_short(error)})", file=file) from error
    return checked(values, file)


def checked(values: Any, file: str | Path | None = None) -> Any:
    """The same values, if they are finite numbers, texts, truth values, lists and tables within the bounds.

    Raises InputError, which names the key where one value is not finite or larger than ``MAX_NUMBER``.
    """
    todo: list[tuple[_Path, Any, int]] = [((), values, 0)]
    count = 0
    while todo:
        path, value, depth = todo.pop()
        count += 1
        JSON_VALUES.check(count, file)
        if depth > JSON_DEPTH.most:
            raise InputError(f"nested deeper than {JSON_DEPTH.most}", file=file, field=_key(path))
        if isinstance(value, dict):
            todo.extend(((path, name), item, depth + 1) for name, item in value.items())
        elif isinstance(value, (list, tuple)):
            todo.extend(((path, i), item, depth + 1) for i, item in enumerate(value))
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            _number(value, path, file)
    return values


_Path = tuple[Any, ...]
"""Way to a value: that of what holds it, and its name there; words are made of it for a message alone."""


def _key(path: _Path) -> str:
    names: list[str] = []
    while path:
        path, name = path
        names.append(str(name)[:60])
    return ".".join(reversed(names))[:60]


def _number(value: float, path: _Path, file: str | Path | None) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise InputError("expected a finite number", file=file, field=_key(path), value=value)
    if abs(value) > MAX_NUMBER:
        raise InputError(f"larger than {MAX_NUMBER:g}; is the unit right?", file=file, field=_key(path),
                         value=value if isinstance(value, float) else f"{str(value)[:20]}…")


def _few_and_shallow(text: str, file: str | Path | None, what: str) -> None:
    """Refuses what a parser would need too much memory or too deep a stack for, by signs outside quotes."""
    bare = _QUOTED.sub("", text)
    # Each value but the first follows a comma or begins a list or table, so these are counted.
    JSON_VALUES.check(bare.count(",") + bare.count("[") + bare.count("{"), file)
    depth = 0
    for bracket in re.finditer(r"[\[{\]}]", bare):
        depth += 1 if bracket.group() in "[{" else -1
        # Unclosed quotes hide brackets or show too many; the parser itself reports those.
        if depth > 20 * JSON_DEPTH.most:
            raise InputError(f"nested deeper than {JSON_DEPTH.most}; is this {what}?", file=file)


def _short(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


@contextmanager
def kept_words() -> Iterator[IO[bytes]]:
    """Yields a temporary file that collects the standard error of the process, libraries included, within the block."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as stream:
        before = os.dup(2)
        os.dup2(stream.fileno(), 2)
        try:
            yield stream
        finally:
            os.dup2(before, 2)
            os.close(before)
