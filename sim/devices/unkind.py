"""What clocks and networks do to devices: offset and drift, packets that are late, lost and doubled."""

from __future__ import annotations

import heapq
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ideal_robot.errors import InputError


def now() -> float:
    """This computer's clock, by which everything here is timed [s]."""
    return time.perf_counter()


@dataclass(frozen=True)
class Unkindness:
    """How bad it is.

    Attributes:
        drift: by how much each device's clock runs fast, with a sign of its own (relative).
        offset: between the clocks, with a sign of its own [s].
        loss: probability that a packet is lost.
        doubled: probability that it comes twice.
        late: how much later a packet comes that is late [s].
        late_share: probability of that.
    """

    drift: float = 2e-5
    offset: float = 0.03
    loss: float = 0.0
    doubled: float = 0.0
    late: float = 0.03
    late_share: float = 0.0

    def __post_init__(self) -> None:
        for name in ("loss", "doubled", "late_share"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise InputError("expected a probability from 0 to below 1", field=name, value=getattr(self, name))
        if not (abs(self.drift) <= 1e-3 and self.offset >= 0.0 and 0.0 <= self.late <= 5.0):
            raise InputError("expected a drift up to 1e-3, an offset and a lateness up to 5 s that are not negative",
                             field="drift, offset, late", value=(self.drift, self.offset, self.late))


class DeviceClock:
    """A clock of its own: what it shows at a time of this computer.

    Args:
        offset: what it shows when this is made [s].
        drift: by how much it runs fast (relative).
    """

    def __init__(self, offset: float, drift: float) -> None:
        self._begun, self._offset, self.drift = time.perf_counter(), offset, drift

    def shows(self, host: float) -> float:
        """What it shows [s] at ``host`` of this computer's ``time.perf_counter``."""
        return self._offset + (1.0 + self.drift) * (host - self._begun)


class Outbox:
    """Sends what is due when it is due, from a thread of its own, with what the network does to it.

    Args:
        unkind: loss, doubling and lateness.
        rng: draws them.
    """

    def __init__(self, unkind: Unkindness, rng: np.random.Generator) -> None:
        self._unkind, self._rng = unkind, rng
        self._waiting: list[tuple[float, int, Callable[[], None]]] = []
        self._count, self._closed, self._some = 0, False, threading.Condition()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def put(self, due: float, send: Callable[[], None]) -> None:
        """``send`` is called at ``due`` of this computer's time, or never, or twice, or later."""
        with self._some:
            u = self._unkind
            lost, twice, late = self._rng.random(3) < (u.loss, u.doubled, u.late_share)
            for _ in range(0 if lost else 2 if twice else 1):
                self._count += 1
                heapq.heappush(self._waiting, (due + (u.late if late else 0.0), self._count, send))
            self._some.notify()

    def close(self) -> None:
        """Nothing is sent any more."""
        with self._some:
            self._closed = True
            self._some.notify()
        self._thread.join(2.0)

    def _run(self) -> None:
        while True:
            with self._some:
                if self._closed:
                    return
                if not self._waiting:
                    self._some.wait(0.5)
                    continue
                left = self._waiting[0][0] - time.perf_counter()
                if left > 0:
                    self._some.wait(left)
                    continue
                send = heapq.heappop(self._waiting)[2]
            send()
