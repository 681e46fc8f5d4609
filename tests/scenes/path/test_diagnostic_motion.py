"""The motion that is diagnosed has been wherever the path goes, within the limits."""

from __future__ import annotations

import dataclasses

import numpy as np

from scenes.path.cell import PathCell, training_path
from scenes.path.diagnostic_motion import covering, diagnostic_motion
from sim.arm.world import World
from tests.scenes.path import kind_arm as arm


def cell(robot=arm.ROBOT) -> PathCell:
    return PathCell(robot, World.from_table(robot.name, {}), arm.model(), arm.path(), "motor", 1)


def test_it_reaches_both_ends_of_the_path_in_every_joint() -> None:
    """By itself the motion that training learns from stops up to a third short of one end."""
    path = arm.path().q_d
    short = training_path(arm.path(), arm.ROBOT.t_ipo).q_d
    q = diagnostic_motion(cell()).q_d
    assert np.any(short.max(axis=0) < path.max(axis=0))
    assert np.all(q.max(axis=0) >= path.max(axis=0))
    assert np.all(q.min(axis=0) <= path.min(axis=0))


def test_it_keeps_to_the_limits_of_joints_and_speeds() -> None:
    path = arm.path().q_d
    wide = diagnostic_motion(cell()).q_d
    speed = np.max(np.abs(np.diff(wide, axis=0)), axis=0) / arm.ROBOT.t_ipo
    tight = dataclasses.replace(arm.ROBOT, q_min=path.min(axis=0) - 1e-3, q_max=path.max(axis=0) + 1e-3,
                                v_max=0.5 * speed)
    q = covering(training_path(arm.path(), tight.t_ipo).q_d, path, tight)
    moving = np.ptp(path, axis=0) > np.radians(8.0)
    assert moving.any()
    assert np.all((q >= tight.q_min - 1e-9) & (q <= tight.q_max + 1e-9), axis=0)[moving].all()
    slow = diagnostic_motion(cell(dataclasses.replace(arm.ROBOT, v_max=0.5 * speed))).q_d
    assert np.all(np.abs(np.diff(slow, axis=0)) / arm.ROBOT.t_ipo <= 0.5 * speed * (1.0 + 1e-6))
    assert len(slow) > 1.9 * len(wide)
