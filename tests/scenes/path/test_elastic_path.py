"""What knowing the gears is worth on the arm side ([L] 3.3), stiffness from the clamped procedure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ideal_robot.elasticity.stiffness_analysis import analyse_stiffness
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.robots.robot import Robot
from scenes import load_scene
from scenes.clamped.play import configurations, record
from scenes.clamped.scene import ClampedScene
from scenes.path.cell import set_up
from sim.contact.clamp_world import ClampWorld


def test_arm_error_of_the_kr15_with_clamped_stiffness() -> None:
    """≤ 40 % of the same precorrection on motor angles alone, on the ISO 9283 path, measured at the arm."""
    robot = Robot.load("kr15")
    clamped = ClampedScene(name="kr15", kind="clamped", title="KR 15 clamped", robot="kr15", clamp={"hold": 0.8})
    rng = np.random.default_rng(5)
    recordings, _ = record(clamped, robot, ClampWorld.from_table(robot, {}), configurations(clamped, robot, rng), rng)
    found = analyse_stiffness(recordings, robot, "wrench").by("wrench")
    stiffness = np.array([found[joint].stiffness for joint in range(1, robot.n + 1)])
    place = set_up(load_scene("iso9283_1"), delay=False)
    loop = replace(place.loop(), stiffness=stiffness)
    motors_only = place.play(IdealRobot(loop, 30, elastic=False)).errors
    with_gears = place.play(IdealRobot(loop, 30)).errors
    assert with_gears.time_matched.E_car <= 0.4 * motors_only.time_matched.E_car
    assert with_gears.geometric.E_car <= 0.4 * motors_only.geometric.E_car
