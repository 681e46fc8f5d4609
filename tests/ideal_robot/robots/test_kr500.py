"""The KR 500's URDF against [J] table 1, through a chain written down independently of it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.robots.robot import Robot

# α_j, d_j, offset of θ_j, r_j of [J] table 1.
TABLE_1 = (
    (np.pi, 0.0, 0.0, -1.045),
    (np.pi / 2, 0.500, 0.0, 0.0),
    (0.0, 1.300, np.pi / 2, 0.0),
    (-np.pi / 2, -0.055, 0.0, -1.025),
    (np.pi / 2, 0.0, 0.0, 0.0),
    (-np.pi / 2, 0.0, -np.pi / 2, -0.290),
)
CONFIGURATIONS = ((1.62, -0.89, 1.84, 1.62, -np.pi / 2, 0.46), (1.48, -0.87, 1.37, np.pi, -1.05, 0.0))


def khalil_kleinfinger(q: np.ndarray) -> list[np.ndarray]:
    """Frames 1 … 6 in the base: each Rx(α) Tx(d) Rz(θ) Tz(r), written out as in Khalil & Kleinfinger (1986)."""
    frames = []
    total = np.eye(4)
    for (alpha, d, offset, r), angle in zip(TABLE_1, q, strict=True):
        c, s, ca, sa = np.cos(angle + offset), np.sin(angle + offset), np.cos(alpha), np.sin(alpha)
        total = total @ np.array([[c, -s, 0.0, d], [ca * s, ca * c, -sa, -r * sa], [sa * s, sa * c, ca, r * ca],
                                  [0.0, 0.0, 0.0, 1.0]])
        frames.append(total)
    return frames


def test_every_link_frame_is_that_of_the_table() -> None:
    robot = Robot.load("kr500")
    data = robot.pinocchio.createData()
    rng = np.random.default_rng(0)
    for q in (*CONFIGURATIONS, *rng.uniform(robot.q_min, robot.q_max, (50, 6))):
        pin.framesForwardKinematics(robot.pinocchio, data, np.array(q))
        expected = khalil_kleinfinger(np.array(q))
        for joint in range(6):
            # A joint frame of the URDF is the table's frame, moved by r_j along z_j already: the same frame.
            np.testing.assert_allclose(data.oMi[joint + 1].homogeneous, expected[joint], atol=1e-9)
        np.testing.assert_allclose(data.oMf[robot.tool_id].homogeneous, expected[-1], atol=1e-9)


@pytest.mark.parametrize(("configuration", "loaded"), [(0, {1}), (1, {2, 3})])
def test_pressing_along_z6_loads_the_joints_that_the_paper_says(configuration: int, loaded: set[int]) -> None:
    """[J] 4.2: configuration 1 is for joint 1, configuration 2 for joint 2, with f_z alone."""
    robot = Robot.load("kr500")
    q = np.array(CONFIGURATIONS[configuration])
    jacobian = pin.computeFrameJacobian(robot.pinocchio, robot.pinocchio.createData(), q, robot.tool_id, pin.LOCAL)
    lever = np.abs(jacobian[2])
    assert {int(j) + 1 for j in np.flatnonzero(lever > 0.2)} == loaded
    assert np.max(lever) > 1.5
    assert np.max(np.delete(lever, [j - 1 for j in loaded])) < 0.06
