"""Whatever is asked for in whichever loop, commands keep the limits, also when there is no further one."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.safe_loops import INPUTS, LOOPS, ROWS
from ideal_robot.feedforward.registry import feedforward
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.models import shipped_model


@pytest.mark.parametrize("loop", list(LOOPS))
@pytest.mark.parametrize("key", ["none", "ideal"])
def test_commands_keep_every_limit(loop: str, key: str) -> None:
    robot = Robot.load("kr6")
    law = feedforward(key, Model.load(shipped_model("kr6")), robot, n_d=ROWS)
    worst = np.max([LOOPS[loop](law, robot, kind, 150).worst for kind in INPUTS], axis=0)
    assert np.all(worst <= 1.0 + 1e-6), worst
    assert worst[1] > 0.5
