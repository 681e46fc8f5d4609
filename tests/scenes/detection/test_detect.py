"""``ideal-robot detect`` on files, folders and videos, and on what is none."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from ideal_robot.errors import InputError
from scenes.commands.detect import command
from scenes.detection.sources import pictures
from tests.sensing.camera.pictures import drawn_line

app = typer.Typer()
app.command()(command)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    where = tmp_path / "cell"
    where.mkdir()
    cv2.imwrite(str(where / "a.png"), drawn_line(seed=1)[0])
    cv2.imwrite(str(where / "b.png"), np.full((240, 320), 128, np.uint8))
    return where


def test_a_folder_gives_points_polynomial_and_reasons(folder: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, [str(folder), "--json", str(tmp_path / "line.json"), "--out",
                                    str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    first, second = json.loads((tmp_path / "line.json").read_text())["pictures"]
    assert first["found"]
    assert first["polarity"] == "dark"
    assert abs(first["width_px"] - 8.0) < 1.0
    assert first["sigma_px"] < 0.2
    assert sum(point["used"] for point in first["points"]) > 10
    assert not second["found"]
    assert second["reason"]
    assert "data:image/png" in (tmp_path / "out" / "report.html").read_text()


def test_pictures_without_a_line_end_with_exit_code_1(folder: Path, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, [str(folder / "b.png"), "--out", str(tmp_path)])
    assert done.exit_code == 1


def test_frames_of_a_video(tmp_path: Path) -> None:
    path = tmp_path / "line.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (640, 480))
    if not writer.isOpened():
        pytest.skip("this OpenCV cannot write MJPG videos")
    for seed in range(4):
        writer.write(cv2.cvtColor(drawn_line(seed=seed)[0], cv2.COLOR_GRAY2BGR))
    writer.release()
    assert [name for name, _ in pictures(str(path), every=2)] == ["frame 0", "frame 2"]


@pytest.mark.parametrize("source", ["missing.png", "nowhere", "empty", "broken.png", "broken.avi"])
def test_what_cannot_be_read_is_said(source: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("broken.png", "broken.avi"):
        (tmp_path / name).write_bytes(b"no picture at all")
    with pytest.raises(InputError):
        list(pictures(str(tmp_path / source)))


def test_a_small_file_of_a_huge_picture_is_refused_before_it_is_unpacked(tmp_path: Path,
                                                                          monkeypatch: pytest.MonkeyPatch) -> None:
    cv2.imwrite(str(tmp_path / "huge.png"), np.zeros((20_000, 10_000), np.uint8))
    cv2.imwrite(str(tmp_path / "large.png"), np.zeros((8_100, 8_000), np.uint8))
    monkeypatch.setattr(cv2, "imread", lambda *_: pytest.fail("unpacked"))
    for name in ("huge.png", "large.png"):
        with pytest.raises(InputError, match="64 megapixels"):
            next(pictures(str(tmp_path / name)))
