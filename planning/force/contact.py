"""Settings of a contact motion, and the conditions at which it has to stop."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array, interpolated
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from planning import PlanningError
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath

FORCE_ERRORS = (0.3, 0.002)
"""Standard deviations of what is estimated of the force sensor on the way: the logarithm of E over the assumed one, and
the time constant of damping or stamps [s]."""
STAMPS, DAMPING = 5e-4, 10.0
"""Standard deviations of what is left wrong in the sensor's stamps [s], and of a tip's damping [N s/m]."""

NOTICED = 0.08
"""Time from a touch until the arm answers it: the sensor's, two cycles, and the arm's own [s]."""

SLOPE, UNSEEN = 0.15, 0.15
"""Slope of a surface before it was felt, and the time until it is known under a tip that has begun to move [s]."""
TOLERATED = 2.5
"""Force that may go wrong meanwhile without a gentler start, which costs more than it gains on soft contacts [N]."""
BEGUN = 1.0
"""Force that may go wrong meanwhile where the start is made gentler [N]."""
GENTLEST = 0.2
"""Jerk with which a travel begins at least [m/s³]."""

ASKED, ASKING, LOUDEST = 10.0, 0.5, 0.1
"""Frequency [Hz] and least amplitude [N] by which a sensor is asked on the way whether it lives: faster than the
surface comes and slower than the arm follows, and above what a map of the surface is wrong by; and the largest as a
share of the wanted force, within what counts as settled."""

TOGETHER = 0.06
"""Way along the path within which samples lie that arrive together and are fused as one [m]."""

LEAP = 0.4
"""Share of the wanted force by which a force may change from one reading to the next. What is less, the half of it
beyond what is wanted still holds."""


def most_force(wanted: float) -> float:
    """Largest permitted force on the surface [N]: 1.5 times the desired one, or what a hand bears."""
    return max(1.5 * wanted, 40.0)


@dataclass(frozen=True)
class ContactSettings:
    """Desired force and motion of a contact, and the assumed errors of its sensor.

    Attributes:
        force: F_r, wanted normal force [N].
        elasticity: E that is assumed, from calibration [N/m].
        descent: largest speed of the approach [m/s].
        plunge: force that may have built up when the touch has been noticed and answered [N].
        reach: distance the approach may take before there has to be contact [m].
        touch: force from which there is contact [N].
        settle: time for which the force has to be near F_r before the travel begins [s].
        clearance: how far the tip is off the surface at the end [m].
        noise: assumed standard deviation of a force sample [N]; ``ForceNoise`` estimates it during the motion.
        position_noise: standard deviation common to the samples of a cycle: errors of the position and of the model
            [m].
        asking: amplitude of a test force by which the tip's height oscillates during the travel [N]; a working sensor
            shows it.
        start_height: of the tip over the reference when the approach begins [m].
        force_errors: standard deviations of the logarithm of E over the assumed one, and of how late forces are [s].
    """

    force: float = 20.0
    elasticity: float = 5000.0
    descent: float = 0.03
    plunge: float = 10.0
    reach: float = 0.05
    touch: float = 3.0
    settle: float = 0.15
    clearance: float = 0.01
    noise: float = 0.3
    position_noise: float = 3e-5
    asking: float = 0.0
    start_height: float = 0.01
    force_errors: tuple[float, float] = FORCE_ERRORS

    def __post_init__(self) -> None:
        for key in ("force", "elasticity", "descent", "reach", "touch", "plunge", "clearance"):
            if not getattr(self, key) > 0:
                raise InputError("expected a positive number", field=key, value=getattr(self, key))

    @property
    def approach(self) -> float:
        """Speed of the approach [m/s]: the stiffer the contact, the slower."""
        return min(self.descent, self.plunge / (self.elasticity * NOTICED))

    @property
    def lift(self) -> float:
        """Height by which the tip is lifted at the end [m], including the distance by which the force presses it in."""
        return self.clearance + self.force / self.elasticity

    @property
    def lateness(self) -> float:
        """Standard deviation of the time by which damping and stamps shift a force [s].

        The stiffer the contact, the less its damping matters. Too large a value makes the forecast mistake the phase of
        a wave for a time error.
        """
        return min(FORCE_ERRORS[1], float(np.hypot(STAMPS, DAMPING / self.elasticity)))

    def jerk(self, acceleration: float, jerk: float) -> float:
        """Jerk [m/s³] of a travel with this acceleration [m/s²]; ``jerk`` where the contact is soft enough for it.

        A tip at rest does not measure the slope, so the stiffer the contact, the gentler the start.
        """
        if 0.5 * acceleration * UNSEEN**2 * SLOPE * self.elasticity <= TOLERATED:
            return jerk
        return min(jerk, max(GENTLEST, 6.0 * BEGUN / (UNSEEN**3 * SLOPE * self.elasticity)))


# The zero offset of a force sensor: its bias has drifted since calibration, and the approach shows by how much.

BEGIN = 0.06
"""Time after the first sample in which the arm speeds up, and the tool's inertia is felt [s]."""
END = 0.06
"""Time before a sample in which it may have touched already [s]."""


class Tare:
    """Mean contact force in the air that remains after the calibrated bias and weight are subtracted."""

    def __init__(self) -> None:
        self._first: float | None = None
        self._recent: deque[tuple[float, Array]] = deque()
        self._sum, self._count = np.zeros(3), 0

    @property
    def force(self) -> Array:
        """Offset to be subtracted from contact forces in the tool frame ``(3,)`` [N]."""
        return self._sum / max(self._count, 1)

    def add(self, t: Array, contact: Array) -> None:
        """Adds contact forces ``(m, 3)`` [N] that were measured in the air at ``t (m,)`` [s] during an approach."""
        for instant, force in zip(t, contact, strict=True):
            self._first = float(instant) if self._first is None else self._first
            if instant >= self._first + BEGIN:
                self._recent.append((float(instant), force))
        while self._recent and self._recent[0][0] < float(np.max(t)) - END:
            self._sum, self._count = self._sum + self._recent.popleft()[1], self._count + 1


# A test motion above the path before the task, with its speeds and with the reversals that an unknown surface causes.

CLEAR = 0.03
"""Distance from a surface or its reference that a tip keeps which must not touch it [m]."""
WAVES = (0.25, 0.1)
"""Lengths of the waves of the tip's height [m]."""
DRY_RUN_SLOPE = 0.1
"""Largest slope of each wave."""
LONGEST = 12.0
"""Time that the motion takes at most, unless joints are too slow for that [s]."""
SHARE = 0.6
"""Of the joints' largest speeds that the motion may use."""


def dry_run(robot: Robot, reference: ReferencePath, speed: float, q_start: Array) -> Array:
    """Joint angles ``(N, n)`` [rad] at the cycles: along the path and back, from rest to rest, without touching.

    s = S sin²(π t/T), whose largest speed is that of the task; all lower speeds occur. Each place is passed in both
    directions, which separates friction from weight. Raises ``OutOfReachError`` where a place above the path cannot be
    reached.

    Args:
        robot: cycle time and limits.
        reference: the path.
        speed: of the job [m/s].
        q_start: joint angles near the path's start ``(n,)`` [rad].
    """
    kinematics = InverseKinematics(robot)
    travel = min(reference.length, speed * LONGEST / np.pi)
    lasts = np.pi * travel / speed
    steps = max(round(lasts / robot.t_ipo), 2)
    s = travel * np.sin(np.pi * np.arange(steps + 1) / steps) ** 2
    frames = reference.frames(s)
    waves = [DRY_RUN_SLOPE * length / (2 * np.pi) * (1.0 - np.cos(2 * np.pi * s / length)) for length in WAVES]
    height = CLEAR + np.sum(waves, axis=0)
    places = frames.position + height[:, None] * frames.up
    q = kinematics.path([pin.SE3(R, p) for R, p in zip(reference.rotation(s), places, strict=True)], q_start)
    fastest = float(np.max(np.abs(np.diff(q, axis=0)) / (SHARE * robot.v_max * robot.t_ipo)))
    if fastest <= 1.0:
        return q
    slower = np.linspace(0.0, steps, int(np.ceil(fastest * steps)) + 1)
    return interpolated(slower, np.arange(steps + 1), q)


# Conditions to stop: force too large, contact or line lost, or a command beyond a joint's limits.

class EmergencyStopError(PlanningError):
    """The arm has to stop on its path, because a limit would be exceeded.

    Args:
        cause: ``force``, ``contact``, ``line``, ``reach``, ``position``, ``velocity`` or ``acceleration``.
        t: controller time [s].
        text: the message: what was found, with value, limit and remedy.
    """

    def __init__(self, cause: str, t: float, text: str) -> None:
        self.cause, self.t = cause, t
        super().__init__(f"stopped at t = {t:.3f} s: {text}")


@dataclass(frozen=True)
class StopLimits:
    """Limits at which the arm has to stop.

    Attributes:
        force: largest contact force [N].
        lost: longest time without contact during the travel [s].
        share: of the joints' velocity and acceleration limits that a desired path may use.
    """

    force: float = 80.0
    lost: float = 0.1
    share: float = 1.0

    def __post_init__(self) -> None:
        for key in ("force", "lost", "share"):
            if not getattr(self, key) > 0:
                raise InputError("expected a positive number", field=key, value=getattr(self, key))


class StopConditions:
    """Checks every sample and every horizon of ``robot``; raises before a command exceeds one of ``limits``."""

    def __init__(self, robot: Robot, limits: StopLimits) -> None:
        self._robot, self._limits, self._T = robot, limits, robot.t_ipo

    def force(self, t: float, force: float) -> None:
        """Checks a contact force [N]. Raises ``EmergencyStopError`` above the limit, and where it is no number."""
        if not force <= self._limits.force:
            raise EmergencyStopError(
                "force",
                t,
                f"contact force {force:.1f} N is above the limit "
                f"{self._limits.force:.1f} N; look for an obstacle, or lower the speed",
            )

    def contact(self, t: float, last_touch: float) -> None:
        """Checks the last instant of contact. Raises ``EmergencyStopError`` if it is too long ago."""
        if t - last_touch > self._limits.lost:
            raise EmergencyStopError(
                "contact",
                t,
                f"contact lost {1e3 * (t - last_touch):.0f} ms ago, allowed are "
                f"{1e3 * self._limits.lost:.0f} ms; look for an edge, or lower the speed",
            )

    def approach(self, t: float, descended: float, reach: float) -> None:
        """Checks the distance of the approach [m]. Raises ``EmergencyStopError`` if there should have been contact.

        Args:
            t: controller time [s].
            descended: way of the approach so far [m].
            reach: largest allowed way [m].
        """
        if descended > reach:
            raise EmergencyStopError(
                "contact",
                t,
                f"no contact within {1e3 * reach:.0f} mm of the approach; look "
                "whether the surface is where it should be",
            )

    def command(self, t: float, q_d: Array) -> None:
        """Checks a horizon ``(n_d, n)`` [rad]. Raises ``EmergencyStopError`` naming joint, value and limit."""
        robot, share = self._robot, self._limits.share
        self._within(t, "position", q_d, robot.q_min, robot.q_max, "rad; move the path")
        v = np.diff(q_d, axis=0) / self._T
        self._within(t, "velocity", v, -share * robot.v_max, share * robot.v_max, "rad/s; lower the speed")
        # Over two cycles, as over one the rounding of the inverse kinematics would appear as acceleration.
        if len(v) > 2:
            a = (v[2:] - v[:-2]) / (2 * self._T)
            self._within(t, "acceleration", a, -share * robot.a_max, share * robot.a_max, "rad/s²; lower the speed")

    def _within(self, t: float, cause: str, values: Array, low: Array, high: Array, remedy: str) -> None:
        beyond = np.maximum(values - high, low - values)
        if beyond.max(initial=-1.0) > 0:
            row, joint = np.unravel_index(int(np.argmax(beyond)), beyond.shape)
            value = float(values[row, joint])
            limit = float(high[joint] if value > high[joint] else low[joint])
            raise EmergencyStopError(
                cause, t, f"joint {joint + 1} would need {cause} {value:.3f}, its limit is {limit:.3f} {remedy}"
            )
