"""A force sensor behind our own stream, for sensors that some machine with a socket reads."""

from __future__ import annotations

import struct

import numpy as np

from sensing.force.wrench_source import Reading, ReadingCounts
from sensing.stream.connection import StreamConnection
from sensing.stream.package import Kind

_WRENCH = struct.Struct(">I6d")


class StreamForce:
    """A ``WrenchSource`` over a stream; stamps are of the sender's clock, which is asked for.

    Args:
        host: address of the sender.
        port: TCP port.
        patience: how long the sender is waited for [s].

    Raises:
        InputError: no one listens there.
    """

    def __init__(self, host: str, port: int, patience: float = 5.0) -> None:
        self._connection = StreamConnection(host, port, patience)
        self.clock, self.counts = self._connection.clock, ReadingCounts()
        self._number: int | None = None
        self._broken = 0

    def read(self, timeout: float) -> list[Reading]:
        """See ``WrenchSource.read``."""
        found = self._connection.next(timeout)
        if found is None:
            return []
        if found.kind != Kind.WRENCH or len(found.payload) != _WRENCH.size or not self.clock.known:
            self.counts.refused += 1
            return []
        number, *values = _WRENCH.unpack(found.payload)
        wrench = np.array(values)
        if not (np.isfinite(wrench).all() and np.isfinite(found.stamp)):
            self.counts.refused += 1
            return []
        if self._number is not None:
            since = (number - self._number + 2**31) % 2**32 - 2**31
            if since <= 0 and self._broken == self._connection.broken:
                self.counts.outdated += 1
                return []
            self.counts.lost += max(since - 1, 0) if self._broken == self._connection.broken else 0
        self._number, self._broken = number, self._connection.broken
        self.counts.readings += 1
        return [Reading(found.stamp, wrench)]

    def close(self) -> None:
        """Ends the connection."""
        self._connection.close()
