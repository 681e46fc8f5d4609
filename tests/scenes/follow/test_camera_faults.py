"""A camera that is knocked, or whose stamps wander, is named while the tool is still on the line."""

from __future__ import annotations

from pathlib import Path

import pytest

from scenes.scene_file import load_scene
from tests.scenes.follow import eye_on_bench
from tests.scenes.follow.eye_on_bench import followed, shaken, shifted


@pytest.mark.parametrize(("fault", "says"), [
    ({"picture": shifted(2)}, "does not change as the arm moves"), ({"picture": shifted(8)}, "leaps by"),
    ({"stamp": shaken(0.05)}, "time stamps wander"), ({"stamp": shaken(0.02)}, "time stamps wander")])
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


def test_pictures_that_were_moved_since_the_calibration_are_found_above_the_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(eye_on_bench, "BEGIN", 0.0)
    run = followed(load_scene("line"), tmp_path, picture=shifted(8), check=True)
    assert "seen 0.7 mm apart from two poses" in str(run.failure)
    assert not run.job.log.t
