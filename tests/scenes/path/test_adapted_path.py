"""Method `adapted` on known paths: friction's shape over speed, learned from the motors, beside the two factors."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal, FrictionAdaptation
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.feedforward.method import Setting
from scenes import load_scene
from scenes.methods import ADAPTED
from scenes.path.kind import run


def two_factors(setting: Setting) -> Feedforward:
    """What `adapted` would be without the shape."""
    robot, ideal = setting.robot, IdealRobot(setting.loop(), setting.horizon(30))
    tool = np.array(robot.pinocchio.frames[robot.tool_id].placement.translation)
    start = AdaptedIdeal(ideal, FrictionAdaptation(ideal.loop, tool=tool))
    practice = setting.plays()
    known = practice.play(start, practice.motion(setting.path())).state
    return AdaptedIdeal(ideal, start.adaptation, known.factors)


@pytest.mark.parametrize(("name", "bound"), [("vertical_circle", 0.95), ("edge", 1.03)])
def test_what_is_played_on_known_paths_learns_the_shape_of_friction(name: str, bound: float) -> None:
    scene = load_scene(name)
    shape, factors = (run(scene, method=method).errors.time_matched.E_car for method in (ADAPTED, two_factors))
    assert shape < bound * factors
