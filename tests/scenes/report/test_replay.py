"""The replay in a page: what it holds, and that it moves in a browser."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.cli import _register, app
from scenes.path.page import path_replay, run_page
from scenes.play import run_scene
from scenes.report.replay import FRAMES, Replay, link_poses, polygons, sensed_force, sensed_line
from scenes.report.video import frames, write_video
from scenes.scene_file import load_scene

ROBOT = Robot.load("kr6")


def _replay(n: int = 1000, script: str = "") -> Replay:
    t = np.linspace(0.0, 4.0, n)
    q = ROBOT.home + 0.2 * np.sin(t)[:, None]
    pose = ROBOT.fk()
    tool = np.array([pose(row).translation for row in q])
    error = np.where(t > 1.0, 0.1 + 0.05 * np.sin(9.0 * t), np.nan)
    return Replay(ROBOT, t, q, tool, tool + np.array([0.0, 1e-4, 0.0]), error, error_name=f"distance{script}",
                  curves={"line": tool})


def _data(html: str) -> dict[str, object]:
    found = re.search(r"const DATA = (.*);\n", html)
    assert found is not None
    data: dict[str, object] = json.loads(found[1].replace("<\\/", "</"))
    return data


def test_a_long_run_is_thinned_out_and_stays_small() -> None:
    html = _replay(20000).html()
    data = _data(html)
    assert len(data["t"]) <= FRAMES  # type: ignore[arg-type]
    assert len(html) < 2_000_000


def test_links_stand_where_pinocchio_has_them() -> None:
    shapes, links = polygons(ROBOT)
    poses = link_poses(ROBOT, ROBOT.home[None, :], links)
    tool = ROBOT.fk()(ROBOT.home).translation
    last = max(shape["link"] for shape in shapes)
    corners = np.array([corner for shape in shapes if shape["link"] == last for face in shape["faces"]
                        for corner in face])
    placed = corners @ poses[0, last, :9].reshape(3, 3).T + poses[0, last, 9:]
    assert np.min(np.linalg.norm(placed - tool, axis=1)) < 0.15


def test_an_arm_without_shapes_is_drawn_as_rods(tmp_path: Path) -> None:
    text = re.sub(r"<visual>.*?</visual>", "", ROBOT.urdf.read_text(encoding="utf-8"), flags=re.S)
    (tmp_path / "bare.urdf").write_text(text, encoding="utf-8")
    shapes, _ = polygons(Robot.load(tmp_path / "bare.urdf"))
    assert len(shapes) >= 4


def test_names_cannot_end_the_script() -> None:
    html = _replay(50, "</script><script>alert(1)</script>").html()
    assert html.count("</script>") == 1


def test_arrays_of_other_lengths_are_refused() -> None:
    good = _replay(50)
    with pytest.raises(InputError, match="error"):
        Replay(ROBOT, good.t, good.q, good.tool, good.wanted, good.error[:-1])


@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs a headless Chromium")
def test_it_moves_in_a_browser(tmp_path: Path) -> None:
    """The slider moves the arm: the canvas changes, and the frame shown follows."""
    page = tmp_path / "page.html"
    page.write_text(f"""<!DOCTYPE html><meta charset="utf-8">{_replay(100).html()}<pre id="said"></pre><script>
const canvas = document.querySelector("canvas"), slider = document.querySelector("input[type=range]");
const before = canvas.toDataURL(); slider.value = 10; slider.dispatchEvent(new Event("input"));
document.getElementById("said").textContent = JSON.stringify({{moved: canvas.toDataURL() !== before,
  frame: document.querySelector(".replay").dataset.frame, blank: before.length < 5000}});</script>""", encoding="utf-8")
    done = subprocess.run(["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
                           "--no-first-run", "--disable-background-networking", "--disable-component-update",
                           "--disable-sync", f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", page.as_uri()],
                          capture_output=True, text=True, timeout=120, check=False)
    found = re.search(r'<pre id="said">(.*?)</pre>', done.stdout)
    assert found is not None, done.stderr
    assert json.loads(found[1]) == {"moved": True, "frame": "10", "blank": False}


# Replays of paths and of methods side by side, and the film of ``run --video``.

def test_a_paths_replay_shows_the_errors_of_its_table() -> None:
    scene = load_scene("iso9283_1")
    ideal, none = (run_scene(scene, method=method) for method in ("ideal", "none"))
    replay = path_replay(ideal, none)
    assert replay is not None
    assert np.sqrt(np.nanmean(replay.error**2)) == pytest.approx(1e3 * ideal.errors.time_matched.E_car, rel=0.02)
    assert replay.ghost is not None
    # The ghost is the arm without correction: late by its delay, so further away.
    assert np.max(np.abs(replay.ghost - replay.q)) > 1e-3
    kinds = [block["kind"] for block in run_page(ideal)._blocks]
    assert kinds.index("replay") < kinds.index("table")


def test_a_film_of_another_format_is_refused_before_the_run(tmp_path: Path) -> None:
    _register()
    done = CliRunner().invoke(app, ["run", "line", "--out", str(tmp_path / "o"), "--video", str(tmp_path / "x.avi")])
    assert done.exit_code != 0
    assert ".mp4 or .gif" in str(done.exception)
    assert not (tmp_path / "o").exists()


# What the sensors felt, in the base frame: the weight of the tool and the sensor's bias are not the environment's.

def test_the_force_of_the_environment_comes_back() -> None:
    q = _replay(50).q
    true = np.tile([3.0, -4.0, 12.0], (50, 1))
    bias, mass = np.array([1.0, 2.0, -3.0, 0.0, 0.0, 0.0]), 0.8
    pose = ROBOT.fk()
    weight = np.array([0.0, 0.0, -9.81 * mass])
    felt = np.array([pose(row).rotation.T @ (force + weight) for row, force in zip(q, true, strict=True)])
    columns = {name: felt[:, i] + bias[i] for i, name in enumerate(("fx", "fy", "fz"))}
    plain = Recording.from_arrays(np.arange(50) * 0.01, meta={"tool": {"bias": bias.tolist(), "mass": mass}}, q=q)
    recording = Recording({**plain.columns, **columns}, plain.meta, "test")
    np.testing.assert_allclose(sensed_force(ROBOT, recording), true, atol=1e-9)
    some = sensed_force(ROBOT, recording, np.array([3, 7]))
    assert some is not None
    assert some.shape == (2, 3)


def test_recordings_without_sensors_have_neither() -> None:
    plain = Recording.from_arrays(np.arange(50) * 0.01, meta={}, q=_replay(50).q)
    assert sensed_force(ROBOT, plain) is None
    assert len(sensed_line(ROBOT, plain)) == 0


# Films of a run.

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
