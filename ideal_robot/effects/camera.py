"""Errors of a camera that sees a line: displaced points, or wrong time stamps.

Only the part of a point's displacement across the line can be seen. For a point at ``u`` in the tool frame, with the
pose ``R, p`` of the tool at the time stamp and the line's normal ``n`` in the surface, a displacement ``du`` of the
measured point adds ``n' R du`` to its lateral deviation, and a delay ``delta`` adds ``-delta n' (v + omega × R u)``.

An effect lists its errors, one for each coefficient. The regression of the line (``diagnosis``) makes a signal of each,
and a follower corrects the camera's points by them (``CameraErrors``). A new effect only lists its errors.
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
    """The error that a unit of a coefficient causes.

    The ``signal`` is its displacement across the line, without what another line would explain; an ``optional`` error
    is left out where another line explains it.
    """

    signal: str
    optional: bool = field(default=False, kw_only=True)


@dataclass(frozen=True)
class PointError(CameraError):
    """Displaced points: ``moved (m, 3)`` [m] for a unit of the coefficient.

    It is a function of the measured points ``(m, 3)``, relative to the optical axis on the surface, in the tool frame
    [m].
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
    """An effect of a camera with its ``errors``: one for each coefficient, optional ones last."""

    domain = SENSOR
    errors: ClassVar[tuple[CameraError, ...]]

    def usable(self, signals: Signals, joint: int) -> bool:
        """Whether the signals can show the effect: the camera has to have seen a line in the recording."""
        return all(error.signal in signals.extra for error in self.errors if not error.optional)

    def columns(self, signals: Signals, joint: int, theta: Theta) -> Array:
        """Columns of shape ``(N, 1, m)``, of those errors that can be seen; see ``Effect.columns``."""
        columns = [signals.extra[error.signal] for error in self.errors if error.signal in signals.extra]
        return np.stack(columns, axis=-1)[:, None, :]

    def loop_change(self, coefficients: tuple[float, ...], theta: Theta) -> LoopChange:
        """The change of the loop: the follower corrects its camera, see ``CameraErrors``."""
        return LoopChange(points=any(isinstance(error, PointError) for error in self.errors),
                          stamps=any(isinstance(error, StampError) for error in self.errors))


class CameraLatency(CameraEffect):
    """Delay of the camera: points stamped ``t`` were seen from the pose at ``t + delta``.

    The error of the assumed age of a picture. Along a straight line at constant attitude it moves points along the line
    only and cannot be seen; where curvature or attitude change it can.
    """

    name = "camera_latency"
    errors = (StampError("line_speed", np.ones_like),)
    coefficient_names = ("latency",)
    coefficient_units = ("s",)
    source = "[L] (4), (5): the pose of the exposure"


class CameraScale(CameraEffect):
    """Scale error of the camera: points lie too far from the optical axis by a factor, ``du = epsilon (u - u_axis)``.

    ``u``, as measured, is ``d / f · pixel``: an error of the distance d and one of the focal length f are the same.
    """

    name = "camera_scale"
    errors = (PointError("line_scale", _itself),)
    coefficient_names = ("scale",)
    coefficient_units = ("1",)
    source = "[L] 4.4: distance and focal length of the camera"


class CameraOffset(CameraEffect):
    """Mounting error of the camera: points shifted along the tool's x and y, turned by psi about the optical axis.

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
    """Lens distortion: points lie too far out by the cube of their distance from the axis, ``du = k r² (u - u_axis)``.

    ``u`` is the point as measured. With a camera at height h above the surface ``k h²`` is the error of the first
    radial coefficient k1.
    """

    name = "lens_distortion"
    errors = (PointError("line_cubic", _cubed),)
    coefficient_names = ("cubic",)
    coefficient_units = ("1/m²",)
    source = "D. C. Brown, Close-range camera calibration, 1971: radial distortion, first term"


class ClockDrift(CameraEffect):
    """Drift of the camera's clock: the error of the stamps grows, ``delta(t) = rate t``, from zero at the first sample.

    It can only be separated from ``camera_latency`` if the line is seen for a long time.
    """

    name = "clock_drift"
    errors = (StampError("line_drift", _itself),)
    coefficient_names = ("rate",)
    coefficient_units = ("s/s",)
    source = "[L] (4), (5) with a time offset that grows"


@dataclass(frozen=True)
class CameraErrors:
    """The errors of a camera with their sizes, from which a follower corrects its measurements."""

    sizes: tuple[tuple[CameraError, float], ...]

    @classmethod
    def of(cls, effects: Sequence[FittedEffect]) -> CameraErrors:
        """The total errors of a camera from all effects of a model."""
        fits = [(fitted.effect, fitted.coefficients) for fitted in effects]
        return cls(tuple(size for effect, coefficients in fits if isinstance(effect, CameraEffect)
                         for size in zip(effect.errors, coefficients, strict=False)))

    def late_by(self, t: float) -> float:
        """Delay of a picture's exposure after its time stamp ``t`` [s]."""
        return sum((size * float(error.late(np.asarray(t))) for error, size in self.sizes
                    if isinstance(error, StampError)), 0.0)

    def points(self, measured: Array, axis: Array) -> Array:
        """Corrects measured points ``(m, 3)`` in the tool frame [m] for the errors.

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
