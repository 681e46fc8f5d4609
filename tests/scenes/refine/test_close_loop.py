"""The whole circle: run, diagnose, extend, run again."""

from __future__ import annotations

import pytest

from ideal_robot.errors import InputError
from scenes import load_scene
from scenes.path.close_loop import close_loop, undeclared_effects
from scenes.path.scene import PathScene


@pytest.mark.slow
@pytest.mark.parametrize("name", ["close_stribeck", "close_elastic"])
@pytest.mark.parametrize("seed", [1, 2])
def test_after_is_close_to_the_oracle(name: str, seed: int) -> None:
    """Path error after ≤ 1.25 × that of an oracle told name and joint, and well below that of before."""
    result = close_loop(load_scene(name).model_copy(update={"seed": seed}))
    before, after, oracle = (e.aligned.E_car for e in (result.before, result.after, result.oracle))
    assert after <= 1.25 * oracle
    assert after < 0.9 * before


def test_undeclared_effect_is_named_with_its_joint() -> None:
    scene = load_scene("close_stribeck")
    assert isinstance(scene, PathScene)
    assert undeclared_effects(scene, 6) == (("stribeck", 2),)


def test_scene_without_an_undeclared_effect_is_refused() -> None:
    with pytest.raises(InputError, match="nothing that the model does not know"):
        close_loop(load_scene("iso9283_1"))
