"""The closing loop over a subject whose errors are known, and the rule by which a change is kept."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.closing.loop import MODEL, Closed, Comparison, Form, Found, Group, Step, Subject, close
from scenes.closing.result import Closing
from scenes.force.close_loop import close_loop as close_force_loop
from scenes.force.close_loop import undeclared_effects as undeclared_on_force
from scenes.line.close_loop import assumed_latency, close_loop, undeclared_effects
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.scene import SceneError
from studies.report import scene_of
from tests.scenes.test_full_disk import HELP
from tests.sources import files_of_at_most

KNOWN = Model.nominal(Robot.load("kr6"))
NOTHING = Recording({"t": np.arange(3.0)}, {}, "nothing")
SIZES = {"camera.stamp_offset": (2e-3, 10e-3), "camera.stamp_drift": (6e-4, 3e-3),
         "calibration.focal_percent": (1.0, 4.0),
         "calibration.height_mm": (1.0, 5.0), "calibration.yaw_deg": (0.3, 1.5), "calibration.pitch_deg": (0.3, 1.5),
         "calibration.k1": (0.02, 0.08)}
"""Least and most of what is wrong with a camera, by key."""
CALIBRATION = ("roll_deg", "pitch_deg", "yaw_deg", "height_mm", "lateral_mm", "focal_percent", "principal_px", "k1")


def drawn_line(rng: np.random.Generator) -> LineScene:
    """A wavy line under a camera that is right."""
    length, height = float(rng.uniform(0.6, 1.0)), float(rng.uniform(0.02, 0.05))
    return scene_of(LineScene, "close_camera").changed(
        world="bench", seed=int(rng.integers(1, 10**6)), speed=float(rng.uniform(0.4, 0.7)),
        camera={"stamp_drift": 0.0},
        line={"formula": f"{height:.4f}*sin(2*pi*x/{rng.uniform(0.5, 0.8):.3f})", "length": length},
        calibration=dict.fromkeys(CALIBRATION, 0.0))


def drawn_error(rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """One or two things that are wrong with a camera, as tables of the scene."""
    result: dict[str, dict[str, float]] = {}
    for key in map(str, rng.choice(list(SIZES), int(rng.integers(1, 3)), replace=False)):
        table, name = key.split(".")
        # The sizes of a calibration's errors have the signs that the scene's seed draws.
        sign = float(rng.choice([-1.0, 1.0])) if table == "camera" else 1.0
        result.setdefault(table, {})[name] = sign * float(rng.uniform(*SIZES[key]))
    return result


def effect(joint: int, size: float = 1.0) -> FittedEffect:
    """One that the arm may miss."""
    return FittedEffect("current_offset", joint, f"tau_{joint}", (size,))


def form(*effects: FittedEffect) -> Form:
    """What adds it."""
    return Form.adding(" and ".join(f"joint {effect.joint}" for effect in effects), effects)


class World(Subject[Array]):
    """An arm that misses one newton metre in joints 1 and 2; whatever else a model adds is wrong by it.

    ``rounds``: what each round finds.
    """

    def __init__(self, *rounds: Found) -> None:
        self.rounds, self.played = list(rounds), 0

    def play(self, model: Model) -> Array:
        self.played += 1
        missing = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
        for effect in model.effects:
            if effect.coefficients[0] > 5.0:
                raise InputError("too much", field="model")
            missing[effect.joint - 1] -= effect.coefficients[0]
        return np.full((100, 6), missing) + 0.1

    def find(self, model: Model, run: Array, progress: Any) -> Found:
        return self.rounds.pop(0) if self.rounds else found()

    def readings(self, before: Array, after: Array, known: Model, model: Model) -> list[tuple[Array, Array]]:
        return [(before, after)]


def found(*groups: Group, refused: tuple[Step, ...] = (), names: tuple[tuple[str, int], ...] = ()) -> Found:
    """What a round finds; ``names`` are those of the diagnosis."""
    diagnosis = SimpleNamespace(effects=[SimpleNamespace(fitted=SimpleNamespace(name=n, joint=j)) for n, j in names])
    return Found(diagnosis if names else None, NOTHING, groups, refused)  # type: ignore[arg-type]


def closed(*rounds: Found, **more: Any) -> Closed[Array]:
    world = World(*rounds)
    return close(world, KNOWN, world.play(KNOWN), **more)


def joints(done: Closed[Array]) -> list[int]:
    return [effect.joint for effect in done.model.effects]


def test_what_is_found_in_several_rounds_stays() -> None:
    done = closed(found(Group((form(effect(1)),))), found(Group((form(effect(2)),))))
    assert joints(done) == [1, 2]
    assert [(step.round, step.taken) for step in done.steps] == [(1, True), (2, True)]
    assert done.first == pytest.approx(np.sqrt(2 * 1.1**2 + 4 * 0.1**2))


def test_what_makes_it_worse_is_taken_back_and_said() -> None:
    done = closed(found(Group((form(effect(3)),))))
    assert not done.model.effects
    (step,) = done.steps
    assert "does not fall" in step.refused
    np.testing.assert_array_equal(done.run, World().play(KNOWN))


def test_each_alone_where_together_they_do_not_stay() -> None:
    both = found(Group((form(effect(1), effect(4, 3.0)),), ((form(effect(1)),), (form(effect(4, 3.0)),))))
    done = closed(both)
    assert joints(done) == [1]
    assert [step.taken for step in done.steps] == [False, True, False]


def test_what_stays_together_is_not_tried_alone() -> None:
    done = closed(found(Group((form(effect(1), effect(2)),), ((form(effect(1)),), (form(effect(2)),)))))
    assert joints(done) == [1, 2]
    assert len(done.steps) == 1


def test_the_next_form_is_tried_where_one_cannot_be_played() -> None:
    done = closed(found(Group((form(effect(1, 9.0)), form(effect(1))))))
    assert joints(done) == [1]
    assert done.steps[0].refused.startswith("cannot be played")


def test_an_error_has_to_fall_in_every_reading() -> None:
    class Doubtful(World):
        def readings(self, before: Array, after: Array, known: Model, model: Model) -> list[tuple[Array, Array]]:
            return [(before, after), (after, before)]

    world = Doubtful(found(Group((form(effect(1)),))))
    assert not close(world, KNOWN, world.play(KNOWN)).model.effects


def test_another_motion_is_asked_for_before_the_loop_gives_up() -> None:
    class Asking(World):
        def asked(self, found_: Found, model: Model, run: Array, progress: Any) -> Found | None:
            return found(Group((form(effect(2)),))) if not model.effects else None

    world = Asking(found(Group((form(effect(3)),))))
    assert joints(close(world, KNOWN, world.play(KNOWN))) == [2]


def test_a_named_effect_that_does_not_stay_is_told_with_the_reason() -> None:
    why = "the arm angles, which are measured, show what a gear gives better than currents"
    refused = Step("joint_elasticity in joint 2", why, places=(("joint_elasticity", 2),))
    done = closed(found(Group((form(effect(1)),)), refused=(refused,),
                        names=(("joint_elasticity", 2), ("current_offset", 1), ("camera_latency", 0))))
    result = Closing(SimpleNamespace(kind="path"), (), {}, done, None, {})  # type: ignore[arg-type]
    assert result.refusals() == [f"joint elasticity in joint 2 named, refused: {why}",
                                 "camera latency named, refused: a scene of kind path does not close it"]


class Interrupted(World):
    """Interrupted while a later round is diagnosed."""

    def find(self, model: Model, run: Array, progress: Any) -> Found:
        if not self.rounds:
            raise KeyboardInterrupt
        return super().find(model, run, progress)


def test_an_interrupted_closing_leaves_the_last_good_model(tmp_path: Path) -> None:
    world = Interrupted(found(Group((form(effect(2, 0.5)),))))
    with pytest.raises(SceneError, match=r"interrupted in round 2; .* is the model of round 1"):
        close(world, KNOWN, world.play(KNOWN), out=tmp_path / "closing")
    assert Model.load(tmp_path / "closing" / MODEL).effects[-1].coefficients == (0.5,)


def test_a_closing_interrupted_at_once_leaves_nothing(tmp_path: Path) -> None:
    world = Interrupted()
    with pytest.raises(SceneError, match="the model is as it was"):
        close(world, KNOWN, world.play(KNOWN), out=tmp_path / "closing")
    assert not (tmp_path / "closing").exists()


def test_a_closing_that_finds_no_room_says_which_model_is_left(tmp_path: Path) -> None:
    class Full(World):
        def find(self, model: Model, run: Array, progress: Any) -> Found:
            self.rounds += [found(Group((form(effect(1 + len(model.effects))),)))]
            return super().find(model, run, progress)

    def rounds() -> None:
        world = Full()
        close(world, KNOWN, world.play(KNOWN), out=tmp_path, rounds=1)
        with files_of_at_most(100):
            close(world, KNOWN, world.play(KNOWN), out=tmp_path)

    with pytest.raises(SceneError, match=f"{HELP}; ended in round 1"):
        rounds()
    assert Model.load(tmp_path / MODEL).n == 6


RNG = np.random.default_rng(5)


def along(sizes: np.ndarray, noise: float = 0.02) -> np.ndarray:
    """Deviations whose size differs from piece to piece, with the noise of one play."""
    return np.repeat(sizes, 30) * (1.0 + noise * RNG.normal(size=30 * len(sizes)))


def test_the_standard_error_is_that_of_what_happens() -> None:
    """Pieces of very different size, each as likely to gain as to lose: one standard error is a sixth of the trials."""
    counts = [0, 0]
    for _ in range(600):
        sizes = RNG.lognormal(sigma=1.0, size=40)
        for k, spread in enumerate((0.3, 0.0)):
            gain = np.exp(spread * RNG.normal(size=(2, 40)))
            counts[k] += Comparison.of(along(sizes * gain[0]), along(sizes * gain[1])).falls
    assert 0.08 < counts[0] / 600 < 0.24
    # What noise alone changes is less than what no arm repeats.
    assert counts[1] == 0


@pytest.mark.parametrize(("share", "falls"), [(0.99, False), (0.95, True), (0.5, True)])
def test_a_change_that_acts_alike_everywhere_has_to_do_more_than_the_arm_repeats(share: float, falls: bool) -> None:
    sizes = RNG.lognormal(size=40)
    comparison = Comparison.of(along(sizes, 0.001), share * along(sizes, 0.001))
    assert comparison.falls is falls
    assert comparison.after == pytest.approx(share * comparison.before, rel=0.01)


def test_a_change_where_friction_turns_round_is_kept() -> None:
    """Errors that stand at three reversals, in a tenth of the motion, and fall there alone."""
    sizes = np.ones(60)
    sizes[[7, 8, 27, 28, 47, 48]] = 10.0
    better = np.where(sizes > 1.0, 5.0, 1.0)
    assert Comparison.of(along(sizes), along(better)).falls


def test_what_one_piece_gains_and_another_loses_is_not_kept() -> None:
    sizes = np.ones(40)
    sizes[3], sizes[20] = 6.0, 2.0
    other = np.ones(40)
    other[3], other[20] = 3.0, 5.0
    comparison = Comparison.of(along(sizes), along(other))
    assert comparison.after < comparison.before
    assert not comparison.falls
    assert "one is asked for" in comparison.reason(1e3, "mm")


def test_a_change_for_the_worse_is_never_kept() -> None:
    sizes = RNG.lognormal(size=40)
    comparison = Comparison.of(along(sizes), 1.1 * along(sizes))
    assert comparison.rises
    assert not comparison.falls
    assert "does not fall" in comparison.reason(1.0, "N")


def test_vectors_count_by_their_length_and_other_counts_of_rows_by_their_share() -> None:
    before = np.abs(RNG.normal(size=(400, 3)))
    comparison = Comparison.of(before, 0.5 * before[::2])
    assert comparison.before == pytest.approx(np.sqrt(np.mean(np.sum(before**2, axis=1))))
    assert comparison.falls


def test_what_cannot_be_measured_does_not_fall() -> None:
    assert not Comparison.of(np.ones(100), np.empty(0)).falls
    assert not Comparison.of(np.empty(0), np.empty(0)).falls


# Closings on sensors: wrong time stamps of a camera, a force sensor that has drifted, a contact taken for stiffer.

def closes(result: Any, of_before: float, of_oracle: float) -> None:
    """The error after is at most so much of that of before, and of one who was told."""
    before, after, oracle = (result.errors[name].mean for name in ("before", "after", "oracle"))
    assert after < of_before * before
    assert after <= of_oracle * oracle


@pytest.mark.slow
def test_a_delay_of_the_stamps_is_named_with_its_size() -> None:
    """Of a camera whose stamps are 8 ms late."""
    result = close_loop(scene_of(LineScene, "close_latency"))
    closes(result, 0.5, 1.25)
    fits = {e.fitted.name: e.fitted for e in result.diagnosis.effects if e.fitted.channel == "line"}
    # Calibrated by moving, with the same wrong stamps, the camera's scale is off by what the stamps are worth.
    assert set(fits) <= {"camera_latency", "camera_scale"}
    assert fits["camera_latency"].coefficients[0] == pytest.approx(-0.008, abs=3e-4)


@pytest.mark.slow
def test_stamps_that_run_away_do_not_end_the_closing() -> None:
    """Stamps and their drift together lost the line after a quarter of a second, and the closing with it."""
    rng = np.random.default_rng([1014, 14])
    scene = drawn_line(rng).changed(**drawn_error(rng))
    assert isinstance(scene, LineScene)
    result = close_loop(scene, measured="motor")
    assert result.errors["after"].mean < 0.5 * result.errors["before"].mean


def test_follower_takes_the_latency_from_the_model() -> None:
    model = Model.nominal(Robot.load("kr6"))
    assert assumed_latency(model) == 0.0
    assert assumed_latency(model.with_effects((FittedEffect("camera_latency", 0, "line", (-0.008,)),))) == -0.008


def test_right_time_stamps_are_refused() -> None:
    with pytest.raises(InputError, match="nothing to diagnose"):
        close_loop(scene_of(LineScene, "line"))


def test_what_is_wrong_with_a_camera_is_named() -> None:
    assert undeclared_effects(scene_of(LineScene, "close_camera")) == (
        "clock_drift", "camera_scale", "camera_offset", "lens_distortion")


@pytest.mark.parametrize(("name", "change", "says", "key"), [
    ("close_camera", {"calibration": {"lateral_mm": 1.0}}, "another line", "calibration.lateral_mm"),
    # The camera rides on the arm: 0.5 mm of every joint leave the distance from the line as it was.
    ("line", {"world": {"base": "bench", "kinematic_error": 5e-4}}, "path scene", "world.kinematic_error")])
def test_what_cannot_be_seen_along_a_line_is_refused_with_its_key(name: str, change: dict[str, Any], says: str,
                                                                  key: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        close_loop(scene_of(LineScene, name).changed(**change))
    assert caught.value.field == key


@pytest.mark.slow
def test_camera_that_nobody_calibrated_is_set_right() -> None:
    closes(close_loop(scene_of(LineScene, "close_camera")), 0.7, 1.5)


@pytest.mark.slow
def test_friction_that_the_model_does_not_know_is_found_in_a_motion_about_the_line() -> None:
    result = close_loop(scene_of(LineScene, "close_latency").changed(
        world={"base": "bench", "stribeck": [30.0, 120.0, 30.0, 1.5, 1.5, 0.8]}, camera={"stamp_offset": 0.0}))
    assert ("stribeck", 2) in result.undeclared
    closes(result, 0.7, 1.25)


@pytest.mark.slow
def test_what_the_drives_of_a_cell_do_by_themselves_is_found_in_a_motion_about_the_line() -> None:
    result = close_loop(scene_of(LineScene, "line").changed(world={"base": "cell"}))
    assert any(step.taken and ("joint_controllers", 0) in step.places for step in result.steps)
    closes(result, 0.7, 1.25)


def test_random_lines_are_wrong_by_what_they_are_drawn_with() -> None:
    """What is drawn at random is a line scene that can be closed, and a right camera stays right."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        right = drawn_line(rng)
        with pytest.raises(InputError, match="nothing to diagnose"):
            undeclared_effects(right)
        misfit = drawn_error(rng)
        wrong = right.changed(**misfit)
        assert isinstance(wrong, LineScene)
        names = undeclared_effects(wrong)
        assert 1 <= len(names) <= 2
        assert all(getattr(getattr(wrong, table), key) == size for table, own in misfit.items()
                   for key, size in own.items())


def test_right_sensor_is_refused_and_a_wrong_one_named() -> None:
    assert undeclared_on_force(scene_of(ForceScene, "close_force")) == ("force_bias", "force_compliance")
    with pytest.raises(InputError, match="nothing to diagnose"):
        close_force_loop(scene_of(ForceScene, "force_wave"))


@pytest.mark.slow
def test_after_is_close_to_the_truth() -> None:
    result = close_force_loop(scene_of(ForceScene, "close_force"))
    assert result.errors["after"].rms < 0.8 * result.errors["before"].rms
    assert result.errors["after"].rms <= 1.25 * result.errors["true"].rms
