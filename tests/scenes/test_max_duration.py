"""A scene that would move for longer than it allows is refused before anything moves, whatever its kind."""

import pytest

from ideal_robot.errors import InputError
from scenes import load_scene, run_scene


@pytest.mark.parametrize(("name", "slow"), [("line", 7e-4), ("force_wave", 7e-4), ("iso9283_1", 1e-3)])
def test_a_motion_that_takes_too_long_is_refused_with_the_remedy(name: str, slow: float) -> None:
    with pytest.raises(InputError, match="max_duration"):
        run_scene(load_scene(name), speed=slow)


def test_the_scene_says_how_long_it_may_be() -> None:
    with pytest.raises(InputError, match=r"0\.5 s"):
        run_scene(load_scene("line"), max_duration=0.5)
