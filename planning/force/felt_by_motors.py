r"""The contact force as the motors feel it: a second witness, coarse and slow, that no force sensor can deceive.

What the motors give beyond the model's torque is what the environment takes, :math:`\tau = \tau_M - J^T F`, so along a
direction ``d`` with :math:`g = J^T d`, and each joint weighed by its drive's largest torque,

.. math:: F = - \frac{g^T W (\tau - \tau_M)}{g^T W g}, \qquad W = \mathrm{diag}(\tau_{max}^{-2})

Friction is as well known as that only while the joints slide on in the same direction. So the witness is heard in slow
straight motions alone, and against what it said at their begin, in the air.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from planning.path.kinematics import InverseKinematics

WINDOW = 0.4
"""Time over which the force is averaged [s]. On the simulated KR 6 at 10 mm/s it is then right within 5 N, one standard
deviation; over 0.1 s within 13 N."""
BEHIND = 0.024
"""By how much the motors are behind the commands [s], from which velocity and acceleration are taken."""


class FeltByMotors:
    """Force along one direction while the tip moves straight and slowly.

    Args:
        model: of the arm.
        robot: the arm with the controller's cycle.
        kinematics: of the arm.
        direction: of the force ``(3,)`` [base frame].
        settle: time after which friction has turned and the air is heard [s].
    """

    def __init__(self, model: Model, robot: Robot, kinematics: InverseKinematics, direction: Array,
                 settle: float = 0.4) -> None:
        self._model, self._kinematics, self._direction, self._T = model, kinematics, direction, robot.t_ipo
        self._weight = 1.0 / np.where(np.isfinite(robot.tau_max), robot.tau_max, 1.0) ** 2
        self._window, self._first = round(WINDOW / self._T), round(settle / self._T)
        self._commands: deque[Array] = deque(maxlen=round(BEHIND / self._T) + 3)
        self._forces: deque[float] = deque(maxlen=self._window)
        self._air = np.nan
        self._cycles = 0

    def add(self, q_c: Array, q: Array, tau: Array) -> None:
        """One cycle.

        Args:
            q_c: commanded joint angles ``(n,)`` [rad].
            q: measured ones ``(n,)`` [rad].
            tau: measured motor torques ``(n,)`` [N m]; NaN where the controller does not tell them.
        """
        self._commands.append(q_c)
        self._cycles += 1
        if len(self._commands) < 3 or self._cycles < self._first:
            return
        before, here, after = list(self._commands)[:3]
        v, a = (after - before) / (2 * self._T), (after - 2 * here + before) / self._T**2
        rest = tau - self._model.inverse_dynamics(q, v, a)[0]
        g = self._kinematics.torque(q, self._direction)
        self._forces.append(-float(g @ (self._weight * rest)) / float(g @ (self._weight * g)))
        if np.isnan(self._air) and len(self._forces) == self._window:
            self._air = float(np.mean(self._forces))

    @property
    def force(self) -> float:
        """Mean force of the last while beyond that in the air [N]; NaN while it is not known."""
        return np.nan if np.isnan(self._air) else float(np.mean(self._forces)) - self._air


# Along a path: what the motors feel beyond what the force sensor tells.

REVERSAL = 0.01
"""Speed of a joint below which its friction is as good as unknown, as it may turn [rad/s]."""
COARSE = 1.1
"""Noise of what the motors feel within a second, in standard deviations of the model's residual [√s]: vibrations and
friction that turns count, too."""
GROWS = 17.0
"""By how much more a sensor may be wrong a second later, one standard deviation [N/√s]. With both, sound sensors come
to 11 N on the simulated KR 6 (runs of three scenes with seeds 1 to 5, which also decided the three numbers)."""


class BeyondSensor:
    r"""Force that the motors feel and the force sensor does not: a random walk, seen through the joints that slide.

    With the torque :math:`g_j` of one newton of contact in joint j and the rest that neither model nor sensor explain,

    .. math:: z = - \frac{\sum_j w_j g_j r_j}{\sum_j w_j g_j^2}, \qquad r = \tau - \tau_M + g F, \qquad
              w_j = \frac{T}{c^2 \sigma_j^2 (1 + (v_0 / \dot q_j)^2)}, \qquad
              \mathrm{var}\, z = \frac{1}{\sum_j w_j g_j^2}

    A Kalman filter weighs it: where no joint slides, nothing is learned.

    Args:
        model: of the arm, which says how large its residual σ is.
        T: cycle [s].
    """

    def __init__(self, model: Model, T: float) -> None:
        self._model, self._T = model, T
        self._commands: deque[Array] = deque(maxlen=round(BEHIND / T) + 2)
        self.excess = 0.0
        """The force now [N]."""
        self._variance = 0.0

    def commanded(self, q_d: Array) -> None:
        """Takes the desired joint angles of a cycle ``(n,)`` [rad]."""
        self._commands.append(q_d)

    def hear(self, measured: RobotState, torque: Array, felt: float) -> None:
        """One cycle in contact.

        Args:
            measured: at its end; torques that are NaN say nothing.
            torque: joint torques of one newton of contact ``(n,)`` [N m/N].
            felt: normal force that the sensor tells [N].
        """
        if len(self._commands) < 3 or not np.isfinite(measured.tau).all():
            return
        before, here, after = list(self._commands)[:3]
        v, a = (after - before) / (2 * self._T), (after - 2 * here + before) / self._T**2
        rest = measured.tau - self._model.inverse_dynamics(measured.q, v, a)[0] + torque * felt
        friction = 1.0 + (REVERSAL / np.maximum(np.abs(v), 1e-6)) ** 2
        weight = self._T / (COARSE * self._model.noise_std) ** 2 / friction
        self._variance += GROWS**2 * self._T
        known = 1.0 + self._variance * float(torque @ (weight * torque))
        self.excess -= self._variance * float(torque @ (weight * (rest + torque * self.excess))) / known
        self._variance /= known
