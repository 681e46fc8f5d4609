"""A force sensor that has drifted and a contact taken for stiffer than it is: found, and told to the controller."""

from __future__ import annotations

import pytest

from ideal_robot.errors import InputError
from scenes import load_scene
from scenes.force.close_loop import close_loop, undeclared_effects
from scenes.scene_files.force_scene import ForceScene


def test_right_sensor_is_refused_and_a_wrong_one_named() -> None:
    right, wrong = load_scene("force_wave"), load_scene("close_force")
    assert isinstance(right, ForceScene)
    assert isinstance(wrong, ForceScene)
    assert undeclared_effects(wrong) == ("force_bias", "force_compliance")
    with pytest.raises(InputError, match="nothing is there"):
        close_loop(right)


@pytest.mark.slow
def test_after_is_close_to_the_truth() -> None:
    scene = load_scene("close_force")
    assert isinstance(scene, ForceScene)
    result = close_loop(scene)
    assert result.errors["after"].rms < 0.8 * result.errors["before"].rms
    assert result.errors["after"].rms <= 1.25 * result.errors["true"].rms
