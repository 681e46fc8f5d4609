"""Following a contour without a reference path, by an arm that goes where it is told."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.robots.robot import Robot
from planning.force.contour import ContourFollower, ContourSettings

TURNED = np.radians(15.0)
"""Of the wall against the direction that it is looked for in."""


def test_the_felt_path_tells_the_normal_whatever_friction_pulls_at_the_tip() -> None:
    """Friction of 0.4 turns the force by 22°; by the force alone the normal would be as far off."""
    robot = Robot.load("kr6")
    data = robot.pinocchio.createData()
    pin.framesForwardKinematics(robot.pinocchio, data, robot.home)
    start = data.oMf[robot.tool_id].copy()
    towards, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    settings = ContourSettings(friction=0.0, length=0.1)
    follower = ContourFollower(robot, start, towards, up, 1, robot.home, 20, settings)
    out = np.array([-np.cos(TURNED), np.sin(TURNED)])
    along = np.array([out[1], -out[0]])
    axes, fk, late, pressed = np.stack([towards, np.cross(up, towards)]), robot.fk(), None, []
    for k in range(1, 400):
        t = k * robot.t_ipo
        if late is not None:
            follower.update_force(np.array([late[0]]), late[1][None])
        q = follower.horizon(t)[0]
        follower.observe(t, q)
        tip = fk(q)
        here = axes @ (tip.translation - start.translation)
        depth = -(here - [0.005, 0.0]) @ out
        push = settings.elasticity * max(float(depth), 0.0)
        force = push * out - (0.4 * push * along if follower.moving else 0.0)
        late = (t, tip.rotation.T @ (axes.T @ force))
        if follower.travelled > 0.075:
            pressed.append((push, follower._normal @ out))
        if follower.travelled >= settings.length - 1e-5:
            break
    force, aligned = np.array(pressed).T
    assert np.degrees(np.arccos(aligned.min())) < 2.0
    assert np.abs(force - settings.force).max() < 2.0
