"""The viewer in a headless browser with software WebGL: arm, line, force, picture and error are seen, and move."""

from __future__ import annotations

import dataclasses
import io
import json
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from PIL import Image

from ideal_robot.errors import InputError
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.online.journal import Journal, remove
from scenes.report.replay import Replay, error_colours, read_replay, replay_beside, write_replay
from scenes.view.live import watch
from scenes.view.viewer import Player, Viewer, open_recording, recorded_replay, replay_of_columns
from tests.browser import Page, chromium, needs_chromium
from tests.scenes.report.test_page import ROBOT, _replay
from tests.sources import free_port

pytest.importorskip("viser")

SCENE = (slice(200, None), slice(None, 640))
"""Rows and columns of the screenshot that show the scene and nothing else."""
PANEL = (slice(None), slice(660, None))
"""Those that show the controls."""
PHONE = (slice(140, 560), slice(None))
"""Rows of a phone's page between viser's notice and the controls."""


def seen(page: Page, arrived: Callable[[np.ndarray], bool]) -> np.ndarray:
    """The page once it shows what was waited for; a busy machine gets more time, and what it has then is judged."""
    until = time.monotonic() + 120.0
    while True:
        picture = page.picture()
        if arrived(picture) or time.monotonic() > until:
            return picture
        time.sleep(0.3)


def scene_is_there(picture: np.ndarray) -> bool:
    """It fades in: only once it has is the line's black black."""
    return bool((arm(picture).sum() > 1500) and (picture[SCENE].max(axis=2) < 80).sum() > 300
                and near(picture[PANEL], (255, 0, 255)).sum() > 3000
                and near(picture[PANEL], (34, 139, 230), 30).sum() > 30)


def arm(picture: np.ndarray) -> np.ndarray:
    """Where the scene is orange."""
    return orange(picture)[SCENE]


def orange(picture: np.ndarray) -> np.ndarray:
    return np.asarray(picture[..., 0] - picture[..., 2] > 30)


def png(colour: tuple[int, int, int]) -> bytes:
    file = io.BytesIO()
    Image.new("RGB", (64, 48), colour).save(file, "png")
    return file.getvalue()


def replay_to_see() -> Replay:
    """A wide motion over a dark curve, a force towards the viewer, camera pictures in colours that nothing else has."""
    plain = _replay(200)
    wide = plain.q + 0.8 * np.sin(plain.t)[:, None] * np.array([1.0, 0, 0, 0, 0, 0])
    tool = ROBOT.tool_places(wide)
    angle = np.linspace(0, 2 * np.pi, 200)
    ring = np.column_stack([0.7 + 0.5 * np.cos(angle), 0.5 * np.sin(angle), np.full(200, 0.02)])
    return dataclasses.replace(plain, q=wide, tool=tool, wanted=tool, curves={"drawn line": ring},
                               force=np.tile([0.0, -20.0, 5.0], (200, 1)),
                               pictures=((0.0, png((255, 0, 255))), (4.0, png((0, 255, 255)))))


def near(picture: np.ndarray, colour: tuple[int, int, int], within: int = 60) -> np.ndarray:
    return np.asarray(np.abs(picture - np.array(colour)).max(axis=2) < within)


@pytest.mark.slow
@needs_chromium
def test_arm_line_force_picture_and_error_are_seen_and_the_slider_moves_them(tmp_path: Path) -> None:
    viewer = Viewer(ROBOT, free_port())
    try:
        player = Player(viewer, replay_to_see())
        player.running.value = False
        player.slider.value = 0.1
        with chromium(tmp_path) as page:
            page.open(f"http://127.0.0.1:{viewer.port}/", 1000, 1300)
            first = seen(page, scene_is_there)
            player.slider.value = 3.9
            second = seen(page, lambda picture: bool((arm(first) & ~arm(picture)).sum() > 300
                                                     and near(picture[PANEL], (0, 255, 255)).sum() > 3000))
            page.open(f"http://127.0.0.1:{viewer.port}/", 400, 800)
            phone = seen(page, lambda picture: bool(orange(picture[PHONE]).sum() > 1500
                                                    and (picture[PHONE].max(axis=2) < 80).sum() > 300))
    finally:
        viewer.server.stop()
    assert arm(first).sum() > 1500, "the arm"
    assert (arm(first) & ~arm(second)).sum() > 300, "the arm moves with the slider"
    rows, columns = np.nonzero(near(first[SCENE], (40, 40, 40)))
    assert len(rows) > 300, "the line"
    assert np.ptp(columns) > 150
    assert np.ptp(rows) > 40
    assert near(first[SCENE], (0, 110, 190)).sum() > 50, "the force's arrow"
    assert near(first[PANEL], (255, 0, 255)).sum() > 3000, "the camera's picture"
    assert near(second[PANEL], (255, 0, 255)).sum() == 0
    assert near(second[PANEL], (0, 255, 255)).sum() > 3000, "the camera's picture of the other instant"
    assert near(first[PANEL], (224, 106, 0)).sum() > 100, "the error over time"
    assert orange(phone[PHONE]).sum() > 1500, "the arm on a phone"
    assert np.ptp(np.nonzero(orange(phone[PHONE]))[0]) > 100, "all of it"
    assert (phone[PHONE].max(axis=2) < 80).sum() > 300, "the line on a phone"
    assert near(phone, (0, 255, 255)).sum() == 0, "plot and picture are closed until they are touched"


# The page of a run on devices while it goes on.

@contextmanager
def watched(folder: Path, **known: Any) -> Iterator[Any]:
    """The page of a folder."""
    page = watch(ROBOT, folder, free_port(), known)
    try:
        yield page
    finally:
        page.viewer.server.stop()


def begun(folder: Path) -> Journal:
    return Journal(folder, ROBOT, {"scene": "seam", "method": "ideal"})


def ran(journal: Journal, cycles: range) -> None:
    for k in cycles:
        q = ROBOT.home + 0.004 * k * np.array([1.0, 0, 0, 0, 0, 0])
        journal.add(0.012 * k, RobotState(0.012 * (k + (k > 50)), q, np.zeros(6)), q + 0.001, q)


def test_the_page_follows_the_journal_and_says_how_it_ended(tmp_path: Path) -> None:
    with watched(tmp_path) as page:
        page.update()
        assert "waiting" in page.state
        journal = begun(tmp_path)
        ran(journal, range(100))
        page.update()
        assert "seam" in page.state
        assert "100 cycles of 12 ms, 1 lost" in page.state
        assert "1.00 mrad" in page.state
        page._grown -= 5.0
        page.update()
        assert "no new cycle for 5 s" in page.state
        ran(journal, range(100, 140))
        page.update()
        assert "140 cycles" in page.state
        journal.close()
        remove(tmp_path)
        (tmp_path / "report.json").write_text(json.dumps(
            {"scene": "seam", "method": "ideal", "failure": "stopped by the user", "cycles": 140, "report": "r.html"}))
        page.update()
        assert "stopped by the user" in page.state


@pytest.mark.parametrize("change", [{"cycle_time": {"a": 1}}, {"cycle_time": 1e-320}, {"cycle_time": 0},
                                    {"cycle_time": 10**400}, {"gain": [1.0] * 3}])
def test_a_journal_that_is_none_of_the_arm_is_waited_out(change: dict[str, Any], tmp_path: Path) -> None:
    ran(begun(tmp_path), range(100))
    meta = json.loads((tmp_path / "journal.json").read_text())
    (tmp_path / "journal.json").write_text(json.dumps({**meta, **change}))
    with watched(tmp_path) as page:
        page.update()
        assert "waiting" in page.state


@pytest.mark.slow
@needs_chromium
def test_the_arm_its_way_and_the_words_are_seen(tmp_path: Path) -> None:
    journal = begun(tmp_path)
    ran(journal, range(200))

    def there(picture: np.ndarray) -> bool:
        return bool(orange(picture).sum() > 1000 and near(picture, (0, 110, 190), 40).sum() > 50)

    with (watched(tmp_path, reference=np.array([[0.5, -0.5, 0.3], [0.9, 0.5, 0.3]])) as page,
          chromium(tmp_path) as browser):
        page.update()
        browser.open(f"http://127.0.0.1:{page.viewer.port}/", 1000, 900)
        picture, words = seen(browser, there), browser.value("document.body.innerText")
    journal.close()
    assert there(picture), "the arm and its way"
    assert "running" in words
    assert "200 cycles of 12 ms" in words


# The viewer of recordings: what is in the scene's tree, and that slider and picture follow.

def whole_replay() -> Replay:
    corners = np.array([[0.0, 0, 0.3], [1, 0, 0.3], [1, 1, 0.3], [0, 1, 0.3]])
    plain = _replay(200)
    return dataclasses.replace(plain, surface=corners, pictures=((0.0, png((10,) * 3)), (4.0, png((240,) * 3))),
                               force=np.outer(plain.t, [0.0, 0.0, 5.0]))


@pytest.fixture
def player() -> Iterator[object]:
    viewer = Viewer(ROBOT, free_port())
    yield Player(viewer, whole_replay())
    viewer.server.stop()


def test_a_page_begins_with_all_of_an_arm_that_hangs_from_the_ceiling(tmp_path: Path) -> None:
    hung = ('<link name="ceiling"/><joint name="hung" type="fixed"><parent link="ceiling"/><child link="base_link"/>'
            '<origin xyz="0 0 0" rpy="3.141592653589793 0 0"/></joint><link name="base_link">')
    (tmp_path / "hung.urdf").write_text(Robot.load("kr500").urdf.read_text().replace('<link name="base_link">', hung))
    viewer = Viewer(Robot.load(tmp_path / "hung.urdf"), free_port())
    camera = viewer.server.initial_camera
    view, place = np.subtract(camera.look_at, camera.position), np.array([f.position for f in viewer.frames["arm"]])
    sight = place - camera.position
    angles = np.degrees(np.arccos(sight @ view / np.linalg.norm(sight, axis=1) / np.linalg.norm(view)))
    assert angles.max() < 0.5 * np.degrees(camera.fov)
    viewer.server.stop()


def test_the_slider_moves_arm_tool_and_picture(player) -> None:  # type: ignore[no-untyped-def]
    arm = player.viewer.frames["arm"]
    before = [tuple(frame.position) for frame in arm], player.picture.image.mean()
    player.slider.value = 3.5
    k = int(np.searchsorted(player.replay.t, 3.5))
    np.testing.assert_allclose(player.tool.position, player.replay.tool[k], atol=1e-9)
    after = [tuple(frame.position) for frame in arm]
    assert sum(a != b for a, b in zip(before[0], after, strict=True)) >= 4
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
    for name in ("t", "q", "tool", "wanted", "error", "surface", "force"):
        np.testing.assert_array_equal(getattr(read, name), getattr(replay, name))
    assert read.pictures == replay.pictures
    assert read.error_name == replay.error_name
    assert list(read.curves) == list(replay.curves)
    assert read_replay(path, ROBOT, of_replay(dataclasses.replace(replay, q=replay.q + 0.5))) is None
    path.write_bytes(b"no zip")
    with pytest.raises(InputError, match="delete it"):
        read_replay(path, ROBOT, recording)


def test_any_recording_shows_how_far_the_tool_is_from_the_command() -> None:
    replay = replay_of_columns(ROBOT, of_replay(_replay(100)))
    k = 40
    wanted = ROBOT.fk()(replay.q[k] + 1e-3).translation
    assert replay.error[k] == pytest.approx(1e3 * np.linalg.norm(wanted - replay.tool[k]), rel=1e-6)
    assert "commanded" in replay.curves


@pytest.mark.parametrize("t", [[], [1.0], [2.0, 1.0], [0.0, np.inf], [1.0, 1.0]])
def test_times_that_do_not_rise_are_no_motion_to_show(t: list[float], tmp_path: Path) -> None:
    columns = {"t": np.array(t), **{f"q_{i + 1}": np.zeros(len(t)) for i in range(6)}}
    path = Recording(columns, {"robot": "kr6"}).write(tmp_path / "r.parquet")
    with pytest.raises(InputError, match="times that rise"):
        open_recording(path, None)


def test_a_recording_of_the_users_arm_names_the_file_to_give(tmp_path: Path) -> None:
    path = Recording({"t": np.arange(3.0), "q_1": np.zeros(3)}, {"robot": "mine", "urdf": "mine.urdf"}).write(
        tmp_path / "r.parquet")
    with pytest.raises(InputError, match=r"--robot mine\.urdf"):
        open_recording(path, None)


@pytest.mark.parametrize(("name", "value"), [
    ("t", np.arange(200.0)[::-1]), ("surface", np.zeros(3)), ("curve_0", np.zeros(2)),
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


    # Half a header.
    write_replay(replay, path, of_replay(replay))
    with zipfile.ZipFile(path) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    parts["q.npy"] = parts["q.npy"].replace(b"), }", b"    ")
    with zipfile.ZipFile(path, "w") as file:
        for name, content in parts.items():
            file.writestr(name, content)
    with pytest.raises(InputError, match="delete it"):
        read_replay(path, ROBOT, of_replay(replay))


def test_positions_that_are_missing_are_not_shown() -> None:
    """Of what is not a number no rotation can be made."""
    columns = dict(of_replay(_replay(100)).columns)
    columns["q_2"] = np.where(np.arange(100) < 40, np.nan, columns["q_2"])
    assert len(replay_of_columns(ROBOT, Recording(columns, {"robot": "kr6"})).t) == 60
    columns["q_2"] = np.full(100, np.inf)
    with pytest.raises(InputError, match="fewer than two samples"):
        replay_of_columns(ROBOT, Recording(columns, {"robot": "kr6"}))
