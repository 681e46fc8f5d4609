"""A controller in a thread and what listens to it, on loopback only."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any

from sim.arm.arm import SimulatedArm
from sim.devices.rsi_controller import ControllerRun, RsiController

PATIENCE = 20.0
"""No test waits longer for the other side [s]."""
ENDLESS = 1_000_000
"""Cycles of a controller that ends with the block."""


@contextmanager
def controlled(arm: SimulatedArm, port: int, cycles: int = ENDLESS, **options: Any) -> Iterator[Future[ControllerRun]]:
    """Plays the controller in a thread while the block runs; yields what it will have seen."""
    controller = RsiController(arm, ("127.0.0.1", port), **{"timeout": PATIENCE, **options})
    with ThreadPoolExecutor(1) as pool:
        try:
            future = pool.submit(controller.run, cycles)
            yield future
        finally:
            # With a number of cycles it ends by itself, and the last answer may still be on its way.
            wait([future], PATIENCE if cycles < ENDLESS else 0.0)
            controller.stop()
