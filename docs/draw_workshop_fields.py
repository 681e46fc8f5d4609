"""Draws the pictures of docs/camera.md: what the camera sees along the line of the workshop.

``python docs/draw_workshop_fields.py`` writes ``workshop_fields.png`` and, with tools of 150 and 250 mm between flange
and TCP, ``workshop_arm.png`` in ``docs/pictures``.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from planning.path.kinematics import InverseKinematics
from scenes import load_scene
from scenes.line.cell import camera_of, set_up
from sim.arm.arm import SimulatedArm
from sim.camera.lamp import ArmShape

PICTURES = Path(__file__).parent / "pictures"


def main() -> None:
    """Draws six pictures along the line, and three with each tool."""
    for name, rows in (("workshop_fields", (along(0.0, 0.1, 0.46), along(0.0, 0.64, 1.0))),
                       ("workshop_arm", (along(150.0, 0.1, 0.82), along(250.0, 0.1, 0.82)))):
        cv2.imwrite(str(PICTURES / f"{name}.png"), np.vstack(rows), [cv2.IMWRITE_PNG_COMPRESSION, 9])


def along(tool_mm: float, first: float, last: float) -> NDArray[np.uint8]:
    """Three pictures beside each other.

    Args:
        tool_mm: length of the tool [mm].
        first: arc length of the first one [m].
        last: that of the last one [m].
    """
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


if __name__ == "__main__":
    main()
