"""Method `adapted` on known paths: friction's shape over speed and inertia, learned from the motors."""

from __future__ import annotations

from pathlib import Path

import pytest

from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.friction_adaptation import AdaptedIdeal, FrictionAdaptation
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.feedforward.method import Setting
from scenes import load_scene
from scenes.methods import ADAPTED, IDEAL
from scenes.options import chosen
from scenes.path.kind import run


def two_factors(setting: Setting) -> Feedforward:
    """What `adapted` would be without shape and inertia."""
    robot, ideal = setting.robot, IdealRobot(setting.loop(), setting.horizon(30))
    tool = robot.tool_place
    start = AdaptedIdeal(ideal, FrictionAdaptation(ideal.loop, tool=tool))
    practice = setting.plays()
    known = practice.play(start, practice.motion(setting.path())).state
    return AdaptedIdeal(ideal, start.adaptation, known.factors)


@pytest.mark.parametrize(("name", "bound"), [("vertical_circle", 0.95), ("iso9283_1", 0.85), ("edge", 1.03)])
def test_what_is_played_on_known_paths_learns_the_shape_of_friction_and_inertia(name: str, bound: float) -> None:
    scene = load_scene(name)
    shape, factors = (run(scene, method=method).errors.time_matched.E_car for method in (ADAPTED, two_factors))
    assert shape < bound * factors


def test_with_another_arms_model_it_learns_what_this_arm_weighs_and_how_its_torques_ripple() -> None:
    models = Path(__file__).parents[3] / "scenes" / "models"
    scene = chosen(load_scene("iso9283_1"), individual=2).changed(model=str(models / "kr15.json"))
    learned, fixed = (run(scene, method=method).errors.aligned.E_car for method in (ADAPTED, IDEAL))
    assert learned < 0.6 * fixed
