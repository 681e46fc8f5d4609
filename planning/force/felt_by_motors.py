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

HEARD = 0.01
"""Time after which the motors are asked again [s]; a cycle of 12 ms asks each time."""
COARSE = 1.1
"""Noise of what the motors feel within a second, in standard deviations of the model's residual [√s]: vibrations and
friction that turns count, too."""
STILL = 1e-6
"""Speed below which a joint stands still [rad/s]."""
DRY, OVER = 0.1, 0.005
"""Share of dry friction that a model does not know, and the way over which that changes [rad]."""
CREEPS = 0.003
"""Speed of a joint below which what is not known lasts so long that it no longer averages out [rad/s]."""
GROWS = 17.0
"""By how much more a sensor may be wrong a second later, one standard deviation [N/√s]. With the others, sound
sensors come to 9 N on the simulated KR 6, at 0.2 m/s as at 20, 4 and 0.3 mm/s (``force_wave``)."""


class BeyondSensor:
    r"""Force that the motors feel and the force sensor does not: a random walk, seen through the joints that slide.

    With the torque :math:`g_j` of one newton of contact in joint j and the rest that neither model nor sensor explain,

    .. math:: z = - \frac{\sum_j w_j g_j r_j}{\sum_j w_j g_j^2}, \qquad r = \tau - \tau_M + g F, \qquad
              w_j = \frac{T}{c^2 \sigma_j^2 + 2 \tau_{U,j}^2\, x / |\dot q_j|\, (1 + v_0 / |\dot q_j|)}, \qquad
              \mathrm{var}\, z = \frac{1}{\sum_j w_j g_j^2}

    The direction of sliding ζ in :math:`\tau_M` is followed along the commands (Dahl, see
    ``ideal_robot.friction.presliding``), however slowly the joints creep. Of the sliding friction :math:`\tau_F` the
    model does not know :math:`\tau_U = (d + 1 - |\zeta|)\, \tau_F`: a share d, and what there is left to turn. That
    stays as it is over a way x, so it is noise with that density; below :math:`v_0` it lasts longer than a fault may.
    The slower a joint, the less it tells, and at rest nothing.

    Args:
        model: of the arm, which says how large its residual σ is.
        T: cycle [s].
    """

    def __init__(self, model: Model, T: float) -> None:
        self._model, self._T = model, T
        self._commands: deque[Array] = deque(maxlen=round(BEHIND / T) + 2)
        laws = model.friction.laws
        # Friction without presliding turns at once.
        self._distance = np.array([float(law.shape[-1, 0]) if law.presliding else 1e-12 for law in laws])
        self._sliding = np.zeros(model.n)
        self._heard: tuple[RobotState, Array, Array, Array, float] | None = None
        self._waited = 0.0
        self.excess = 0.0
        """The force now [N]."""
        self._variance = 0.0

    def commanded(self, q_d: Array) -> None:
        """Takes the desired joint angles of a cycle ``(n,)`` [rad]."""
        self._commands.append(q_d)
        if len(self._commands) > 1:
            step = self._commands[1] - self._commands[0]
            end = np.sign(step)
            self._sliding = end + (self._sliding - end) * np.exp(-np.abs(step) / self._distance)

    def hear(self, measured: RobotState, torque: Array, felt: float) -> None:
        """One cycle in contact, of which ``weigh`` makes something.

        Args:
            measured: at its end; torques that are NaN say nothing.
            torque: joint torques of one newton of contact ``(n,)`` [N m/N].
            felt: normal force that the sensor tells [N].
        """
        if len(self._commands) < 3 or not np.isfinite(measured.tau).all():
            return
        before, here, after = list(self._commands)[:3]
        v, a = (after - before) / (2 * self._T), (after - 2 * here + before) / self._T**2
        self._heard, self._waited = (measured, v, a, torque, felt), self._waited + self._T

    def weigh(self) -> None:
        """Makes of what was heard last how much more the motors feel, if it is time."""
        if self._heard is None or self._waited < HEARD:
            return
        (measured, v, a, torque, felt), waited = self._heard, self._waited
        self._heard, self._waited = None, 0.0
        model, one = self._model, self._sliding[None]
        expected = model.inverse_dynamics(measured.q, v, a, direction=one)[0]
        rest = measured.tau - expected + torque * felt
        weight = waited / (COARSE**2 * model.noise_std**2 + self._unknown_friction(v))
        self._variance += GROWS**2 * waited
        known = 1.0 + self._variance * float(torque @ (weight * torque))
        self.excess -= self._variance * float(torque @ (weight * (rest + torque * self.excess))) / known
        self._variance /= known

    def _unknown_friction(self, v: Array) -> Array:
        """Spectral density ``(n,)`` [N² m² s] of the friction that is not known, at speeds ``(n,)`` [rad/s]."""
        at, one = np.maximum(np.abs(v), STILL), np.ones((1, len(v)))
        share = DRY + 1.0 - np.abs(self._sliding)
        unknown = share * self._model.friction.torque(at[None], None, None, one)[0]
        return np.asarray(2.0 * unknown**2 * OVER / at * (1.0 + CREEPS / at))
