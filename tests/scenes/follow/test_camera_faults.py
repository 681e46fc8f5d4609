"""A camera that is knocked, or whose stamps wander, is named while the tool is still on the line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array
from scenes.line.cell import prepared
from scenes.models import model_for
from scenes.online.camera_worker import _Worker
from scenes.online.cell_check import BY_CHANCE, Look, Seen, _postures, _seen
from scenes.online.devices import Devices
from scenes.online.journal import Journal
from scenes.online.live_arm import LiveArm, moves
from scenes.online.run import _job, load_cell
from scenes.scene_file import load_scene
from scenes.scene_files.scene import SceneError
from sensing.camera.camera_model import CameraModel
from sensing.camera.cameras import Frame
from tests.scenes.follow import eye_on_bench
from tests.scenes.follow.eye_on_bench import followed, shaken, shifted
from tests.scenes.follow.pair import Tame


@pytest.mark.parametrize(("fault", "says"), [
    ({"picture": shifted(2)}, "does not change as the arm moves"), ({"picture": shifted(8)}, "leaps by"),
    ({"stamp": shaken(0.02)}, "time stamps wander"),
    pytest.param({"stamp": shaken(0.05)}, "time stamps wander", marks=pytest.mark.slow)])
def test_a_camera_that_is_no_longer_what_it_was_is_named(fault: dict, says: str, tmp_path: Path) -> None:
    run = followed(load_scene("line"), tmp_path, **fault)
    assert "stopped on the path" in str(run.failure)
    assert says in str(run.failure)
    on_line = run.beside[run.t > 1.2]
    assert not len(on_line) or on_line.max() < 1e-3


@pytest.mark.parametrize("calibrated", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_sound_camera_is_believed(calibrated: bool, tmp_path: Path) -> None:
    """Also one that is believed as it was mounted by hand, with its millimetres."""
    run = followed(load_scene("line"), tmp_path, calibrated=calibrated, check=True)
    assert run.failure is None
    assert run.beside.mean() < (1.5e-4 if calibrated else 1.5e-3)
    if calibrated:
        assert run.seen.by_chance > 1e-3
        assert run.seen.turned == pytest.approx(np.pi)


@pytest.mark.slow
def test_a_slow_camera_is_waited_for_where_the_line_is_looked_at(tmp_path: Path) -> None:
    """At 10 Hz four pictures fall into the rest above the line; they were too few, whatever they showed."""
    run = followed(load_scene("line").changed(camera={"rate": 10.0}, max_gap=0.25), tmp_path, check=True)
    assert run.failure is None
    assert run.seen.by_chance > 1e-3


def test_an_arm_that_waits_for_a_slow_camera_stands_where_it_came_to_rest(tmp_path: Path) -> None:
    """Its gears bend under its weight until the end, 1.3 mm at the tip."""
    link, stood = Tame(), list[Array]()
    arm = LiveArm(link, Journal(tmp_path, link.robot, {}))
    look: Any = SimpleNamespace(model=model_for(load_scene("line"), link.robot))
    camera: Any = SimpleNamespace(arrived=lambda t: [])
    view: Any = SimpleNamespace(history=SimpleNamespace(add=lambda t, q: stood.append(q)))
    with pytest.raises(SceneError, match="only 0 pictures"):
        _seen(look, arm, camera, view, moves(link.robot, [link.robot.home, link.robot.home + 0.05], 0.5))
    bends = link.robot.home + 0.05 - stood[-1]
    assert np.abs(bends).max() > 5e-4
    np.testing.assert_allclose(stood[-round(2.4 / arm.t_ipo) :], np.tile(stood[-1], (round(2.4 / arm.t_ipo), 1)),
                               atol=1e-9)


@pytest.mark.parametrize("pixels", [2, pytest.param(-2, marks=pytest.mark.slow)])
def test_pictures_that_were_moved_since_the_calibration_are_found_above_the_line(
    pixels: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By two pixels they leave the tool 1.7 mm beside the line; from two heights alone it was not noticed."""
    monkeypatch.setattr(eye_on_bench, "BEGIN", 0.0)
    run = followed(load_scene("line"), tmp_path, picture=shifted(pixels), check=True)
    assert "mm apart from 3 poses" in str(run.failure)
    assert not run.job.log.t


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_knocked_cameras_are_refused_and_sound_ones_are_not(seed: int, tmp_path: Path,
                                                            monkeypatch: pytest.MonkeyPatch) -> None:
    """Calibrated by moving, as in a user's cell, and then moved by a random number of pixels."""
    monkeypatch.setattr(eye_on_bench, "BEGIN", 0.0)
    scene, rng = load_scene("line").changed(seed=seed), np.random.default_rng(seed)
    with prepared(scene) as shared:
        for pixels in (0, *(rng.choice([-1, 1], 2) * rng.integers(1, 5, 2))):
            run = followed(scene, tmp_path, check=True, shared=shared, picture=shifted(int(pixels)))
            assert (run.failure is None) == (pixels == 0), (pixels, run.failure)


def test_a_look_says_which_camera_would_pass() -> None:
    """One that shows so much beside the line is refused in half of the cases, twice as much nearly always."""
    rng, sigma, shown = np.random.default_rng(1), 6e-5, np.array([1.16, 1.28, -1.16])
    draws = 4000
    for times, least, most in ((0.0, 0.0, 0.001), (1.0, 0.4, 0.65), (2.0, 0.99, 1.0)):
        passes = Seen(np.zeros(3), shown, sigma, np.pi).passes
        looks = [Seen(0.01 + times * passes * shown + sigma * rng.standard_normal(3), shown, sigma, np.pi)
                 for _ in range(draws)]
        refused = np.mean([look.by_chance <= BY_CHANCE for look in looks])
        assert least <= refused <= most


def test_an_arm_that_cannot_turn_its_tool_says_so() -> None:
    job: Any = _job(load_cell("line"), Devices("rsi:"), None, None)
    look = Look(job.known.reference, job.scene.reference.run_up, job.q_start, job.calibration.camera, job.model)
    assert _postures(look, job.robot)[2] == pytest.approx(np.pi)
    q_6 = job.q_start[-1]
    stiff = replace(job.robot, q_min=np.append(job.robot.q_min[:-1], q_6 - 0.8),
                    q_max=np.append(job.robot.q_max[:-1], q_6 + 0.8))
    postures, shown, turned = _postures(look, stiff)
    assert len(postures) == 2
    assert turned == 0.0
    seen = Seen(np.zeros(2), shown, 6e-5, turned)
    assert "cannot turn" in seen.text
    assert seen.passes > 1e-3


class Told(list[tuple[str, Any]]):
    """The arm's end of a pipe."""

    def send(self, told: tuple[str, Any]) -> None:
        self.append(told)


@pytest.mark.parametrize("error", [ValueError("cannot reshape array of size 307199"), OSError("no such device")])
def test_whatever_a_camera_fails_with_the_arms_side_is_told(error: Exception) -> None:
    """An incomplete picture of a GenICam camera, and a device that was unplugged."""
    messages = Told()

    def read(timeout: float) -> Frame:
        raise error

    source: Any = SimpleNamespace(read=read)
    _Worker(CameraModel.default(), "edge_pairs", messages).read(source)  # type: ignore[arg-type]
    assert [kind for kind, _ in messages] == ["ended"]
    assert str(error) in messages[0][1]


def test_a_picture_that_comes_while_another_is_looked_for_is_no_error() -> None:
    messages = Told()
    worker: Any = _Worker(CameraModel.default(), "edge_pairs", messages)  # type: ignore[arg-type]

    class Seen:
        """During whose comparison the other thread hands in a picture."""

        @property
        def number(self) -> int:
            worker._frames.append(Frame(7, 0.0, 0.0, np.zeros((4, 4), dtype=np.uint8)))
            return 1

    worker._frames += [Seen(), Seen()]
    worker.answer("detect", (2, 0.0, None, None))
    assert [kind for kind, _ in messages] == ["seen"]
    assert messages[0][1].reason == "the picture was gone"
