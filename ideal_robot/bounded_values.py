"""Reading text files that others wrote: JSON and TOML within bounds of size, depth, count and magnitude.

The bounds are checked on the text before a parser sees it and on the values before an array is made of them.
"""

from __future__ import annotations

import json
import math
import os
import re
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from ideal_robot.errors import InputError
from ideal_robot.file_limits import JSON_BYTES, JSON_DEPTH, JSON_VALUES, TOML_BYTES, Limit

MAX_NUMBER = 1e15
"""Largest magnitude of a number; nothing that an arm has comes near it in SI units."""

_QUOTED = re.compile(r'"(?:[^"\\\n]++|\\[^\n]?)*+"?|\'[^\'\n]*+\'?')
"""A text in quotes, or the rest of a line whose quote never closes: whatever is read, each place is looked at once."""
_MANY_PARTS = re.compile(rf"(?<![\w\"'.-])(?:[\w\"'-]++\s*+\.\s*+){{{10 * JSON_DEPTH.most},}}")
"""A key of very many parts; it begins where a word begins, or long words would be looked at again and again."""


def read_text(path: Path, what: str, limit: Limit = JSON_BYTES) -> str:
    """The text of a UTF-8 file.

    Args:
        path: the file.
        what: what it should be, for the message, e.g. ``"a model file"``.
        limit: of its size.

    Raises:
        InputError: not a plain file, larger than ``limit``, not UTF-8.
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
    """The checked values of a JSON text.

    Args:
        text: of any length.
        file: where it stands, for the message.
        what: what it should be, for the message, e.g. ``"a model file"``.

    Raises:
        InputError: not JSON, or beyond the bounds, see ``checked``.
    """
    _few_and_shallow(text, file, what)
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not a readable {what.removeprefix('a ')} ({_short(error)})", file=file) from error
    return checked(values, file)


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """The checked values of a TOML file; raises InputError as ``read_text`` and ``checked`` do."""
    text = read_text(path, what, limit=TOML_BYTES)
    _few_and_shallow(text, path, what)
    if _MANY_PARTS.search(text):
        raise InputError(f"a key of more than {JSON_DEPTH.most} parts", file=path)
    try:
        values = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not a readable {what.removeprefix('a ')} ({_short(error)})", file=path) from error
    table: dict[str, Any] = checked(values, path)
    return table


def checked(values: Any, file: str | Path | None = None) -> Any:
    """The same values, if they are finite numbers, texts, truth values, lists and tables within the bounds.

    Raises:
        InputError: not finite, larger than ``MAX_NUMBER``, too deep, too many; names the key where it is one value.
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
    # Every value but the first comes after a comma or is the first of its list or table.
    JSON_VALUES.check(bare.count(",") + bare.count("[") + bare.count("{"), file)
    depth = 0
    for bracket in re.finditer(r"[\[{\]}]", bare):
        depth += 1 if bracket.group() in "[{" else -1
        # Quotes that never close hide brackets or show too many; the parser itself names those.
        if depth > 20 * JSON_DEPTH.most:
            raise InputError(f"nested deeper than {JSON_DEPTH.most}; is this {what}?", file=file)


def _short(error: BaseException) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__


@contextmanager
def kept_words() -> Iterator[IO[bytes]]:
    """Yields the file that gets what is written to standard error, below Python, while the block runs."""
    sys.stderr.flush()
    with tempfile.TemporaryFile() as said:
        before = os.dup(2)
        os.dup2(said.fileno(), 2)
        try:
            yield said
        finally:
            os.dup2(before, 2)
            os.close(before)
