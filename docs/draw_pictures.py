"""Draws pictures of the pages: what the camera sees along the line of the workshop, and the viewer.

``python docs/draw_pictures.py`` writes ``workshop_fields.png`` of docs/camera.md and, with tools of 150 and 250 mm
between flange and TCP, ``workshop_arm.png`` in ``docs/pictures``; with
``out/line/recording.parquet 1.8 docs/pictures/viewer.png`` behind it, after ``ideal-robot run line``, the viewer at
1.8 s of that run, and the same of ``force_wave`` at 2.5 s for the gallery.
"""

from __future__ import annotations

import socket
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from planning.path.kinematics import InverseKinematics
from scenes import load_scene
from scenes.line.cell import camera_of, set_up
from scenes.view.viewer import Player, Viewer, open_recording, recorded_replay
from sim.arm.arm import SimulatedArm
from sim.camera.lamp import ArmShape
from tests.browser import chromium

PICTURES = Path(__file__).parent / "pictures"
DRAWN = 30.0
"""Wait until software WebGL has drawn the whole scene [s]."""
NO_NOTICE = """document.querySelectorAll('[class*="Notification-root"]').forEach(one => one.remove())"""
"""Removes what viser says of software WebGL, which a reader's browser does not have."""


def draw_fields() -> None:
    """Draws what the camera sees along the line of the workshop: six pictures, and three with each tool."""
    for name, rows in (("workshop_fields", (along(0.0, 0.1, 0.46), along(0.0, 0.64, 1.0))),
                       ("workshop_arm", (along(150.0, 0.1, 0.82), along(250.0, 0.1, 0.82)))):
        cv2.imwrite(str(PICTURES / f"{name}.png"), np.vstack(rows), [cv2.IMWRITE_PNG_COMPRESSION, 9])


def along(tool_mm: float, first: float, last: float) -> NDArray[np.uint8]:
    """Three pictures beside each other, the first and the last at these arc lengths [m], with a tool [mm]."""
    cell = set_up(load_scene("line").changed(tool_mm=tool_mm))
    shape, kinematics = ArmShape(cell.known.robot), InverseKinematics(cell.known.robot)
    frames, q, noise = [], cell.known.robot.home, np.random.default_rng(0)
    start = cell.known.follower.q_start
    with camera_of(cell) as camera, SimulatedArm(cell.known.robot, cell.world, cell.noise, start) as arm:
        for s in np.linspace(first, last, 3):
            q = kinematics.search(cell.known.reference.pose(s), q)
            arm.reset(q)
            frames.append(camera.frame(arm.truth.tcp, noise, (shape.at(arm.q_a), shape.radii), arm.q_a))
    return np.hstack(frames)


def draw_viewer(recording: Path, at: float, picture: Path) -> None:
    """Draws one instant [s] of a recorded run in a headless Chromium, as a browser shows it."""
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
    if sys.argv[1:]:
        draw_viewer(Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3]))
    else:
        draw_fields()
