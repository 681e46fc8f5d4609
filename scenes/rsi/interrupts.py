"""Ctrl-C and SIGTERM bring the arm to rest on its path; before anything moves they end the program."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

from scenes.rsi.server import RsiServer


@contextmanager
def stopping_on_signals(server: RsiServer) -> Iterator[None]:
    """Within the block either signal stops the server; the handlers before are restored."""

    def interrupt(number: int, _: object) -> None:
        if server.link.counts.cycles == 0:
            raise KeyboardInterrupt
        server.stop("stopped by the user" if number == signal.SIGINT else "stopped by the system (SIGTERM)")

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
