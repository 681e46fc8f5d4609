"""The viewer in a headless browser with software WebGL: the arm is seen, and it moves with the slider."""

from __future__ import annotations

import dataclasses
import shutil
import socket
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.scenes.report.test_replay import ROBOT, _replay

pytest.importorskip("viser")


def screenshot(port: int, path: Path) -> np.ndarray:
    done = subprocess.run(["chromium", "--headless", "--no-sandbox", "--use-angle=swiftshader",
                           "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run",
                           "--disable-background-networking", "--disable-component-update", "--disable-sync",
                           f"--user-data-dir={path.parent / 'profile'}", "--window-size=1000,1300",
                           "--virtual-time-budget=20000", "--timeout=60000", f"--screenshot={path}",
                           f"http://127.0.0.1:{port}/"], capture_output=True, text=True, timeout=240, check=False)
    assert path.is_file(), done.stderr
    return np.array(Image.open(path).convert("RGB")).astype(int)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs a headless Chromium")
def test_the_arm_is_seen_and_moves_with_the_slider(tmp_path: Path) -> None:
    from scenes.view.player import Player
    from scenes.view.viewer import Viewer

    plain = _replay(200)
    wide = plain.q + 0.8 * np.sin(plain.t)[:, None] * np.array([1.0, 0, 0, 0, 0, 0])
    pose = ROBOT.fk()
    tool = np.array([pose(row).translation for row in wide])
    replay = dataclasses.replace(plain, q=wide, tool=tool, wanted=tool)
    with socket.socket() as link:
        link.bind(("127.0.0.1", 0))
        port = link.getsockname()[1]
    viewer = Viewer(ROBOT, port)
    try:
        player = Player(viewer, replay)
        player.running.value = False
        pictures = []
        for k, t in enumerate((0.1, 1.6)):
            player.slider.value = t
            pictures.append(screenshot(viewer.port, tmp_path / f"{k}.png"))
    finally:
        viewer.server.stop()
    # The page fades in, so the arm's orange may still be pale; the notices stand above it.
    before, after = ((one[..., 0] - one[..., 2] > 30)[200:, :640] for one in pictures)
    assert before.sum() > 1500, "the arm"
    assert (before & ~after).sum() > 300, "the arm moves with the slider"
