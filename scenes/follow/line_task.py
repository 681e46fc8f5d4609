"""What following a line on devices does in each cycle: where the cycle is short, planned in the one before."""

from __future__ import annotations

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError
from ideal_robot.robots.interface import RobotState
from scenes.follow.live_arm import LiveArm
from scenes.line.task import LineTask

AT_ONCE = 0.008
"""Cycle from which on there is time to plan with a field between packet and answer [s]."""


class LiveLineTask(LineTask):
    """``LineTask`` with an arm that may have to be stopped.

    Behind short cycles an answer waits for no field: as soon as the command of a cycle has gone, the plan of the next
    one is made with the fields that are there by then. What is left between packet and answer is one step of the
    feedforward along that plan. A field takes effect a cycle later for it; the map it goes into is one over places
    ([L] 4.3), to which its age makes no difference.
    """

    arm: LiveArm | None = None
    ahead = False
    """Whether each cycle is planned in the one before."""
    _prepared: tuple[int, Array | IdealRobotError] | None = None

    def lead(self, arm: LiveArm) -> None:
        """From now on with this arm, which is at rest at the start."""
        self.arm, self.ahead = arm, self._T < AT_ONCE
        if self.ahead:
            arm.between.append(lambda: self.prepare(arm.t + self._T))

    def prepare(self, t: float) -> None:
        """Plans the cycle that begins at ``t`` [s], with what has come by now; nobody waits for it yet."""
        self.take_fields(t)
        try:
            found: Array | IdealRobotError = self.sensed_plan(t)
        except IdealRobotError as error:
            found = error
        self._new = []
        self._prepared = round(t / self._T), found

    def observe(self, t: float, q: Array, q_d: Array) -> None:
        """See ``scenes.cycle.Task``.

        Args:
            t: begin of the cycle [s].
            q: motor angles ``(n,)`` [rad].
            q_d: horizon of the last cycle ``(n_d, n)`` [rad].
        """
        if not self.ahead:
            self.take_fields(t)
        self.take_angles(t, q, q_d)

    def plan(self, t: float, q_d: Array) -> Array:
        """See ``scenes.cycle.Task``."""
        if self.arm is not None:
            self.arm.check(t)
        number, prepared = self._prepared or (-1, None)
        self._prepared = None
        if self._new or prepared is None or number != round(t / self._T):
            # There is time for a field, or this is one of several lost cycles that are made good at once.
            return self.sensed_plan(t)
        if isinstance(prepared, IdealRobotError):
            raise prepared
        return prepared

    def command(self, t: float, q_d: Array) -> Array:
        """See ``scenes.cycle.Task``."""
        if self.arm is not None:
            self.arm.q_d = q_d[0]
        return super().command(t, q_d)

    def collect(self, t0: float, t1: float, measured: RobotState) -> None:
        """Lets a feedforward that adapts learn; the pictures are in another process, none is kept.

        Args:
            t0: begin of the cycle [s].
            t1: its end [s].
            measured: what the controller reported at its end.
        """
        self._state = self.feedforward.observe(self._state, measured)
