"""What fuzzing found, each pinned by the call that broke."""

from __future__ import annotations

import os

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.identification.excitation import design_excitation
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from scenes.detection.sources import pictures
from scenes.model_files import model_at
from scenes.scene_file import load_scene

LONG = "x" * 300


@pytest.mark.parametrize("name", [LONG, f"{LONG}.json", f"{LONG}.toml", f"{LONG}/a.toml", "a\0b.toml"])
def test_a_name_that_no_file_can_have_is_no_file(name: str) -> None:
    for read in (Robot.load, Model.load, load_scene, lambda n: model_at(n, Robot.load("kr6")),
                 lambda n: list(pictures(n))):
        with pytest.raises(InputError):
            read(name)
    assert not os.path.isfile(name)


@pytest.mark.parametrize("period", [np.inf, np.nan, 0.0, -1.0, 1e300])
def test_a_period_that_is_none_is_refused(period: float) -> None:
    with pytest.raises(InputError, match="period"):
        design_excitation(Robot.load("kr6"), np.random.default_rng(0), period=period)
