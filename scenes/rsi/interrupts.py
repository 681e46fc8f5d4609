"""Ctrl-C and SIGTERM bring the arm to rest on its path; before anything moves they end the program."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def stopping_on_signals(stop: Callable[[str], None], begun: Callable[[], bool] = lambda: True) -> Iterator[None]:
    """Within the block either signal stops the arm; the handlers before are restored.

    Args:
        stop: brings the arm to rest; is told why.
        begun: whether there is an arm to be brought to rest; without one the program ends.
    """

    def interrupt(number: int, _: object) -> None:
        if not begun():
            raise KeyboardInterrupt
        stop("stopped by the user" if number == signal.SIGINT else "stopped by the system (SIGTERM)")

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
