"""The wire format of our own stream: packages with stamps over TCP, and a parser that nothing can make grow.

All numbers are big-endian. A package is a header of 16 bytes and its payload:

====== ======== =========================================================================================
offset type     meaning
====== ======== =========================================================================================
0      2 bytes  ``IR``
2      uint8    version, 1
3      uint8    kind
4      uint32   bytes of payload, at most 4 MiB
8      float64  stamp by the sender's clock [s]: mid-exposure, instant of measurement, or of sending
====== ======== =========================================================================================

====== ========== =============== =============================================================================
kind   name       from            payload
====== ========== =============== =============================================================================
1      camera     device          uint16 width, uint16 height, float64 rate [Hz], float64 × 9 camera matrix row by
                                  row, float64 × 5 distortion k1 k2 p1 p2 k3; NaN where not known
2      field      device          uint32 number, uint16 width, uint16 height, gray values row by row, uint8
3      sensor     device          float64 rate [Hz]
4      wrench     device          uint32 number, float64 × 6: force [N] and moment [N m]
5      ask        client          float64, anything; the device answers at once
6      told       device          the same 8 bytes; the stamp is the device's clock when it answered
====== ========== =============== =============================================================================

A device sends what it is (1 or 3) first, then fields or wrenches as they come. Other kinds are passed over. With ask
and told the client finds how the clocks relate without knowing any delay: half of the way there and back. The device
has to send small packages at once (``TCP_NODELAY``).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

from sensing.sensing_error import SensingError

HEADER = struct.Struct(">2sBBId")
MAGIC, VERSION = b"IR", 1
LARGEST = 4 << 20
"""Bytes of payload that are taken at most."""


class StreamError(SensingError):
    """What came over the socket is no stream of ours, or the connection is broken."""


class Kind(IntEnum):
    """Kinds of packages."""

    CAMERA = 1
    FIELD = 2
    SENSOR = 3
    WRENCH = 4
    ASK = 5
    TOLD = 6


@dataclass(frozen=True)
class Package:
    """One package.

    Attributes:
        kind: see the table.
        stamp: by the sender's clock [s].
        payload: as it came.
    """

    kind: int
    stamp: float
    payload: bytes


def packed(kind: Kind, stamp: float, payload: bytes = b"") -> bytes:
    """A package as it goes over the wire.

    Args:
        kind: what it is.
        stamp: by the sender's clock [s].
        payload: see the table above.
    """
    return HEADER.pack(MAGIC, VERSION, kind, len(payload), stamp) + payload


class Reader:
    """Cuts what arrives into packages; holds one package and the rest of a read at most."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def feed(self, piece: bytes) -> Iterator[Package]:
        """The packages that are complete with this piece.

        Raises:
            StreamError: behind those that are sound: not our stream, another version, or a package too large. The
                connection is of no use then.
        """
        self._waiting += piece
        while len(self._waiting) >= HEADER.size:
            magic, version, kind, size, stamp = HEADER.unpack_from(self._waiting)
            if magic != MAGIC or version != VERSION:
                raise StreamError("what arrives is no stream of version 1 (see docs/follow.md)")
            if size > LARGEST:
                raise StreamError(f"a package of {size} bytes, at most {LARGEST} are taken")
            if len(self._waiting) < HEADER.size + size:
                break
            payload = bytes(self._waiting[HEADER.size : HEADER.size + size])
            del self._waiting[: HEADER.size + size]
            yield Package(kind, stamp, payload)
