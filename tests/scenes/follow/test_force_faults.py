"""Whatever is wrong with the force sensor, and whenever it begins, the surface bears no more than it has to."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ideal_robot.rsi.message import RsiError
from planning.force.contact import most_force
from scenes.online import run as live
from scenes.online.devices import Devices
from scenes.scene_file import load_scene
from tests.scenes.follow.on_bench import FAULTS, STAGES, Bench, followed


def other_contact(friction: float, stiffness: float, offset_mm: float) -> Any:
    """``force_wave`` with another tip and the surface elsewhere."""
    scene = load_scene("force_wave")
    tip = scene.tip.model_copy(update={"friction": friction, "stiffness": stiffness})
    surface = scene.surface.model_copy(update={"offset_mm": offset_mm})
    return scene.model_copy(update={"tip": tip, "surface": surface})


QUICK = [("nothing but noise of 0.3 mN", "turning", "shows the same weight"), ("wrong sign", "turning", "wrong sign"),
         pytest.param("stuck, with its usual noise", "search", "the motor torques show", marks=pytest.mark.slow),
         pytest.param("a leap of -30 N", "approach", "measured in the air", marks=pytest.mark.slow),
         pytest.param("stuck, with its usual noise", "travel", "of what the tip's swing on the surface makes",
                      marks=pytest.mark.slow)]


@pytest.mark.parametrize(("fault", "stage", "says"), QUICK)
def test_a_fault_is_named_before_it_harms(fault: str, stage: str, says: str, tmp_path: Path) -> None:
    scene = load_scene("force_wave")
    run = followed(scene, tmp_path, spoil=FAULTS[fault](), stage=stage)
    assert says in str(run.failure)
    assert run.force <= most_force(scene.force)
    if stage == "turning":
        assert run.force == 0.0
    # Whoever cannot tell how hard it presses does not go on pressing.
    assert run.left == 0.0
    assert run.job.log.limited == 0


@pytest.mark.slow
@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("name", ["force_wave", "contour"])
def test_no_fault_at_any_stage_presses_too_hard(name: str, fault: str, stage: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    run = followed(scene, tmp_path, spoil=FAULTS[fault](), stage=stage)
    assert run.force <= most_force(scene.force), run.failure
    # A leap before anything was felt is a bias, and a drift is slower than the job.
    assert run.failure is not None or fault.startswith(("a leap", "drift", "a gain"))
    assert run.left == 0.0 or run.failure is None or "not done after" in run.failure


@pytest.mark.slow
@pytest.mark.parametrize(("name", "speed", "fault"), [
    ("force_wave", 0.05, "drift of +2 N/s"), ("glue", 0.08, "drift of +2 N/s"),
    ("contour", 0.04, "drift of +2 N/s in x")])
def test_a_drift_is_noticed_on_a_job_that_is_long_enough_for_it(name: str, speed: float, fault: str, tmp_path: Path
                                                                ) -> None:
    """2 N/s press with 40 N after ten seconds, and the map of the surface sinks along with the bias."""
    scene = load_scene(name).changed(speed=speed)
    run = followed(scene, tmp_path, spoil=FAULTS[fault](), stage="travel")
    assert run.failure is not None
    assert run.after < 10.0
    assert run.force <= most_force(scene.force)


@pytest.mark.parametrize(("fault", "begins", "says"), [
    pytest.param("nothing but noise of 0.3 N", 1.0, "lies deeper", marks=pytest.mark.slow),
    ("stuck, with its usual noise", 1.0, "lies deeper"),
    ("stuck, with its usual noise", 2.5, "no push")])
@pytest.mark.slow
def test_a_contour_is_not_pressed_by_a_sensor_that_does_not_answer(fault: str, begins: float, says: str, tmp_path: Path,
                                                                   monkeypatch: pytest.MonkeyPatch) -> None:
    """The tip's own way was taken for the contour, which receded and turned round: up to 123 N."""
    scene = load_scene("contour")
    monkeypatch.setattr(Bench, "begins", begins)
    run = followed(scene, tmp_path, spoil=FAULTS[fault](), stage="travel")
    assert says in str(run.failure)
    assert run.force <= most_force(scene.force)


@pytest.mark.slow
@pytest.mark.parametrize("begins", [0.2, 1.0, 1.2])
def test_a_surface_does_not_leave_a_map_that_a_stuck_sensor_goes_on_with(begins: float, tmp_path: Path,
                                                                         monkeypatch: pytest.MonkeyPatch) -> None:
    """Stuck near what is wanted, with its noise: the map went on by itself, and the surface bore 65 N."""
    scene = load_scene("glue")
    monkeypatch.setattr(Bench, "begins", begins)
    run = followed(scene, tmp_path, spoil=FAULTS["stuck, with its usual noise"](), stage="travel")
    # Whichever is noticed first: what comes at 1.2 s hangs on the last digits of the motion.
    assert any(says in str(run.failure) for says in ("of what the tip's swing on the surface makes",
                                                     "does not change as the arm moves"))
    assert run.force <= most_force(scene.force)


@pytest.mark.parametrize("gain", [0.7, pytest.param(1.5, marks=pytest.mark.slow)])
def test_a_gain_is_told_by_a_stated_weight_before_anything_is_touched(gain: float, tmp_path: Path) -> None:
    """With a gain of 0.7 the surface bore 42.7 N, and the page said 21.5 N."""
    scene = load_scene("force_wave")
    run = followed(scene, tmp_path, tool_mass=scene.sensor.mass, spoil=lambda since, wrench: gain * wrench,
                   stage="turning")
    assert f"the force sensor's gain is {gain:.1f}" in str(run.failure)
    assert run.force == 0.0
    assert f"by the stated {scene.sensor.mass:g} kg" in run.job.figures()["force_gain"]["text"]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "gain", "stiffness"), [
    ("force_wave", 0.7, 4e3), ("force_wave", 0.5, 1e5), ("force_wave", 0.5, 1e6), ("contour", 0.7, 4e3),
    ("force_wave", 1.0, 4e3), ("force_wave", 1.0, 1e5), ("contour", 1.0, 4e3)])
def test_a_gain_is_told_by_the_motors_while_it_is_pressed(name: str, gain: float, stiffness: float, tmp_path: Path
                                                          ) -> None:
    scene = load_scene(name).changed(tip={"stiffness": stiffness})
    run = followed(scene, tmp_path, spoil=lambda since, wrench: gain * wrench, stage="turning")
    said = "the force sensor's gain is" in str(run.failure)
    assert said == (gain < 1.0), run.failure
    assert run.force <= most_force(scene.force)
    assert run.left == 0.0
    if not said:
        assert "by the motors" in run.job.figures()["force_gain"]["text"]


@pytest.mark.parametrize("stated", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_gain_that_nobody_has_measured_presses_on_nothing(stated: bool, tmp_path: Path) -> None:
    """Without torques and a stated weight a gain of 0.5 pressed twice as hard as the page said."""
    scene = load_scene("force_wave")
    run = followed(scene, tmp_path, currents=False, tool_mass=scene.sensor.mass if stated else None)
    assert ("--tool-mass" in str(run.failure)) != stated, run.failure
    assert (run.force > 0.0) == (run.failure is None) == stated
    assert ("not measured" in run.job.figures()["force_gain"]["text"]) != stated


@pytest.mark.slow
@pytest.mark.parametrize("name", ["force_wave", pytest.param("contour", marks=pytest.mark.slow)])
def test_a_sound_sensor_is_believed(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    run = followed(scene.changed(line={"length": 0.4}) if name == "force_wave" else scene, tmp_path)
    assert run.failure is None
    assert run.force <= most_force(scene.force)
    assert run.job.figures()["force_N"]["rms_error"] < 1.5


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "stiffness", "offset_mm"), [
    (0.45, 4e3, 4.0), (0.15, 1e3, 4.0), (0.15, 1e5, -2.0)])
def test_a_sound_contact_is_not_stopped(friction: float, stiffness: float, offset_mm: float, tmp_path: Path) -> None:
    run = followed(other_contact(friction, stiffness, offset_mm), tmp_path)
    assert run.failure is None
    assert run.force <= most_force(20.0)
    assert run.left == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [4e5, 1e6])
def test_a_contact_that_is_too_stiff_for_the_arm_is_refused_before_the_travel(stiffness: float, tmp_path: Path) -> None:
    """At 400 N/mm the surface bore 38 N until the sensor was doubted, which was sound."""
    run = followed(other_contact(0.15, stiffness, 4.0), tmp_path)
    assert "too stiff" in run.failure
    assert "no speed would do" in run.failure
    assert run.force <= most_force(20.0)
    assert run.left == 0.0


@pytest.mark.parametrize(("before", "says"), [
    ({"tool_mass_kg": 0.5}, r"tool_mass_kg is 0.[78].* kg and was 0.5 kg at the last calibration"),
    ({"tool_mass_kg": 0.81, "elasticity_N_m": 9000.0}, r"elasticity_N_m is 3.9.*N/m and was 9e\+03 N/m")])
@pytest.mark.slow
def test_what_differs_from_the_last_calibration_is_said_with_its_size(before: dict, says: str, tmp_path: Path) -> None:
    run = followed(load_scene("force_wave"), tmp_path, before=before)
    assert re.search(says, str(run.failure)), run.failure
    # So that the next run compares, too.
    assert run.job.figures()["tool_mass_kg"] == before["tool_mass_kg"]
    if "elasticity_N_m" not in before:
        assert run.force == 0.0


def test_no_wrench_is_recorded_of_times_at_which_none_was_measured() -> None:
    """Of a way to the start the first value of the run, all along, says that the sensor was biased there."""
    job: Any = live._job(live.load_cell("force_wave"), Devices("rsi:"), None, None)
    for t in (2.0, 1.0):
        job.log.samples.append((t, 10.0 * t, 0.0, 1.0))
    job._force = SimpleNamespace(samples=[(t, *(t * np.arange(6.0))) for t in (1.0, 2.0)])
    columns = job.columns(np.array([-3.0, 0.9, 1.0, 1.5, 2.0, 2.1]))
    np.testing.assert_array_equal(columns["f_normal"], [np.nan, np.nan, 10.0, 15.0, 20.0, np.nan])
    np.testing.assert_array_equal(columns["mz"], [np.nan, np.nan, 5.0, 7.5, 10.0, np.nan])


def test_a_sensor_is_given_back_where_no_arm_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    closed = list[bool]()

    @contextmanager
    def no_arm(*_: object) -> Iterator[None]:
        raise RsiError("no packet from the controller within 60 s")
        yield

    monkeypatch.setattr(live, "open_force", lambda *_: SimpleNamespace(close=lambda: closed.append(True)))
    monkeypatch.setattr(live, "opened_arm", no_arm)
    scene, devices = live.load_cell("force_wave"), Devices("rsi://127.0.0.1:1", force="netft://127.0.0.1")
    with (pytest.raises(RsiError, match="no packet"),
          live._opened(scene, live._job(scene, devices, None, None), devices, tmp_path, "ideal", lambda *_: None)):
        pass
    assert closed == [True]
