"""Sends datagrams of a simulated controller to a program whose port may not be open yet."""

from __future__ import annotations

import errno
import socket
import time
from collections.abc import Callable, Sequence

_AGAIN = 0.005
"""Between two attempts [s]."""


def sent_when_open(link: socket.socket, pieces: Sequence[bytes], end: float,
                   stopped: Callable[[], bool] = lambda: False) -> None:
    """Sends datagrams to the peer of a connected socket, again while the system reports that no one listens.

    A controller in lockstep sends once and waits; what it sent before the program listens would be lost, and the two
    would wait for each other.

    Args:
        link: connected to where they go.
        pieces: the datagrams.
        end: until when they are sent again, by ``time.perf_counter`` [s]; at least once.
        stopped: checked before each further attempt.
    """
    while True:
        try:
            for piece in pieces:
                link.send(piece)
            refused = link.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == errno.ECONNREFUSED
        except ConnectionRefusedError:
            refused = True
        if not refused or stopped() or time.perf_counter() + _AGAIN > end:
            return
        time.sleep(_AGAIN)
