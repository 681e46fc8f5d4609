"""What a force at the tool asks of the joints."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.dynamics.tool_force import felt_at_tool, torques_of_tool_force
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording


@pytest.mark.parametrize("name", ["kr6", "manutec_r15"])
def test_a_force_does_the_work_that_its_torques_do(name: str) -> None:
    robot, rng = Robot.load(name), np.random.default_rng(1)
    q = robot.home + rng.uniform(-0.3, 0.3, (5, robot.n))
    step = 1e-6 * rng.normal(size=q.shape)
    rotations = np.array([robot.fk()(row).rotation for row in q])
    moved = np.einsum("nkl,nk->nl", rotations, robot.tool_places(q + step) - robot.tool_places(q - step))
    work = np.einsum("nlj,nj->nl", torques_of_tool_force(robot, q), 2.0 * step)
    np.testing.assert_allclose(work, moved, rtol=1e-5, atol=1e-12)


def test_without_a_sensor_nothing_is_felt() -> None:
    t = np.arange(0.0, 1.0, 0.1)
    names = ("fx", "fy", "fz")
    whole = {"t": t, **{name: np.sin(t + k) for k, name in enumerate(names)}}
    felt = felt_at_tool(Recording(whole, {}), t)
    assert felt is not None
    np.testing.assert_allclose(felt, np.column_stack([whole[name] for name in names]), atol=0.05)
    assert felt_at_tool(Recording({"t": t, "fx": t, "fy": t}, {}), t) is None
