"""Films of a run."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from ideal_robot.errors import InputError
from scenes.report.video import frames, write_video
from tests.scenes.report.test_replay import _replay


def test_the_arm_moves_and_the_trace_grows() -> None:
    shown = list(frames(_replay(200), 1.0))
    assert len(shown) == 4
    assert all(frame.shape == shown[0].shape for frame in shown)
    arm = np.abs(shown[0][:400, :500].astype(int) - shown[2][:400, :500]).mean()
    assert arm > 1.0


@pytest.mark.parametrize("ending", [".gif", ".mp4"])
def test_a_film_can_be_played(ending: str, tmp_path: Path) -> None:
    short = dataclasses.replace(_replay(60), t=np.linspace(0.0, 0.5, 60))
    path = write_video(short, tmp_path / f"run{ending}", rate=10.0, slow=1.0)
    if ending == ".gif":
        with Image.open(path) as film:
            assert film.n_frames == 5
    else:
        film = cv2.VideoCapture(str(path))
        assert int(film.get(cv2.CAP_PROP_FRAME_COUNT)) == 5
        film.release()
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


def test_another_ending_is_refused_before_anything_is_drawn(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.mp4 or \.gif"):
        write_video(_replay(50), tmp_path / "run.avi")
