"""Packets as a hostile or broken network makes them, from a sound one: the same for the same generator."""

from __future__ import annotations

import numpy as np

_PIECES = (b"<", b">", b"/>", b"</Rob>", b"<Rob>", b"<a>", b"<!--", b"-->", b"<![CDATA[", b"<!DOCTYPE a [", b"&amp;",
           b"\0", b"\xff\xfe", b"nan", b"inf", b"1e308", b"-1e999", b'"', b"=", b"A1", b"IPOC", b"9" * 30, b" " * 500)


def mutated(packet: bytes, rng: np.random.Generator) -> bytes:
    """One to four changes: bytes flipped, cut, doubled, or pieces of XML put in."""
    data = bytearray(packet)
    for _ in range(int(rng.integers(1, 5))):
        at, length = int(rng.integers(0, len(data) + 1)), int(rng.integers(1, 40))
        kind = int(rng.integers(0, 5))
        if kind == 0 and at < len(data):
            data[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            del data[at : at + length]
        elif kind == 2:
            data[at:at] = data[at : at + length]
        elif kind == 3:
            data[at:at] = _PIECES[int(rng.integers(0, len(_PIECES)))]
        else:
            data[at:at] = rng.bytes(length)
    return bytes(data)
