"""A run without devices before the run with them: whatever is compiled or loaded late is loaded now."""

from __future__ import annotations

import numpy as np

from ideal_robot.execution.command_governor import CommandGovernor
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from scenes.cycle import Task
from scenes.follow.live_camera import EvaluatedField, Predict
from sensing.camera.camera_device import WindowsAt
from sensing.camera.field import Field
from sensing.camera.line_detection import LineField
from sensing.force.wrench import WrenchSample


class ImaginedCamera:
    """A camera that sees the line where it is predicted; a ``sensing.camera.camera_device.Camera``.

    Attributes:
        predict: see ``scenes.follow.live_camera.Predict``.
    """

    def __init__(self) -> None:
        self.predict: Predict | None = None
        self._asked: list[float] = []

    def request(self, t0: float, t1: float, windows: WindowsAt) -> None:
        """See ``Camera.request``."""
        self._asked.append(t0)

    def arrived(self, t: float) -> list[Field]:
        """See ``Camera.arrived``."""
        asked, self._asked = self._asked, []
        return [self._field(at) for at in asked[-1:]] if self.predict is not None else []

    def _field(self, t: float) -> EvaluatedField:
        if self.predict is None:
            raise ValueError("nothing to predict with")
        points = self.predict(t).points
        m = len(points)
        seen = LineField(t, points, np.zeros((m, 2)), np.zeros(m), np.full(m, 1e-4), np.ones(m), np.ones(m, dtype=bool),
                         True, "")
        return EvaluatedField(t, t, (), (), seen)


class ImaginedForce:
    """A sensor that feels what it is told; a ``sensing.force.force_device.ForceSensor``.

    Attributes:
        wrench: what it feels ``(6,)`` [N, N m].
    """

    def __init__(self) -> None:
        self.wrench = np.zeros(6)

    def arrived(self, t: float) -> list[WrenchSample]:
        """See ``ForceSensor.arrived``."""
        return [WrenchSample(at, t, self.wrench) for at in (t - 0.008, t - 0.004, t) if at >= 0.0]


def rehearse(task: Task, robot: Robot, cycles: int, first: int = 0) -> None:
    """Plays cycles with an arm that does at once what is desired.

    Args:
        task: to be thrown away afterwards.
        robot: with the controller's cycle.
        cycles: how many.
        first: number of the first one.
    """
    T, q = robot.t_ipo, task.q_start
    q_d = np.tile(q, (task.n_d, 1))
    governor = CommandGovernor(robot, q, t_ipo=T)
    for k in range(first, first + cycles):
        t = k * T
        task.observe(t, q, q_d)
        q_d = task.plan(t, q_d)
        governor.allowed(task.command(t, q_d))
        task.request(t, t + T)
        task.collect(t, t + T, RobotState(t + T, q_d[0], np.zeros_like(q)))
        q = q_d[0]
