"""The force sensor in the loop of a live arm: a thread reads it, the cycle takes what is there."""

from __future__ import annotations

import threading
from collections import deque

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.row_log import RowLog
from scenes.follow.live_arm import LiveArm
from sensing.force.wrench import WrenchSample
from sensing.force.wrench_source import WrenchSource

STUCK = 25
"""Readings in a row without the least change after which the sensor counts as stuck: a sound one has noise."""
IMPOSSIBLE = 1e5
"""A reading beyond is none [N, N m]."""
_OLDEST = 0.4
_WAITING = 4000


class LiveForce:
    """A ``sensing.force.force_device.ForceSensor`` over a source.

    Args:
        source: the sensor.
        arm: whose time the samples are given.

    Attributes:
        samples: of all that were handed on the time [s] and the wrench [N, N m].
        stuck, impossible, untimely: readings that count as missing.
    """

    def __init__(self, source: WrenchSource, arm: LiveArm) -> None:
        self.source, self._arm = source, arm
        self.samples = RowLog(7)
        self.stuck = self.impossible = self.untimely = 0
        self._alike, self._last = 0, np.full(6, np.nan)
        self._sound = 0.0
        self._readings: deque[tuple[float, Array]] = deque(maxlen=_WAITING)
        self._closed = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def arrived(self, t: float) -> list[WrenchSample]:
        """See ``ForceSensor.arrived``; readings that cannot be count as missing."""
        found = []
        while self._readings:
            stamp, wrench = self._readings.popleft()
            at = self._arm.play_time(self.source.clock.host(stamp))
            if not np.isfinite(at) or not max(t - _OLDEST, 0.0) <= at <= t + 0.04:
                self.untimely += 1
            elif not (np.abs(wrench) < IMPOSSIBLE).all():
                self.impossible += 1
            else:
                self._alike = self._alike + 1 if np.array_equal(wrench, self._last) else 0
                self._last = wrench
                if self._alike >= STUCK:
                    self.stuck += 1
                else:
                    found.append(WrenchSample(at, t, wrench))
        if found:
            self._sound = max(self._sound, max(sample.t for sample in found))
            for sample in found:
                self.samples.append((sample.t, *sample.wrench))
        return found

    def silent(self, t: float) -> float:
        """How long there has been no sound reading by ``t`` [s]."""
        return t - self._sound

    def begin(self) -> None:
        """The run's time begins anew."""
        self._readings.clear()
        self._sound = 0.0
        self.samples = RowLog(7)

    def why_silent(self) -> str:
        """What came instead of readings."""
        counts = self.source.counts
        said = [f"{number} {what}" for number, what in (
            (self.stuck, "stuck"), (self.impossible, "impossible"), (self.untimely, "with an impossible time"),
            (counts.invalid, f"wrong by its own word ({counts.last_invalid})"), (counts.refused, "refused")) if number]
        return ", ".join(said) or "nothing came"

    def close(self) -> None:
        """Ends the thread and gives the sensor back."""
        self._closed = True
        self._thread.join(1.0)
        self.source.close()

    def _read(self) -> None:
        while not self._closed:
            for reading in self.source.read(0.1):
                self._readings.append((reading.stamp, reading.wrench))
