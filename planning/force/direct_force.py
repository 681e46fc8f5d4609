"""Direct force feedback, [L] (1): the usual way, and the baseline."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from planning.force.contact import Phase
from planning.force.force_follower import SurfaceFollower
from planning.path.kinematics import InverseKinematics


class DirectForceFeedback:
    r"""Adds the force error, times a gain, to the command at every cycle.

    .. math:: x_c(k) = x_c(k-1) + (x_r(k) - x_r(k-1)) + K_p\, \Delta s(k) + K_d\, (\Delta s(k) - \Delta s(k-1))

    [L] (1) with the reference's own motion added; Δs is the force error along the nominal normal. The approach is the
    follower's, whose phases it shares: only what keeps the force differs.

    Args:
        follower: for reference, phases and the record of poses; its map is not used.
        k_p: gain [m/N per cycle].
        k_d: gain on the change of the error [m/N].
        limit: largest change of the command in a cycle [m].
    """

    def __init__(self, follower: SurfaceFollower, k_p: float, k_d: float = 0.0, limit: float = 0.002) -> None:
        if not k_p >= 0:
            raise InputError("expected zero or a positive number", field="k_p", value=k_p)
        self._follower, self._k_p, self._k_d, self._limit = follower, k_p, k_d, limit
        self._kinematics = InverseKinematics(follower.robot)
        self._height: float | None = None
        self._error = self._last_error = 0.0
        self._q = follower.q_start
        self.lifted = 0.0
        """How far the tip has been lifted at the end [m]."""

    def update(self, force: float) -> None:
        """Takes the newest normal force [N]."""
        self._error = force - self._follower.settings.force

    def command(self, t: float, q_d: Array) -> Array:
        """Commanded joint angles ``(n,)``; ``q_d`` is the follower's horizon, which it keeps to before contact."""
        follower = self._follower
        if follower.phase is Phase.APPROACH:
            self._q = q_d[0].copy()
            return self._q
        if self._height is None:
            pose = self._kinematics.fk(self._q)
            self._height = float(follower.reference.project(pose.translation[None], 0.0)[2][0])
            self._last_error = self._error
        change = self._k_p * self._error + self._k_d * (self._error - self._last_error)
        self._last_error = self._error
        if follower.phase in (Phase.LIFT, Phase.DONE):
            change = 0.05 * follower.robot.t_ipo
            self.lifted += change
        self._height += float(np.clip(change, -self._limit, self._limit))
        s = follower.s_at(t)
        frames = follower.reference.frames(np.array([s]))
        target = pin.SE3(follower.reference.rotation(s), frames.position[0] + self._height * frames.up[0])
        self._q = self._kinematics.refine([target], self._q[None])[0]
        return self._q.copy()
