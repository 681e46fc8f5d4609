r"""The contact force estimated from the motor currents: coarse and slow, but independent of the force sensor.

The motors' torque beyond the model's balances the external force, :math:`\tau = \tau_M - J^T F`, so along a direction
``d`` with :math:`g = J^T d`, and each joint weighed by its drive's largest torque,

.. math:: F = - \frac{g^T W (\tau - \tau_M)}{g^T W g}, \qquad W = \mathrm{diag}(\tau_{max}^{-2})

Friction is known well enough only while the joints keep sliding in the same direction. So the estimate is used only in
slow straight motions, relative to its value at their start, in the air.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.special import chdtri

from ideal_robot.arrays import Array
from ideal_robot.friction.presliding import slid
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.tolerances import ROUNDING
from planning.force.contact import NOTICED
from planning.force.sensor_gain import LOSSES, SLIDES, GainByMotors, block_cycles
from planning.path.kinematics import InverseKinematics

WINDOW = 0.4
"""Time over which the force is averaged [s]. On the simulated KR 6 at 10 mm/s it is then right within 5 N, one standard
deviation; over 0.1 s within 13 N."""
SURELY = float(np.sqrt(chdtri(1, 2e-6)))
"""Standard deviations that noise alone exceeds once in 10⁶ times, upwards."""
_SCATTERS = 20
"""Cycles from which it is told how the force scatters."""
SETTLES, AIR = 0.4, 2.0
"""Time in which friction turns round at least, and that in which the motors hear the air at most [s]."""
BEHIND = 0.024
"""By how much the motors are behind the commands [s], from which velocity and acceleration are taken."""


_SMALL = 1e-3
"""Way of the tip from which the ways of the joints are taken [m]."""
_QUIET = 1e-3
"""Least scatter of a torque, of a motor without noise [N m]."""


def settle_and_air(way: float, pace: float) -> tuple[float, float]:
    """Time in which friction becomes steady, and the time of averaging in the air after it [s], for a distance.

    Friction changes with the speed over the presliding distance, not over a time, so the force in the air is averaged
    at the end of the distance.

    Args:
        way: distance to travel before contact is possible [m].
        pace: speed over that distance [m/s].
    """
    air = float(np.clip(way / pace - SETTLES, WINDOW, AIR))
    return max(way / pace - air, SETTLES), air


class FeltByMotors:
    """Force along one direction, from the motor torques, while the tip moves straight and slowly.

    Args:
        model, kinematics: of the arm.
        robot: the arm with the controller's cycle.
        direction: of the force ``(3,)`` [base frame].
        settle: time after which friction is steady and averaging in the air begins [s].
        air: duration of the averaging in the air [s].

    Attributes:
        gain: gain of the force sensor, estimated by the motors during even motion.
    """

    def __init__(self, model: Model, robot: Robot, kinematics: InverseKinematics, direction: Array,
                 settle: float = SETTLES, air: float = WINDOW) -> None:
        self._model, self._kinematics, self._direction, self._T = model, kinematics, direction, robot.t_ipo
        self._weight = 1.0 / np.where(np.isfinite(robot.tau_max), robot.tau_max, 1.0) ** 2
        self._window, self._first = round(WINDOW / self._T), round(settle / self._T)
        self._commands: deque[Array] = deque(maxlen=round(BEHIND / self._T) + 3)
        self._forces: deque[float] = deque(maxlen=self._window)
        self._air, self._in_air, self._air_cycles = 0.0, 0, round(air / self._T)
        self._cycles, self._changes, self._before = 0, list[float](), np.nan
        # Below the speeds of the identification dry friction is unknown.
        self.gain = GainByMotors(model.noise_std + model.friction.dry, model.friction.distance,
                                 block_cycles(self._T, settle))
        self._slid: Array = np.zeros(robot.n)
        self._last: Array | None = None

    def add(self, q_c: Array, q: Array, tau: Array, felt: Array | None = None, speed: float = 0.0) -> None:
        """Adds what one cycle commanded and measured.

        Args:
            q_c: commanded joint angles ``(n,)`` [rad].
            q: measured ones ``(n,)`` [rad].
            tau: measured motor torques ``(n,)`` [N m]; NaN where the controller does not report them.
            felt: force that the sensor shows ``(3,)`` [N, base frame]; None where the motion is not even.
            speed: of the tip [m/s].
        """
        self._commands.append(q_c)
        self._cycles += 1
        if self._last is not None:
            # Distance since the joint reversed, by its command: the motor also moves where only its gear twists.
            step = q_c - self._last
            self._slid = np.where(step * self._slid >= 0.0, self._slid, 0.0) + step
        self._last = q_c
        if len(self._commands) < 3:
            return
        before, here, after = list(self._commands)[:3]
        v, a = (after - before) / (2 * self._T), (after - 2 * here + before) / self._T**2
        rest = tau - self._model.inverse_dynamics(q, v, a)[0]
        g = self._kinematics.torque(q, self._direction)
        if felt is None:
            self.gain.uneven()
        else:
            self.gain.add(rest, self._kinematics.torque(q, felt), np.abs(self._slid), speed)
        force = -float(g @ (self._weight * rest)) / float(g @ (self._weight * g))
        self._changes.append(force - self._before)
        self._before = force
        if self._cycles < self._first:
            return
        self._forces.append(force)
        if self._in_air < self._air_cycles:
            self._in_air += 1
            self._air += (force - self._air) / self._in_air

    @property
    def force(self) -> float:
        """Mean force over the last averaging time, less that in the air [N]; NaN while it is not known."""
        return self.lately(self._window)

    def lately(self, cycles: int) -> float:
        """Mean force over the last ``cycles``, less that in the air [N]; NaN while it is not known."""
        if self._in_air < self._air_cycles or len(self._forces) < cycles:
            return np.nan
        return float(np.mean(list(self._forces)[-cycles:])) - self._air

    @property
    def scatter(self) -> float | None:
        """Standard deviation of a cycle's force [N]; None while it is not known, or without torques."""
        changes = np.array(self._changes)[1:]
        if len(changes) < _SCATTERS or not np.isfinite(changes).all():
            return None
        return float(np.sqrt(np.mean(changes**2) / 2.0))


@dataclass(frozen=True)
class Alert:
    """How fast a rising force the motors detect that the force sensor does not show.

    Attributes:
        cycles: number of cycles over which the motor torques are averaged.
        force: force above which it is not explained by their noise [N].
        rate: largest rate of the force at which the arm retracts before the permitted force is exceeded [N/s].
    """

    cycles: int
    force: float
    rate: float


def soonest(scatter: float, least: float, most: float, T: float, air: float) -> Alert | None:
    r"""The averaging time w that permits the fastest rise of a force; None where noise exceeds the permitted force.

    Of a force that rises with the rate R the mean over w is :math:`R\, w / 2` behind. It is noticed once it is beyond
    ``SURELY`` standard deviations :math:`\sigma \sqrt{T/w + T/w_0}`, that of the air included, and the arm retracts
    ``NOTICED`` later:

    .. math:: R(w) = \frac{F_{max} - F(w)}{w / 2 + t_0}

    Args:
        scatter: standard deviation of a cycle's force, σ [N].
        least: force that the model may be wrong by [N].
        most: largest force that the surface permits [N].
        T: cycle [s].
        air: averaging time in the air, w₀ [s].
    """
    cycles = np.arange(1, round(WINDOW / T) + 1)
    force = np.maximum(SURELY * scatter * np.sqrt(1.0 / cycles + T / air), least)
    rate = (most - force) / (0.5 * cycles * T + NOTICED)
    best = int(np.argmax(rate))
    return Alert(int(cycles[best]), float(force[best]), float(rate[best])) if rate[best] > 0.0 else None


class Hearing:
    r"""How slowly a surface has to be pressed so that the motors can measure a force sensor's gain.

    While the force rises from 0 to F in the time t, a regression over :math:`t/T` torques of standard deviation
    :math:`\sigma_j` with an unknown friction determines κ within

    .. math:: \sigma_\kappa^2 = \frac{12\, T}{t\, F^2 \sum_j (g_j / \sigma_j)^2}

    over the joints that slide, with :math:`g = J^T d`. A standard deviation below that of gear and drive losses is of
    no use; it is ``LOSSES``.

    Args:
        model, robot, kinematics: of the arm.
        q: joint angles ``(n,)`` [rad].
        direction: of the force ``(3,)`` [base frame].
        scatter: standard deviation of the torques from cycle to cycle ``(n,)`` [N m].
        force: F, up to which it is pressed [N].
    """

    def __init__(self, model: Model, robot: Robot, kinematics: InverseKinematics, q: Array, direction: Array,
                 scatter: Array, force: float) -> None:
        self._T, self._force = robot.t_ipo, force
        self._loud = (kinematics.torque(q, direction) / np.maximum(scatter, _QUIET)) ** 2
        rates = np.abs(kinematics.away(q, _SMALL * direction)) / _SMALL
        self._ways = SLIDES * model.friction.distance / np.maximum(rates, ROUNDING)

    def seconds(self, way: float) -> float:
        """Time t in which the force has to rise after a straight motion of the distance ``way`` [m]."""
        told = float(np.sum(self._loud[self._ways <= way]))
        return 12.0 * self._T / (LOSSES * self._force) ** 2 / max(told, ROUNDING)

    def fastest(self, stiffness: float, way: float) -> float:
        """Largest speed [m/s] on a contact of a stiffness [N/m], after a distance [m], that measures the gain."""
        return self._force / (stiffness * self.seconds(way))

    def quickest(self, stiffness: float) -> tuple[float, float]:
        """Distance through air [m] and the speed after it [m/s] with which the gain is measured in the shortest time.

        The longer the distance, the more joints slide, and the faster the force may rise.
        """
        plans = [(float(way), self.fastest(stiffness, float(way))) for way in self._ways]
        return min(plans, key=lambda plan: (plan[0] + self._force / stiffness) / plan[1])


# Along a path: the force that the motor torques show beyond that of the force sensor.

HEARD = 0.01
"""Time after which the motors are asked again [s]; a cycle of 12 ms asks each time."""
SPAN = 0.012
"""Time between the motor angles that speed and acceleration are taken from [s]: shorter, and encoders are heard."""
LASTS, WAY = 0.5, 0.004
"""Time and way over which the torque that a model does not know at all stays as it is [s, rad]."""
FADES = 0.2
"""Way over which the friction beside the model's does [rad]."""
STILL = 1e-6
"""Speed below which a joint stands still [rad/s]."""
GROWS = 35.0
"""By how much more a sensor may be wrong a metre further on, one standard deviation [N/√m]. With the others, sound
sensors come to 11 N on the simulated KR 6, of 13 N that stop it: ``glue`` at 0.3, 0.1, 0.05, 0.013 and 0.007 m/s,
``force_wave`` at 0.2, 0.1 and 0.05, ``contour`` at 0.1 and 0.03."""


class BeyondSensor:
    r"""Contact force that the motor torques show and the force sensor does not, estimated as a random walk.

    With the torque :math:`g_j` of one newton of contact in joint j, the residual of model and sensor is

    .. math:: r_j = \tau_j - \tau_{M,j} + g_j F = - g_j e + \zeta_j b_j + \nu_j, \qquad
              \mathrm{var}\, \nu_j = \frac{2\, u_j^2}{T} (t_0 + x_0 / |\dot q_j|)

    :math:`\tau_M` is the model's torque of the measured motion, not of the desired one: the arm oscillates on its
    gears, and a joint reverses earlier or later. The direction of sliding ζ is followed along the motor angles (Dahl,
    see ``ideal_robot.friction.presliding``). Friction b beside the model's is as large as its residual σ and stays as
    it is for a way, slow joints' for long: it turns round with the motion, the force e does not, which tells them
    apart. What is left, ν, is the residual, and of the friction :math:`\tau_F` what has not turned yet, :math:`u =
    \sigma + (1 - |\zeta|)\, \tau_F`; that stays as it is for a time and a way.

    Args:
        model: of the arm, which says how large its residual σ is.
        T: cycle [s].
    """

    def __init__(self, model: Model, T: float) -> None:
        self._model, self._T = model, T
        self._apart = max(round(SPAN / T), 1)
        self._heard: deque[tuple[Array, Array, Array, Array]] = deque(maxlen=2 * self._apart + 1)
        self._distance = model.friction.distance
        self._sliding = np.zeros(model.n)
        self._waited = self._travelled = 0.0
        self._filter = KalmanFilter(dim_x=1 + model.n, dim_z=model.n)
        self._filter.x = np.zeros(1 + model.n)
        self._filter.P = np.diag(np.r_[0.0, model.noise_std**2])

    @property
    def excess(self) -> float:
        """The present force e beyond the sensor's [N]."""
        return float(self._filter.x[0])

    def hear(self, measured: RobotState, torque: Array, felt: float, speed: float) -> None:
        """Adds one cycle in contact; ``weigh`` evaluates it.

        Args:
            measured: at its end; torques that are NaN say nothing, and motions before and after do not belong together.
            torque: joint torques of one newton of contact ``(n,)`` [N m/N].
            felt: normal force of the sensor [N].
            speed: of the tip along the surface [m/s].
        """
        if not np.isfinite(measured.tau).all():
            self._heard.clear()
            return
        if self._heard:
            self._sliding = slid(self._sliding, measured.q - self._heard[-1][0], self._distance)
        self._heard.append((measured.q, self._sliding, measured.tau, torque * felt))
        self._torque = torque
        self._waited, self._travelled = self._waited + self._T, self._travelled + abs(speed) * self._T

    def stood(self) -> None:
        """Resets friction after a standstill, as motions before and after it are independent."""
        self._heard.clear()
        self._sliding = np.zeros(self._model.n)
        self._filter.x[1:] = 0.0
        self._filter.P = np.diag(np.r_[self._filter.P[0, 0], self._model.noise_std**2])

    def weigh(self) -> None:
        """Updates the estimated force beyond the sensor's from the last cycles, once per complete block."""
        if self._waited < HEARD or len(self._heard) < 2 * self._apart + 1:
            return
        waited, torque, apart = self._waited, self._torque, self._apart * self._T
        (before, *_), (q, sliding, tau, sensed), (after, *_) = (self._heard[i * self._apart] for i in range(3))
        v, a = (after - before) / (2 * apart), (after - 2 * q + before) / apart**2
        rest = tau - self._model.inverse_dynamics(q, v, a, direction=sliding[None])[0] + sensed
        fade = np.exp(-np.abs(v) * waited / FADES)
        grows = np.r_[GROWS**2 * self._travelled, self._model.noise_std**2 * (1.0 - fade**2)]
        self._filter.predict(F=np.diag(np.r_[1.0, fade]), Q=np.diag(grows))
        self._filter.update(rest, R=np.diag(self._unknown(v, sliding) / waited),
                            H=np.column_stack([-torque, np.diag(sliding)]))
        self._waited = self._travelled = 0.0

    def _unknown(self, v: Array, sliding: Array) -> Array:
        """Spectral density ``(n,)`` [N² m² s] of ν, at speeds ``(n,)`` [rad/s]."""
        speed, forward = np.maximum(np.abs(v), STILL), np.ones((1, len(v)))
        friction = self._model.friction.torque(speed[None], None, None, forward)[0]
        unknown = self._model.noise_std + (1.0 - np.abs(sliding)) * friction
        return np.asarray(2.0 * unknown**2 * (LASTS + WAY / speed))
