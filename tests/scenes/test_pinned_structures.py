"""What structural fuzzing found, each pinned: values of the wrong size, depth or kind where none was looked for."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ideal_robot.bounded_values import read_json, read_toml
from ideal_robot.diagnosis import stages
from ideal_robot.diagnosis.case import Case
from ideal_robot.diagnosis.search.choice import Options
from ideal_robot.diagnosis.statistics.prior import prior_precision
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.rsi.format import RsiFormat
from ideal_robot.signals.recording import Recording
from scenes.camera_table import CameraTable, believed_camera
from scenes.detection.sources import pictures
from scenes.follow.camera_file import calibrated_camera
from scenes.result import silent
from scenes.sweep_file import SweepFile
from tests.fuzz import originals


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


def test_of_a_parameter_without_a_finite_covariance_nothing_is_known(tmp_path: Path) -> None:
    """A hole (``null``) in the covariance of a model file ended a diagnosis in a singular value decomposition."""
    robot = originals.arm(tmp_path)
    columns = originals.motion(tmp_path)
    recording = Recording.from_arrays(columns["t"], **{
        name: np.column_stack([columns[f"{name}_{i}"] for i in (1, 2)]) for name in ("q", "tau")})
    nominal = Model.nominal(robot)
    covariance = np.diag(np.full(len(nominal.covariance), 1e-4))
    covariance[0, 3] = np.nan
    model = replace(nominal, covariance=covariance)
    case = Case(recording, robot, model, None, Options(), np.random.default_rng(0), silent, True, None)
    precision = prior_precision(model, stages.prepared(case, ()).problem)
    assert np.isfinite(precision).all()
    assert not precision[0].any()
    assert not precision[:, 3].any()
    assert precision[1, 1] > 0.0
