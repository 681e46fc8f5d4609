"""Ways in which a text file (TOML, JSON, URDF, CSV, SVG) comes to be broken."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

NUMBER = re.compile(rb"(?<![\w.])-?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
WORD = re.compile(rb"[A-Za-z_][A-Za-z_0-9]{2,}")
VALUES = (b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-320", b"0", b"-1", b"1", b"99999", b"-0.5", b"1e9",
          b"true", b"null", b"None", b'"x"', b"[]", b"{}", b"[1]", b"[[]]", b"''", b"9" * 400, b"1e999",
          b"0x10", b"1_0", b"")
"""What a number is replaced by."""
JUNK = (b"\0", b"\xff\xfe", b"\r", b"[/red]", b"<!--", b"../", b"\x1b[31m", "\u202e".encode(), b"[" * 5000, b"{" * 5000,
        b'"', b"'", b"&a;", b"<![CDATA[", b"\n\n", b"," * 50, b"a." * 3000, b"%n%s", b"(" * 3000)
"""What is put anywhere."""


def _number(text: bytes, rng: np.random.Generator) -> bytes:
    found = list(NUMBER.finditer(text))
    if not found:
        return text
    one = found[rng.integers(len(found))]
    return text[: one.start()] + VALUES[rng.integers(len(VALUES))] + text[one.end():]


def _scaled(text: bytes, rng: np.random.Generator) -> bytes:
    found = list(NUMBER.finditer(text))
    if not found:
        return text
    one = found[rng.integers(len(found))]
    factor = rng.choice([-1.0, 1e-9, 1e-3, 0.5, 2.0, 1e3, 1e6, 1e12])
    return text[: one.start()] + repr(float(one.group()) * float(factor)).encode() + text[one.end():]


def _word(text: bytes, rng: np.random.Generator) -> bytes:
    found = list(WORD.finditer(text))
    if len(found) < 2:
        return text
    one, other = found[rng.integers(len(found))], found[rng.integers(len(found))]
    return text[: one.start()] + other.group() + text[one.end():]


def _line(text: bytes, rng: np.random.Generator) -> bytes:
    lines = text.split(b"\n")
    k = int(rng.integers(len(lines)))
    what = rng.integers(3)
    if what == 0:
        del lines[k]
    elif what == 1:
        lines.insert(int(rng.integers(len(lines) + 1)), lines[k])
    else:
        other = int(rng.integers(len(lines)))
        lines[k], lines[other] = lines[other], lines[k]
    return b"\n".join(lines)


def flipped(text: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(text)
    for _ in range(int(rng.integers(1, 8))):
        if changed:
            changed[int(rng.integers(len(changed)))] = int(rng.integers(256))
    return bytes(changed)


def _junk(text: bytes, rng: np.random.Generator) -> bytes:
    k = int(rng.integers(len(text) + 1))
    return text[:k] + JUNK[rng.integers(len(JUNK))] + text[k:]


def _cut(text: bytes, rng: np.random.Generator) -> bytes:
    k, m = sorted(int(k) for k in rng.integers(0, len(text) + 1, 2))
    return text[:k] if rng.random() < 0.5 else text[:k] + text[m:]


def _emptied(text: bytes, rng: np.random.Generator) -> bytes:
    return (b"", b"\n", b"{}", b"[]", b"null", b"\0" * 100)[rng.integers(6)]


MUTATIONS: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    _number, _number, _number, _scaled, _scaled, _word, _line, _line, flipped, _junk, _cut, _emptied)


def mutated(text: bytes, rng: np.random.Generator) -> bytes:
    """The text with one to three things broken."""
    for _ in range(int(rng.integers(1, 4))):
        text = MUTATIONS[rng.integers(len(MUTATIONS))](text, rng)
    return text
