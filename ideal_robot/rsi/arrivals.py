"""When a packet came, by the system's word: a program that was not let run meanwhile does not take it for late."""

from __future__ import annotations

import socket
import struct
import sys
import time
from typing import Any

_TIMESTAMP = 35
"""``SO_TIMESTAMPNS`` of Linux, which Python does not name."""
_STAMPED = sys.platform.startswith("linux")


def stamp_arrivals(link: socket.socket) -> None:
    """From now on the system notes when each packet comes, where it can."""
    if _STAMPED:
        link.setsockopt(socket.SOL_SOCKET, _TIMESTAMP, 1)


def received(link: socket.socket, size: int = 4096) -> tuple[bytes, Any, float]:
    """A packet, its sender, and when it came, by ``time.perf_counter`` [s]; raises as ``recvfrom`` does.

    Args:
        link: after ``stamp_arrivals``; otherwise what counts is when the packet is read.
        size: largest packet [bytes].
    """
    if not _STAMPED:
        return *link.recvfrom(size), time.perf_counter()
    packet, extra, _, sender = link.recvmsg(size, 64)
    now, wall = time.perf_counter(), time.time()
    for level, kind, data in extra:
        if (level, kind) == (socket.SOL_SOCKET, _TIMESTAMP):
            seconds, nanoseconds = struct.unpack("@ll", data[: struct.calcsize("@ll")])
            # A clock that was set meanwhile must not make it come before it was sent, nor in the future.
            return packet, sender, now - min(max(wall - (seconds + 1e-9 * nanoseconds), 0.0), 1.0)
    return packet, sender, now
