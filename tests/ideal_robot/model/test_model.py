"""Model files of others: what does not fit together is refused with its key."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.feedforward.precorrection import Precorrection
from ideal_robot.feedforward.registry import feedforward
from ideal_robot.identification.friction_runs import fit_ripple
from ideal_robot.loop.from_model import loop_model
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.sources import MODELS

SHIPPED = MODELS / "kr6.json"


def _set(values: Any, path: str, new: Any) -> None:
    *parts, last = (int(part) if part.isdigit() else part for part in path.split("/"))
    for part in parts:
        values = values[part]
    values[last] = new


@pytest.mark.parametrize(("path", "new"), [
    ("controller/delay", None), ("controller/delay", "soon"), ("controller/k_p", [1.0]), ("controller/k_p", 3.0),
    ("controller/filter_order", 2.5), ("controller/t_cycle", 0.0), ("controller/k_i/0", None), ("controller", [1]),
    ("base/values/0", None), ("base/values", [1.0]), ("base/grouping", [[1.0]]), ("base/grouping/0/0", None),
    ("base/independent/0", 9999), ("base/independent/0", "a"), ("base/full_names", ["a"]), ("base/gravitational", [1]),
    ("friction", []), ("friction/0/coefficients/0", [None]), ("friction/0/law", "magic"), ("friction/0/law", [1]),
    ("friction/0/shape", "x"), ("covariance", [[0.0]]), ("covariance", None), ("noise_std", [1.0] * 7),
    ("consistent", "text"), ("stiffness", [0.0] * 6), ("stiffness", [1.0]), ("robot/urdf", "<robot/>"),
    ("robot/urdf", None), ("robot/name", "[/red]\x1b"), ("effects", [{}]), ("effects", 3), ("effects", [3]),
    ("effects", [{"name": "unknown", "joint": 1, "coefficients": [1.0], "data": {}}]),
    ("effects", [{"name": "torque_ripple", "joint": 1, "channel": "tau_1", "coefficients": [1.0], "theta": [250.0]}]),
    ("effects", [{"name": "gear_elasticity", "joint": 99, "coefficients": [1.0], "channel": "qa_99"}]),
    ("provenance", 3), ("schema", "1"), ("schema", 99), ("schema", True),
])
def test_a_model_that_does_not_fit_together_is_refused(path: str, new: Any, tmp_path: Path) -> None:
    values = json.loads(SHIPPED.read_text())
    _set(values, path, new)
    file = tmp_path / "model.json"
    file.write_text(json.dumps(values))
    with pytest.raises(InputError) as refused:
        Model.load(file)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 1000


@pytest.mark.parametrize("text", ["", "[" * 100_000, '{"a":' * 100_000, "nan", "3", "[]", "{}", '{"schema": 1}', "\0",
                                  '{"schema": 1e999}', '{"schema": NaN}', '{"schema": ' + "9" * 5000 + "}"])
def test_what_is_no_model_is_refused(text: str, tmp_path: Path) -> None:
    file = tmp_path / "model.json"
    file.write_text(text)
    with pytest.raises(InputError) as refused:
        Model.load(file)
    assert refused.value.file == file


# A model of another arm is refused wherever a model meets a robot.

KR15, KR6 = Model.load(MODELS / "kr15.json"), Robot.load("kr6")
RECORDING = Recording.from_arrays(np.arange(200) * 0.012, q=np.zeros((200, 6)), x=np.zeros(200))


@pytest.mark.parametrize("meet", [
    IdealRobot.of, Precorrection, loop_model, lambda model, robot: feedforward("ideal", model, robot),
    lambda model, robot: fit_ripple([RECORDING], model, robot),
], ids=["ideal", "precorrection", "loop", "registry", "ripple"])
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
