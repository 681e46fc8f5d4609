"""A model of another arm is refused wherever a model meets a robot."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ideal_robot.elasticity.observer_adaptation import adapt_observer
from ideal_robot.errors import InputError
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.feedforward.precorrection import Precorrection
from ideal_robot.feedforward.registry import feedforward
from ideal_robot.identification.ripple_fit import fit_ripple
from ideal_robot.loop.from_model import loop_model
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording

MODELS = Path(__file__).parents[3] / "scenes" / "models"
KR15, KR6 = Model.load(MODELS / "kr15.json"), Robot.load("kr6")
RECORDING = Recording.from_arrays(np.arange(200) * 0.012, q=np.zeros((200, 6)), x=np.zeros(200))


@pytest.mark.parametrize("meet", [
    IdealRobot.of, Precorrection, loop_model, lambda model, robot: feedforward("ideal", model, robot),
    lambda model, robot: adapt_observer(RECORDING, robot, model),
    lambda model, robot: fit_ripple([RECORDING], model, robot),
], ids=["ideal", "precorrection", "loop", "registry", "observer", "ripple"])
def test_a_model_of_another_arm_is_refused(meet: Callable[[Model, Robot], object]) -> None:
    with pytest.raises(InputError, match="sits elsewhere than that of") as caught:
        meet(KR15, KR6)
    assert caught.value.field == "model"


def test_the_file_is_named() -> None:
    with pytest.raises(InputError, match=r"kr15\.json: model: "):
        KR15.require_arm(KR6, file="kr15.json")


def test_a_calibrated_arm_is_still_the_same() -> None:
    calibrated = KR6.pinocchio.copy()
    calibrated.jointPlacements[2].translation += 0.003
    Model.load(MODELS / "kr6.json").require_arm(dataclasses.replace(KR6, pinocchio=calibrated))
