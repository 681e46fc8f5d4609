"""Pictures for reports show the arm where it is."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from sim.arm.picture import picture


def test_a_kuka_is_orange_and_moves() -> None:
    robot = Robot.load("kr6")
    assert ET.parse(robot.urdf).getroot().find("./link/visual") is not None
    home = picture(robot, robot.home, width=240, height=180)
    assert home.shape == (180, 240, 3)
    assert home.dtype == np.uint8
    red, green, blue = home.astype(int).transpose(2, 0, 1)
    assert np.mean((red - blue > 60) & (red - green > 30)) > 0.05
    turned = picture(robot, robot.home + np.array([1.0, 0, 0, 0, 0, 0]), width=240, height=180)
    assert np.mean(np.abs(turned.astype(int) - home).max(axis=2) > 30) > 0.05


def test_a_path_is_drawn() -> None:
    robot = Robot.load("manutec_r15")
    view = {"width": 240, "height": 180, "target": (0.6, 0.0, 0.8), "distance": 3.0}
    line = np.array([[0.9, -0.4, 0.3], [0.9, 0.4, 0.3], [0.9, 0.4, 0.9]])
    without, drawn = picture(robot, robot.home, **view), picture(robot, robot.home, lines=[line], **view)
    assert np.any(np.abs(drawn.astype(int) - without).max(axis=2) > 30)


def test_posture_must_fit() -> None:
    with pytest.raises(InputError, match="6 joint angles"):
        picture(Robot.load("kr6"), np.zeros(5))
