"""Travel along the reference path over time: from rest to rest, within what path and joints allow."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.ndimage import minimum_filter1d

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import LONGEST_PATH, MOST_TICKS, ROUNDING, TICK
from planning.path.joint_demands import JointDemands
from planning.path.joint_path import JointPath
from planning.path.reference import ReferencePath

REACHED = 0.98
"""Share of the speed asked for that a travel reaches somewhere where it counts as possible."""
RESOLVED = 0.005
"""Step to which the highest possible speed is found [m/s]."""


@dataclass(frozen=True)
class Limits:
    """Limits that the travel has to keep.

    Attributes:
        speed: top speed [m/s].
        acceleration, jerk: along the path [m/s², m/s³].
        share: share of the joints' velocity and acceleration limits that the reference may use; corrections by sensors
            may use the rest.
    """

    speed: float
    acceleration: float = 5.0
    jerk: float = 100.0
    share: float = 0.85

    def __post_init__(self) -> None:
        for key in ("speed", "acceleration", "jerk", "share"):
            value = getattr(self, key)
            if not np.isfinite(value) or value <= 0:
                raise InputError("expected a positive number", field=key, value=value)


class SpeedProfile:
    r"""Arc length over time, :math:`s(t)`, with bounded jerk.

    The speed limit at each place is the smallest of the top speed and of what the joints allow,
    :math:`|q_i'|\,\dot s \le \dot q_{i,\max}`, :math:`|q_i' \ddot s + q_i'' \dot s^2| \le \ddot q_{i,\max}` and the
    torques of the rigid body (``JointDemands``); sweeps forwards and backwards bound the acceleration, and an average
    over time bounds the jerk.

    Attributes:
        tick: spacing of its samples [s].
        duration: time from rest to rest [s].
        length: distance travelled [m].
        top_speed: highest speed that is reached [m/s].
        slowed: where a joint keeps the speed below the required one: ``(from s, to s, lowest speed, joint)``.
        joint_path: the path in joint space that it was planned on; None for a travel given by its samples.
    """

    def __init__(self, s: Array, tick: float = TICK) -> None:
        """A profile of samples ``s (K,)`` [m] every ``tick`` seconds, beginning and ending at rest."""
        self.tick = tick
        self.duration = tick * (len(s) - 1)
        self.length = float(s[-1])
        self._spline = CubicSpline(tick * np.arange(len(s)), s, bc_type="clamped")
        self._cubics, self._knots = self._spline.c, self._spline.x
        self.top_speed = float(np.max(self.speed(tick * np.arange(len(s)))))
        self.slowed: tuple[tuple[float, float, float, int], ...] = ()
        self.joint_path: JointPath | None = None

    def s(self, t: npt.ArrayLike) -> Array:
        """Arc length [m] at times ``t`` after the start [s]; at rest before the start and after the end."""
        return np.asarray(self._spline(np.clip(t, 0.0, self.duration)))

    def speed(self, t: npt.ArrayLike) -> Array:
        """Path speed [m/s] at times ``t``."""
        return np.asarray(self._spline(np.clip(t, 0.0, self.duration), 1))

    def at(self, t: float) -> tuple[float, float]:
        """Arc length [m] and speed [m/s] at one instant, without the overhead of arrays."""
        t = min(max(t, 0.0), self.duration)
        i = min(int(t / self.tick), self._cubics.shape[1] - 1)
        a, b, c, d = self._cubics[:, i].tolist()
        u = t - self._knots.item(i)
        return ((a * u + b) * u + c) * u + d, (3.0 * a * u + 2.0 * b) * u + c

    def acceleration(self, t: npt.ArrayLike) -> Array:
        """Path acceleration [m/s²] at times ``t``."""
        inside = np.clip(t, 0.0, self.duration)
        return np.where(inside == t, self._spline(inside, 2), 0.0)

    @classmethod
    def plan(
        cls, robot: Robot, reference: ReferencePath, limits: Limits | float, joint_path: JointPath | None = None
    ) -> SpeedProfile:
        """Plans the travel along the whole reference.

        Args:
            robot: the arm with its joint limits.
            reference: the path.
            limits: or just the top speed [m/s].
            joint_path: the reference in joint space, if it is known already.

        Raises:
            InputError: out of reach, or a speed that cannot be reached anywhere on the path; names joint, value and
                limit, or the length that is missing.
        """
        limits = limits if isinstance(limits, Limits) else Limits(float(limits))
        demands = JointDemands.of(robot, joint_path or JointPath.of(robot, reference), limits.share)
        profile, by_joint = _planned(demands, limits)
        if profile.top_speed < REACHED * limits.speed:
            raise _unreachable(demands, by_joint, limits, _possible(demands, by_joint, limits))
        return profile

    @classmethod
    def fastest(cls, robot: Robot, limits: Limits, joint_path: JointPath) -> SpeedProfile:
        """Plans the travel at the required top speed, or at the highest that path and joints allow.

        Raises InputError for a path that would last too long.

        Args:
            robot: the arm with its joint limits.
            limits: of the travel.
            joint_path: the reference in joint space.
        """
        demands = JointDemands.of(robot, joint_path, limits.share)
        profile, by_joint = _planned(demands, limits)
        if profile.top_speed < REACHED * limits.speed:
            possible = max(_possible(demands, by_joint, limits), RESOLVED)
            profile, _ = _planned(demands, replace(limits, speed=possible))
        return profile


def _planned(demands: JointDemands, limits: Limits) -> tuple[SpeedProfile, Array]:
    """The travel with its path and where it is slowed, and the highest steady speed that each joint allows."""
    by_joint = demands.steady()
    profile, limit = _fastest(demands, by_joint, limits)
    profile.joint_path = demands.path
    profile.slowed = _slowed(demands.path, limit, by_joint, profile, limits.speed)
    return profile, by_joint


def _fastest(demands: JointDemands, by_joint: Array, limits: Limits) -> tuple[SpeedProfile, Array]:
    """The travel, and the speed limit at each place of the path ``(K,)`` [m/s] that came of it."""
    path = demands.path
    ds = path.s[1] - path.s[0]
    # Averaging over time raises dips of the speed: keep the limit's smallest value over the averaged distance.
    window = limits.acceleration / limits.jerk
    reach = int(np.ceil(0.5 * window * limits.speed / ds))
    limit = np.minimum(minimum_filter1d(np.min(by_joint, axis=1), size=1 + 2 * reach), limits.speed)
    for _ in range(20):
        profile = _travel(demands, limit, limits)
        excess, places = _excess(profile, demands)
        if excess.max() <= 1.0 + 1e-3:
            return profile, limit
        lowered = np.ones(len(path.s))
        near = np.clip(np.round(places / ds).astype(int), 0, len(lowered) - 1)
        np.minimum.at(lowered, near, 1.0 / np.maximum(excess, 1.0))
        limit = limit * minimum_filter1d(lowered, size=15)
    # Where lowering the limit locally does not suffice, the whole travel is slowed.
    slower = float(excess.max())
    tick = _tick(profile.duration * slower)
    ticks = tick * np.arange(round(profile.duration * slower / tick) + 1)
    return SpeedProfile(profile.s(ticks / slower), tick), limit / slower


def _possible(demands: JointDemands, by_joint: Array, limits: Limits) -> float:
    """Highest speed that can be asked for [m/s], rounded down."""
    low, high = 0.0, limits.speed
    while high - low > RESOLVED:
        middle = 0.5 * (low + high)
        reached = _fastest(demands, by_joint, replace(limits, speed=middle))[0].top_speed
        low, high = (middle, high) if reached >= REACHED * middle else (low, middle)
    return low


def _travel(demands: JointDemands, limit: Array, limits: Limits) -> SpeedProfile:
    """Sweeps in both directions over the squared speed, then averages over time."""
    path, square = demands.path, limit**2
    square[0] = square[-1] = 0.0
    ds = float(path.s[1] - path.s[0])
    for order in (range(1, len(square)), range(len(square) - 2, -1, -1)):
        for i in order:
            last = i - 1 if order.step > 0 else i + 1
            room = max(demands.room(last, square[last]), 0.1 * limits.acceleration)
            square[i] = min(square[i], square[last] + 2.0 * min(room, limits.acceleration) * ds)
    v = np.sqrt(square)
    t = np.concatenate([[0.0], np.cumsum(2.0 * ds / np.maximum(v[1:] + v[:-1], ROUNDING))])
    if t[-1] > LONGEST_PATH:
        raise InputError(f"the path would last {t[-1]:.3g} s; {LONGEST_PATH:g} s is the longest, move faster",
                         field="speed", value=limits.speed)
    # Constant acceleration between the places: the speed is linear in time there.
    tick = _tick(float(t[-1]))
    ticks = tick * np.arange(int(np.ceil(t[-1] / tick)) + 2)
    speed = np.interp(ticks, t, v, right=0.0)
    width = max(int(np.ceil(limits.acceleration / limits.jerk / tick)), 1)
    while True:
        kernel = np.convolve(np.ones(width), np.ones(max(width // 4, 1)))
        smooth = np.convolve(np.concatenate([np.zeros(3), speed, np.zeros(3)]), kernel / kernel.sum())
        if width > 2000 or np.max(np.abs(np.diff(smooth, 2))) <= limits.jerk * tick**2:
            break
        width = int(np.ceil(1.2 * width))
    s = np.concatenate([[0.0], np.cumsum(0.5 * tick * (smooth[1:] + smooth[:-1]))])
    return SpeedProfile(s * (path.s[-1] / s[-1]), tick)


def _tick(duration: float) -> float:
    """Spacing of the samples of a travel of that length [s]."""
    return TICK * max(1, math.ceil(duration / (TICK * MOST_TICKS)))


def _excess(profile: SpeedProfile, demands: JointDemands) -> tuple[Array, Array]:
    """How far the joints are beyond their limits over time, as a factor of the speed, and where on the path."""
    t = np.arange(0.0, profile.duration, 4 * profile.tick)
    s = profile.s(t)
    return demands.excess(s, profile.speed(t), profile.acceleration(t)), s


def _slowed(
    path: JointPath, limit: Array, by_joint: Array, profile: SpeedProfile, speed: float
) -> tuple[tuple[float, float, float, int], ...]:
    """Pieces of the path where the limit, and not speeding up or braking, decides."""
    ticks = profile.tick * np.arange(round(profile.duration / profile.tick) + 1)
    travelled = np.interp(path.s, np.maximum.accumulate(profile.s(ticks)), profile.speed(ticks))
    slow = np.concatenate([[False], (limit < 0.98 * speed) & (travelled > 0.9 * limit), [False]])
    edges = np.flatnonzero(np.diff(slow.astype(int)))
    pieces = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        lowest = first + int(np.argmin(limit[first:last]))
        joint = int(np.argmin(by_joint[lowest])) + 1
        pieces.append((float(path.s[first]), float(path.s[last - 1]), float(limit[lowest]), joint))
    return tuple(pieces)


def _unreachable(demands: JointDemands, by_joint: Array, limits: Limits, possible: float) -> InputError:
    path, allowed = demands.path, np.min(by_joint, axis=1)
    best = int(np.argmax(allowed))
    if allowed[best] < REACHED * limits.speed:
        joint = int(np.argmin(by_joint[best]))
        needed, has = demands.needed(best, joint, limits.speed)
        return InputError(
            f"cannot be reached anywhere on this path: joint {joint + 1} would need {needed}; {limits.share:.0%} of "
            f"its limit are {has}; at most {possible:.2f} m/s are possible, lower the speed or move the path",
            field="speed",
            value=limits.speed,
        )
    missing = limits.speed**2 / limits.acceleration + limits.speed * limits.acceleration / limits.jerk
    return InputError(
        f"cannot be reached: speeding up at {limits.acceleration:g} m/s² and braking again takes about "
        f"{missing:.2f} m, the path has {path.s[-1]:.2f} m; at most {possible:.2f} m/s are possible, lower "
        "the speed or lengthen the path",
        field="speed",
        value=limits.speed,
    )
