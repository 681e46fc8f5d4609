"""UR's RTDE on the wire: packages with a header of size and kind, and recipes that say what a data package holds.

Everything is big-endian. Written from Universal Robots' public description of the Real-Time Data Exchange.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from ideal_robot.rtde.rtde_error import RtdeError

MAX_PACKAGE = 4096
"""Largest package that is read [bytes]; the field names of a recipe have 2048 at most."""
_HEADER = struct.Struct(">HB")
_FORMATS = {"BOOL": "?", "UINT8": "B", "UINT32": "I", "UINT64": "Q", "INT32": "i", "DOUBLE": "d", "VECTOR3D": "3d",
            "VECTOR6D": "6d", "VECTOR6INT32": "6i", "VECTOR6UINT32": "6I"}
_REFUSALS = {"NOT_FOUND": "the controller does not know it", "IN_USE": "another client writes it"}

Value = int | float | bool | tuple[int, ...] | tuple[float, ...]


class Kind(IntEnum):
    """What a package is: the letter of its header."""

    VERSION = ord("V")
    CONTROLLER = ord("v")
    TEXT = ord("M")
    DATA = ord("U")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


def package(kind: Kind, payload: bytes = b"") -> bytes:
    """A package with its header."""
    return _HEADER.pack(_HEADER.size + len(payload), kind) + payload


class Reader:
    """Packages from a stream of bytes, in whatever pieces they come."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, piece: bytes) -> None:
        """What was read from the stream."""
        self._bytes += piece

    def next(self) -> tuple[int, bytes] | None:
        """Kind and payload of the next package; None while it is not whole.

        Raises:
            RtdeError: a size that cannot be: this is no RTDE, or its beginning was lost.
        """
        if len(self._bytes) < _HEADER.size:
            return None
        size, kind = _HEADER.unpack_from(self._bytes)
        if not _HEADER.size <= size <= MAX_PACKAGE:
            raise RtdeError(f"a package of {size} bytes: the other side does not speak RTDE")
        if len(self._bytes) < size:
            return None
        payload = bytes(self._bytes[_HEADER.size : size])
        del self._bytes[:size]
        return int(kind), payload


@dataclass(frozen=True)
class Recipe:
    """What a data package holds.

    Attributes:
        number: the controller's number of the recipe; it stands at the beginning of every data package.
        names: names of the fields.
        layout: how they follow each other.
        counts: how many numbers each field has.
    """

    number: int
    names: tuple[str, ...]
    layout: struct.Struct
    counts: tuple[int, ...]

    @classmethod
    def agreed(cls, names: tuple[str, ...], answer: bytes) -> Recipe:
        """From the controller's answer to a setup: number of the recipe, and the types of the fields.

        Raises:
            RtdeError: a field that is not known or not free, another number of fields, a type that is not known.
        """
        types = answer[1:].decode("ascii", "replace").split(",")
        refused = [f"{name}: {_REFUSALS[kind]}" for name, kind in zip(names, types, strict=False) if kind in _REFUSALS]
        if refused:
            raise RtdeError("; ".join(refused))
        unknown = [kind for kind in types if kind not in _FORMATS]
        if len(types) != len(names) or unknown or not answer or answer[0] == 0:
            raise RtdeError(f"the controller's answer to the fields {', '.join(names)} cannot be used "
                            f"({answer[:80]!a})")
        formats = [_FORMATS[kind] for kind in types]
        counts = tuple(int(text[:-1] or 1) for text in formats)
        return cls(answer[0], names, struct.Struct(">" + "".join(formats)), counts)

    def unpacked(self, payload: bytes) -> dict[str, Value]:
        """Values of a data package by name.

        Raises:
            RtdeError: another recipe, or another length.
        """
        if len(payload) != 1 + self.layout.size or payload[0] != self.number:
            raise RtdeError(f"a data package of {len(payload)} bytes does not fit recipe {self.number}")
        values, found, at = self.layout.unpack_from(payload, 1), {}, 0
        for name, count in zip(self.names, self.counts, strict=True):
            found[name] = values[at] if count == 1 else values[at : at + count]
            at += count
        return found

    def packed(self, *values: float) -> bytes:
        """A data package with the numbers of all fields in a row."""
        return package(Kind.DATA, bytes((self.number,)) + self.layout.pack(*values))


def said(payload: bytes) -> str:
    """What a text message says."""
    length = payload[0] if payload else 0
    text = payload[1 : 1 + length].decode("utf-8", "replace")
    return "".join(letter if letter.isprintable() else " " for letter in text)
