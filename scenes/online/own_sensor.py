"""A sensor of the user's as a ``Sensor`` of a task."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ideal_robot.errors import RaisedBy
from ideal_robot.signals.recording import expect
from planning.line.deviation_sensor import DeviationSensor, fuse_reading
from planning.line.line_follower import LineFollower
from scenes.online.log import TaskLog
from scenes.online.task import Sensor, Work


class OwnSensor(Sensor):
    """Any device that measures how far the line is from the tool.

    Args:
        sensor: the device.
        follower: receives its readings.
        log: is written to.
    """

    def __init__(self, sensor: DeviationSensor, follower: LineFollower, log: TaskLog) -> None:
        self._sensor, self._follower, self._log = sensor, follower, log
        log.readings[sensor.name] = 0, 0

    def fuse(self, t: float) -> Work:
        """Fuses what has arrived by ``t`` [s], or does the next part of it; see ``Sensor``."""
        name = self._sensor.name
        with RaisedBy(f"sensor {name}: arrived"):
            readings = self._sensor.arrived(t)
        expect(readings, Sequence, f"{name}: arrived", "return a list of Readings, empty where none is new")
        values, used = self._log.readings[name]
        finite = [reading for reading in readings if np.isfinite(reading.value)]
        for reading in finite:
            values, used = values + 1, used + fuse_reading(self._follower, reading, name).dof
        self._log.readings[name] = values, used
        return Work.FUSED if finite else Work.NOTHING
