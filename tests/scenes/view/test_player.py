"""The viewer of recordings: what is in the scene's tree, and that slider, picture and ghost follow."""

from __future__ import annotations

import dataclasses
import io
import socket
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from PIL import Image

from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.report.replay import Replay
from scenes.report.replay_file import read_replay, replay_beside, write_replay
from scenes.view.recorded import open_recording, recorded_replay, replay_of_columns
from tests.scenes.report.test_replay import ROBOT, _replay

viser = pytest.importorskip("viser")


def gray_png(gray: int) -> bytes:
    file = io.BytesIO()
    Image.new("L", (8, 6), gray).save(file, "png")
    return file.getvalue()


def whole_replay() -> Replay:
    corners = np.array([[0.0, 0, 0.3], [1, 0, 0.3], [1, 1, 0.3], [0, 1, 0.3]])
    plain = _replay(200)
    return dataclasses.replace(plain, surface=corners, pictures=((0.0, gray_png(10)), (4.0, gray_png(240))),
                               ghost=plain.q + 0.1, force=np.outer(plain.t, [0.0, 0.0, 5.0]))


@pytest.fixture
def player() -> Iterator[object]:
    from scenes.view.player import Player
    from scenes.view.viewer import Viewer

    with socket.socket() as link:
        link.bind(("127.0.0.1", 0))
        port = link.getsockname()[1]
    viewer = Viewer(ROBOT, port)
    yield Player(viewer, whole_replay())
    viewer.server.stop()


def test_the_slider_moves_arm_tool_ghost_and_picture(player) -> None:  # type: ignore[no-untyped-def]
    arm, ghost = (player.viewer.frames[name] for name in ("arm", "ghost"))
    before = [tuple(frame.position) for frame in (*arm, *ghost)], player.picture.image.mean()
    player.slider.value = 3.5
    k = int(np.searchsorted(player.replay.t, 3.5))
    np.testing.assert_allclose(player.tool.position, player.replay.tool[k], atol=1e-9)
    after = [tuple(frame.position) for frame in (*arm, *ghost)]
    assert sum(a != b for a, b in zip(before[0], after, strict=True)) >= 8
    # The last link carries the tool: the arm drawn is the arm of the recording.
    data = ROBOT.pinocchio.createData()
    pin.forwardKinematics(ROBOT.pinocchio, data, player.replay.q[k])
    np.testing.assert_allclose(arm[-1].position, data.oMi[-1].translation, atol=1e-9)
    assert player.picture.image.mean() > before[1] + 100
    start, end = player.viewer._arrows["force"].points[0]
    np.testing.assert_allclose(end, player.replay.tool[k], atol=1e-6)
    assert end[2] > start[2] + 0.2
    assert "3.5" in player.said.content
    t, error, past = player.plot.data
    assert np.isfinite(error).all()
    np.testing.assert_array_equal(past, np.where(t <= 3.5 + 0.02, error, 0.0))


def test_colours_go_from_green_to_red_and_gray_does_not_count() -> None:
    from scenes.view.player import error_colours

    green, red, gray = error_colours(np.array([0.0, -2.0, np.nan]))
    assert green[1] > green[0]
    assert red[0] > red[1]
    assert np.ptp(gray.astype(int)) < 30


def of_replay(replay: Replay) -> Recording:
    return Recording.from_arrays(replay.t, meta={"robot": "kr6"}, source="test", q=replay.q, q_c=replay.q + 1e-3,
                                 tau=np.zeros_like(replay.q))


def test_a_replay_is_read_as_it_was_written(tmp_path: Path) -> None:
    replay = whole_replay()
    recording = of_replay(replay)
    path = write_replay(replay, replay_beside(tmp_path / "recording.parquet"), recording)
    read = recorded_replay(tmp_path / "recording.parquet", ROBOT, recording)
    for name in ("t", "q", "tool", "wanted", "error", "surface", "ghost", "force"):
        np.testing.assert_array_equal(getattr(read, name), getattr(replay, name))
    assert read.pictures == replay.pictures
    assert read.error_name == replay.error_name
    assert list(read.curves) == list(replay.curves)
    other = dataclasses.replace(replay, q=replay.q + 0.5)
    assert read_replay(path, ROBOT, of_replay(other)) is None
    path.write_bytes(b"no zip")
    with pytest.raises(InputError, match="delete it"):
        read_replay(path, ROBOT, recording)


def test_any_recording_shows_how_far_the_tool_is_from_the_command() -> None:
    replay = replay_of_columns(ROBOT, of_replay(_replay(100)))
    pose = Robot.load("kr6").fk()
    k = 40
    wanted = pose(replay.q[k] + 1e-3).translation
    assert replay.error[k] == pytest.approx(1e3 * np.linalg.norm(wanted - replay.tool[k]), rel=1e-6)
    assert "commanded" in replay.curves


@pytest.mark.parametrize("t", [[], [1.0], [2.0, 1.0], [0.0, np.inf], [1.0, 1.0]])
def test_times_that_do_not_rise_are_no_motion_to_show(t: list[float], tmp_path: Path) -> None:
    columns = {"t": np.array(t), **{f"q_{i + 1}": np.zeros(len(t)) for i in range(6)}}
    path = Recording(columns, {"robot": "kr6"}).write(tmp_path / "r.parquet")
    with pytest.raises(InputError, match="times that rise"):
        open_recording(path, None)


@pytest.mark.parametrize(("name", "value"), [
    ("t", np.arange(200.0)[::-1]), ("surface", np.zeros(3)), ("ghost", np.zeros((1, 6))), ("curve_0", np.zeros(2)),
    ("picture_0", np.arange(9.0)), ("words", np.array("3")), ("words", np.array("[" * 100_000)),
])
def test_a_replay_with_an_array_of_another_shape_is_refused(name: str, value: np.ndarray, tmp_path: Path) -> None:
    replay, path = whole_replay(), tmp_path / "recording.replay.npz"
    write_replay(replay, path, of_replay(replay))
    with np.load(path) as file:
        arrays = {**file, name: value}
    with path.open("wb") as written:
        np.savez_compressed(written, **arrays)
    with pytest.raises(InputError, match="delete it"):
        read_replay(path, ROBOT, of_replay(replay))


def test_positions_that_are_missing_are_not_shown() -> None:
    """Of what is not a number no rotation can be made."""
    columns = dict(of_replay(_replay(100)).columns)
    columns["q_2"] = np.where(np.arange(100) < 40, np.nan, columns["q_2"])
    replay = replay_of_columns(ROBOT, Recording(columns, {"robot": "kr6"}))
    assert len(replay.t) == 60
    columns["q_2"] = np.full(100, np.inf)
    with pytest.raises(InputError, match="no two samples"):
        replay_of_columns(ROBOT, Recording(columns, {"robot": "kr6"}))
