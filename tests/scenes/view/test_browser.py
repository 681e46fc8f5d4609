"""The viewer in a headless browser with software WebGL: arm, line, force, picture and error are seen, and move."""

from __future__ import annotations

import dataclasses
import io
import socket
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scenes.report.replay import Replay
from tests.browser import Page, chromium, needs_chromium
from tests.scenes.report.test_replay import ROBOT, _replay

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
    pose = ROBOT.fk()
    tool = np.array([pose(row).translation for row in wide])
    angle = np.linspace(0, 2 * np.pi, 200)
    ring = np.column_stack([0.7 + 0.5 * np.cos(angle), 0.5 * np.sin(angle), np.full(200, 0.02)])
    return dataclasses.replace(plain, q=wide, tool=tool, wanted=tool, curves={"drawn line": ring},
                               force=np.tile([0.0, -20.0, 5.0], (200, 1)),
                               pictures=((0.0, png((255, 0, 255))), (4.0, png((0, 255, 255)))))


def near(picture: np.ndarray, colour: tuple[int, int, int], within: int = 60) -> np.ndarray:
    return np.asarray(np.abs(picture - np.array(colour)).max(axis=2) < within)


@needs_chromium
def test_arm_line_force_picture_and_error_are_seen_and_the_slider_moves_them(tmp_path: Path) -> None:
    from scenes.view.player import Player
    from scenes.view.viewer import Viewer

    with socket.socket() as link:
        link.bind(("127.0.0.1", 0))
        port = link.getsockname()[1]
    viewer = Viewer(ROBOT, port)
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
    pictures = [first, second]
    before, after = map(arm, pictures)
    assert before.sum() > 1500, "the arm"
    assert (before & ~after).sum() > 300, "the arm moves with the slider"
    rows, columns = np.nonzero(near(pictures[0][SCENE], (40, 40, 40)))
    assert len(rows) > 300, "the line"
    assert np.ptp(columns) > 150
    assert np.ptp(rows) > 40
    assert near(pictures[0][SCENE], (0, 110, 190)).sum() > 50, "the force's arrow"
    assert near(pictures[0][PANEL], (255, 0, 255)).sum() > 3000, "the camera's picture"
    assert near(pictures[1][PANEL], (255, 0, 255)).sum() == 0
    assert near(pictures[1][PANEL], (0, 255, 255)).sum() > 3000, "the camera's picture of the other instant"
    assert near(pictures[0][PANEL], (224, 106, 0)).sum() > 100, "the error over time"
    assert orange(phone[PHONE]).sum() > 1500, "the arm on a phone"
    assert np.ptp(np.nonzero(orange(phone[PHONE]))[0]) > 100, "all of it"
    assert (phone[PHONE].max(axis=2) < 80).sum() > 300, "the line on a phone"
    assert near(phone, (0, 255, 255)).sum() == 0, "plot and picture are closed until they are touched"
