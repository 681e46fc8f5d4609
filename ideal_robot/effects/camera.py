"""Errors of a camera that sees a line: its points are measured off, or were seen at another time than is stamped.

Only the part of a point's displacement across the line can be seen. For a point at ``u`` in the tool frame, with the
pose ``R, p`` of the tool at the time stamp and the line's normal ``n`` in the surface, a displacement ``du`` of the
measured point adds ``n' R du`` to its lateral deviation, and a delay ``delta`` adds ``-delta n' (v + omega × R u)``.

An effect lists its errors, one for each coefficient. The regression of the line (``diagnosis``) makes a signal of each,
and a follower takes them out of what it is told by the camera (``CameraErrors``): to add an effect is to list others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects.base import SENSOR, Theta, WholeArmEffect
from ideal_robot.effects.fitted import FittedEffect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.signals import Signals


@dataclass(frozen=True)
class CameraError:
    """What a unit of a coefficient is off by.

    The ``signal`` is named after what it does across the line, less what another line would do; an ``optional`` error
    is left out where another line does the same.
    """

    signal: str
    optional: bool = field(default=False, kw_only=True)


@dataclass(frozen=True)
class PointError(CameraError):
    """Points are measured off, by ``moved (m, 3)`` [m].

    That is of points ``(m, 3)`` from where the optical axis meets the surface to where they are measured, in the tool
    frame [m].
    """

    moved: Callable[[Array], Array]


@dataclass(frozen=True)
class StampError(CameraError):
    """Pictures taken later than their stamps say: ``late`` gives the delay [s] of stamps [s]."""

    late: Callable[[Array], Array]


def _itself(values: Array) -> Array:
    return values


def _along(out: Array) -> Array:
    return np.tile([1.0, 0.0, 0.0], (len(out), 1))


def _across(out: Array) -> Array:
    return np.tile([0.0, 1.0, 0.0], (len(out), 1))


def _turned(out: Array) -> Array:
    return np.column_stack([-out[:, 1], out[:, 0], np.zeros(len(out))])


def _cubed(out: Array) -> Array:
    return np.asarray(np.sum(out**2, axis=1)[:, None] * out)


class CameraEffect(WholeArmEffect):
    """An effect of a camera, made of its ``errors``: one for each coefficient, those that are optional last."""

    domain = SENSOR
    errors: ClassVar[tuple[CameraError, ...]]

    def usable(self, signals: Signals, joint: int) -> bool:
        """See ``Effect.usable``: whether the recording can show the effect: the camera saw a line in it."""
        return all(error.signal in signals.extra for error in self.errors if not error.optional)

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """See ``Effect.columns``. Shape ``(N, 1, m)``, of those errors that can be seen."""
        columns = [signals.extra[error.signal] for error in self.errors if error.signal in signals.extra]
        return np.stack(columns, axis=-1)[:, None, :]

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """See ``Effect.loop_change``. What a follower is told by the camera, see ``CameraErrors``."""
        return LoopChange(points=any(isinstance(error, PointError) for error in self.errors),
                          stamps=any(isinstance(error, StampError) for error in self.errors))


class CameraLatency(CameraEffect):
    """The points stamped ``t`` were seen from the pose at ``t + delta``.

    What is undeclared in the age of a picture. Along a straight line at constant attitude it moves points along the
    line only and cannot be seen; where curvature or attitude change it can.
    """

    name = "camera_latency"
    errors = (StampError("line_speed", np.ones_like),)
    coefficient_names = ("latency",)
    coefficient_units = ("s",)
    source = "[L] (4), (5): the pose of the exposure"


class CameraScale(CameraEffect):
    """Measured points lie too far from the optical axis by a constant factor: ``du = epsilon (u - u_axis)``.

    ``u``, as measured, is ``d / f · pixel``: an error of the distance d and one of the focal length f are the same.
    """

    name = "camera_scale"
    errors = (PointError("line_scale", _itself),)
    coefficient_names = ("scale",)
    coefficient_units = ("1",)
    source = "[L] 4.4: distance and focal length of the camera"


class CameraOffset(CameraEffect):
    """Measured points are shifted along the tool's x and y axis and turned by psi about the camera's optical axis.

    ``du = (dx, dy, 0) + psi z × (u - u_axis)``. A pitched or rolled camera at height h above the surface shifts its
    points by h times the angle, and is reported as such. A shift across a line to which the tool keeps its heading is
    the same as another line; it is only fitted where the heading changes.
    """

    name = "camera_offset"
    errors = (PointError("line_along", _along), PointError("line_yaw", _turned),
              PointError("line_across", _across, optional=True))
    coefficient_names = ("along", "yaw", "across")
    coefficient_units = ("m", "rad", "m")
    source = "[L] 4.4: calibration of the camera's mounting"


class LensDistortion(CameraEffect):
    """Measured points lie too far out by the cube of their distance from the optical axis: ``du = k r² (u - u_axis)``.

    ``u`` is the point as measured. With a camera at height h above the surface ``k h²`` is the error of the first
    radial coefficient k1.
    """

    name = "lens_distortion"
    errors = (PointError("line_cubic", _cubed),)
    coefficient_names = ("cubic",)
    coefficient_units = ("1/m²",)
    source = "D. C. Brown, Close-range camera calibration, 1971: radial distortion, first term"


class ClockDrift(CameraEffect):
    """An error of the time stamps that grows, ``delta(t) = rate t``, from none at the recording's first sample.

    Both clocks are quartzes, or one of them is not read when it should be. Beside ``camera_latency`` it is only
    known as far as the time is long in which the line is seen.
    """

    name = "clock_drift"
    errors = (StampError("line_drift", _itself),)
    coefficient_names = ("rate",)
    coefficient_units = ("s/s",)
    source = "[L] (4), (5) with a time offset that grows"


@dataclass(frozen=True)
class CameraErrors:
    """The errors of a camera with their sizes, by which a follower corrects its measurements."""

    sizes: tuple[tuple[CameraError, float], ...]

    @classmethod
    def of(cls, effects: Sequence[FittedEffect]) -> CameraErrors:
        """Errors of a camera that all effects of a model make together."""
        fits = [(fitted.effect, fitted.coefficients) for fitted in effects]
        return cls(tuple(size for effect, coefficients in fits if isinstance(effect, CameraEffect)
                         for size in zip(effect.errors, coefficients, strict=False)))

    def late_by(self, t: float) -> float:
        """How much later than ``t`` [s] a picture with that time stamp was taken [s]."""
        return sum((size * float(error.late(np.asarray(t))) for error, size in self.sizes
                    if isinstance(error, StampError)), 0.0)

    def points(self, measured: Array, axis: Array) -> Array:
        """Points ``(m, 3)`` in the tool frame [m], as they would be measured without the errors.

        Args:
            measured: in the tool frame ``(m, 3)`` [m].
            axis: where the optical axis meets the surface, in the tool frame ``(3,)`` [m].
        """
        right = measured
        for error, size in self.sizes:
            if isinstance(error, PointError):
                right = right - size * error.moved(from_axis(measured, axis))
        return right


def from_axis(points: Array, axis: Array) -> Array:
    """Vectors ``(m, 3)`` from the optical axis to points along the surface, in the tool frame [m]."""
    out = points - axis
    out[:, 2] = 0.0
    return out
