"""What structural fuzzing found, each pinned: values of the wrong size, depth or kind where none was looked for."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from ideal_robot.bounded_values import read_json, read_toml
from ideal_robot.errors import InputError
from ideal_robot.rsi.format import RsiFormat
from scenes.camera_table import CameraTable, believed_camera
from scenes.detection.sources import pictures
from scenes.follow.camera_file import calibrated_camera
from scenes.sweep_file import SweepFile


@pytest.mark.parametrize("text", ["x" * 300_000, "\\\"" * 150_000, "'a" * 150_000, " ." * 150_000])
def test_long_words_are_read_in_one_pass(tmp_path: Path, text: str) -> None:
    """They took minutes: each place of a word was taken for the beginning of a key of many parts."""
    place = tmp_path / "model.json"
    place.write_text(json.dumps({"name": text}))
    assert read_json(place, "a model")["name"] == text
    place.write_text(f'name = "{text}')
    with pytest.raises(InputError, match="not a readable"):
        read_toml(place, "a scene")


def test_a_key_of_many_parts_and_deep_nesting_are_still_refused(tmp_path: Path) -> None:
    place = tmp_path / "scene.toml"
    place.write_text("a." * 5000 + "b = 1")
    with pytest.raises(InputError, match="parts"):
        read_toml(place, "a scene")
    place.write_text("a = " + "[" * 5000)
    with pytest.raises(InputError, match="nested"):
        read_toml(place, "a scene")


def test_a_calibration_nested_without_end_is_no_calibration(tmp_path: Path) -> None:
    place = tmp_path / "camera.json"
    place.write_text('{"a":' * 3000 + "1" + "}" * 3000)
    with pytest.raises(InputError):
        calibrated_camera(believed_camera(CameraTable()), place)


@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes there")
def test_a_pipe_that_nobody_writes_to_is_not_waited_for(tmp_path: Path) -> None:
    place = tmp_path / "pipe"
    os.mkfifo(place)
    with pytest.raises(InputError):
        RsiFormat.read(place, 6)
    with pytest.raises(InputError):
        SweepFile(place, resume=True)
    with pytest.raises(InputError):
        read_json(place, "a model")


@pytest.mark.parametrize("name", ["p.png", "p.jpg", "v.mp4"])
def test_what_libraries_say_of_broken_pictures_goes_nowhere(tmp_path: Path, name: str,
                                                             capfd: pytest.CaptureFixture[str]) -> None:
    raw = bytearray(cv2.imencode(".png", np.full((120, 160), 200, np.uint8))[1].tobytes())
    raw[20] ^= 0xFF
    (tmp_path / name).write_bytes(raw)
    with pytest.raises(InputError):
        list(pictures(str(tmp_path / name)))
    assert capfd.readouterr().err == ""
