"""The interface of further sensors along a line: any device that measures the line's distance from the tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from planning.line.line_follower import LineFollower
from planning.line.measurement import Fused, Measurement


@dataclass(frozen=True)
class Reading:
    """One positional deviation Δx_a of the line as seen from the tool, [L] (4).

    Attributes:
        t: controller time of the measurement, not of its arrival [s].
        at: where the sensor looks, in the tool frame ``(3,)`` [m].
        value: how far the line is from there along ``direction`` [m]; NaN where the sensor sees none.
        variance: of ``value`` [m²].
        direction: direction in which the sensor measures, in the tool frame, a unit vector ``(3,)``; None for across
            the path.
    """

    t: float
    at: Sequence[float] | Array
    value: float
    variance: float
    direction: Sequence[float] | Array | None = None


class DeviationSensor(Protocol):
    """A sensor of the line's distance from the tool.

    It measures on its own clock; readings may come late, in any order and in any direction. Each carries the
    *controller's* time of its measurement as well as the device knows it.

    Attributes:
        name: for statistics and the report.
    """

    name: str

    def arrived(self, t: float) -> Sequence[Reading]:
        """The readings that have arrived by the controller time ``t`` [s], each once."""
        ...


def fuse_reading(follower: LineFollower, reading: Reading, sensor: str) -> Fused:
    """Fuses a reading into the follower's map: [L] (5), Δx_r = Δx_a - (x_r - x̂_a), along the sensed direction.

    Raises ``InputError`` for shapes that do not fit, values that are not finite, or a variance that is not positive.

    Args:
        follower: knows where the tool was at the reading's time.
        reading: the measured deviation.
        sensor: its name.
    """
    at = np.asarray(reading.at, dtype=float)
    if at.shape != (3,):
        raise InputError("expected a point (3,) [m] in the tool frame", field=f"{sensor}: at", value=at.shape)
    if not reading.variance > 0:
        raise InputError("expected a variance above zero [m²]", field=f"{sensor}: variance", value=reading.variance)
    pose = follower.history.pose(reading.t)
    place = pose.rotation @ at + pose.translation
    near = float(follower.profile.s(reading.t - follower.t_start))
    s, *_ = follower.reference.project(place[None], near + float(at[0]))
    frames = follower.reference.frames(s)
    normal, up = frames.normal[0], frames.up[0]
    direction = normal
    if reading.direction is not None:
        sensed = np.asarray(reading.direction, dtype=float)
        if sensed.shape != (3,) or not np.linalg.norm(sensed) > 0:
            raise InputError("expected a direction (3,) in the tool frame", field=f"{sensor}: direction", value=sensed)
        direction = pose.rotation @ (sensed / np.linalg.norm(sensed))
    value = reading.value + float(direction @ (place - frames.position[0]))
    components = np.array([[direction @ normal, direction @ up][: follower.fusion.model.directions]])
    return follower.fuse(Measurement(reading.t, s, np.array([value]), np.array([[reading.variance]]), components,
                                     sensor=sensor))
