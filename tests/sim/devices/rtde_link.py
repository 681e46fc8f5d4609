"""An RTDE controller in a thread, on loopback only."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

from sim.devices.rtde_controller import RtdeController


@contextmanager
def serving(controller: RtdeController) -> Iterator[RtdeController]:
    """Plays the controller in a thread while the block runs."""
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(controller.run)
        try:
            yield controller
        finally:
            controller.stop()
            future.result(20.0)
