"""A camera that is knocked, or whose stamps wander, is named while the tool is still on the line."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array
from scenes.models import model_for
from scenes.online.camera_worker import _Worker
from scenes.online.cell_check import _seen
from scenes.online.journal import Journal
from scenes.online.live_arm import LiveArm, moves
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
    assert not run.camera.apart > 1e-4


def test_a_slow_camera_is_waited_for_where_the_line_is_looked_at(tmp_path: Path) -> None:
    """At 10 Hz four pictures fall into the rest above the line; they were too few, whatever they showed."""
    run = followed(load_scene("line").changed(camera={"rate": 10.0}, max_gap=0.25), tmp_path, check=True)
    assert run.failure is None
    assert not run.camera.apart > 1e-4


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


def test_pictures_that_were_moved_since_the_calibration_are_found_above_the_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(eye_on_bench, "BEGIN", 0.0)
    run = followed(load_scene("line"), tmp_path, picture=shifted(8), check=True)
    assert "seen 0.7 mm apart from two poses" in str(run.failure)
    assert not run.job.log.t


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
