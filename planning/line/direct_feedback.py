"""Direct sensor feedback [L] (1): the usual way, and the baseline that the architecture is compared with."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from planning.line.line_follower import LineFollower, Uncorrected
from planning.line.measurement import SEEN_AHEAD, SeenLine
from planning.path.kinematics import InverseKinematics


class DirectFeedback(Uncorrected):
    r"""Adds the sensed deviation, times a gain, to the command at every cycle.

    .. math:: x_c(k) = x_c(k-1) + (x_r(k) - x_r(k-1)) + K_p\, \Delta s(k) + K_d\, (\Delta s(k) - \Delta s(k-1))

    [L] (1) with the reference's own motion added, in the path's lateral direction. The sensor signal is the lateral
    distance between what the last field showed of the line, at the point nearest to the TCP, and where the reference
    shows it, :math:`\Delta s = s_r - s` ([L] (4)), both as seen from the TCP. The signal stays until the next field
    comes. The arm's own motion since the exposure is not taken into account: that is the point of the comparison.

    Args:
        follower: a line follower, for its reference, its tables and its record of poses; its map is not used.
        k_p, k_d: gains on the deviation, per cycle, and on its change.
        limit: largest lateral correction [m]; beyond it the command stays, so that an unstable gain ends in a bad
            result rather than in a broken arm.
    """

    def __init__(self, follower: LineFollower, k_p: float, k_d: float = 0.0, limit: float = 0.06) -> None:
        if not k_p >= 0:
            raise InputError("expected zero or a positive number", field="k_p", value=k_p)
        super().__init__(follower)
        self._k_p, self._k_d, self._limit = k_p, k_d, limit
        self._kinematics = InverseKinematics(follower.robot)
        self.correction = 0.0
        """Lateral offset of the command from the reference [m]."""
        self._signal = self._last_signal = 0.0
        self._q: Array | None = None

    def update(self, line: SeenLine, pose: pin.SE3 | None = None) -> None:
        """Sets the sensor signal from a field; leaves it unchanged if the field showed nothing."""
        used = np.asarray(line.used, dtype=bool) & np.isfinite(line.points_tcp).all(axis=1)
        if not line.seen or not used.any():
            return
        f = self._follower
        pose = f.history.pose(line.t) if pose is None else pose
        points = line.points_tcp[used] @ pose.rotation.T + pose.translation
        s_tcp = f.profile.at(line.t - f.t_start)[0]
        s, lateral, _ = f.reference.project(points, s_tcp + SEEN_AHEAD)
        nearest = int(np.argmin(s))
        # The line as seen from the TCP against the reference as seen from the reference's TCP.
        _, own, _ = f.reference.project(pose.translation[None], s_tcp)
        self._signal = float(lateral[nearest] - own[0])

    def command(self, t: float, q_d: Array | None = None) -> Array:
        """Commanded joint angles ``q_c(k) (n,)`` [rad] at the cycle ``t``; to be called once a cycle."""
        change = self._k_p * self._signal + self._k_d * (self._signal - self._last_signal)
        self._last_signal = self._signal
        self.correction = float(np.clip(self.correction + change, -self._limit, self._limit))
        f = self._follower
        s = f.profile.at(t - f.t_start)[0]
        frames = f.reference.frames(s)
        target = pin.SE3(f.reference.rotation(s), frames.position + self.correction * frames.normal)
        guess = f.q_start if self._q is None else self._q
        self._q = self._kinematics.refine([target], guess[None])[0]
        return self._q.copy()
