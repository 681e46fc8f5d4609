"""Draws the viewer's pictures of the gallery: a run in a headless Chromium, as a browser shows it.

``python docs/draw_viewer.py out/line/recording.parquet 1.8 docs/pictures/viewer.png`` after ``ideal-robot run line``,
and the same of ``force_wave`` at 2.5 s.
"""

from __future__ import annotations

import socket
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from scenes.view.viewer import Player, Viewer, open_recording, recorded_replay
from tests.browser import chromium

DRAWN = 30.0
"""Wait until software WebGL has drawn the whole scene [s]."""
NO_NOTICE = """document.querySelectorAll('[class*="Notification-root"]').forEach(one => one.remove())"""
"""Removes what viser says of software WebGL, which a reader's browser does not have."""


def main(recording: Path, at: float, picture: Path) -> None:
    """Draws one instant of a recorded run.

    Args:
        recording: what the run wrote.
        at: time in it [s].
        picture: PNG to write.
    """
    robot, read = open_recording(recording, None)
    with socket.socket() as link:
        link.bind(("127.0.0.1", 0))
        port = link.getsockname()[1]
    viewer = Viewer(robot, port)
    try:
        player = Player(viewer, recorded_replay(recording, robot, read))
        player.running.value = False
        player.slider.value = at
        with tempfile.TemporaryDirectory() as folder, chromium(Path(folder)) as page:
            page.open(f"http://127.0.0.1:{viewer.port}/", 1100, 800)
            time.sleep(DRAWN)
            page.value(NO_NOTICE)
            time.sleep(1.0)
            Image.fromarray(page.picture().astype(np.uint8)).save(picture, optimize=True)
    finally:
        viewer.server.stop()


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3]))
