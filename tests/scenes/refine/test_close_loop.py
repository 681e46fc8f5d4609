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


def _small(**changes: object) -> PathScene:
    """The scene with a worn gear on a path of 150 mm, which takes a third of the time."""
    scene = load_scene("close_elastic").changed(path={"size_mm": 150.0}, **changes)
    assert isinstance(scene, PathScene)
    return scene


def test_with_motor_angles_alone_the_path_never_becomes_worse() -> None:
    """The torque's idea of a soft gear once bent the path from 0.735 to 2.210 mm; what is refused has a reason."""
    result = close_loop(_small(), measured="motor")
    before, after = (e.aligned.E_car for e in (result.before, result.after))
    assert after <= max(1.05 * before, before + 3e-6)
    assert result.steps
    assert all(step.taken != bool(step.refused) for step in result.steps)
    assert not any(name.startswith("qa_") or name == "x" for name in result.recording.columns)
    values = result.json()
    assert values["measured"] == "motor"
    assert set(values["steps"][0]) == {"round", "tried", "taken", "refused", "error"}


@pytest.mark.slow
@pytest.mark.parametrize("measured", ["arm", "tcp"])
def test_with_arm_angles_the_loop_closes(measured: str) -> None:
    result = close_loop(_small(), measured=measured)
    before, after, oracle = (e.aligned.E_car for e in (result.before, result.after, result.oracle))
    assert after < 0.5 * before
    assert after <= 1.25 * oracle


def test_another_word_for_what_is_measured_is_refused() -> None:
    with pytest.raises(InputError, match="motor, arm or tcp"):
        close_loop(_small(), measured="everything")
