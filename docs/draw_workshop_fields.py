"""Draws the picture of docs/camera.md: what the camera sees along the line of the workshop.

``python docs/draw_workshop_fields.py`` writes ``docs/pictures/workshop_fields.png``.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from planning.path.kinematics import InverseKinematics
from scenes import load_scene
from scenes.line.cell import camera_of, set_up
from sim.arm.arm import SimulatedArm
from sim.camera.lamp import ArmShape

PICTURE = Path(__file__).parent / "pictures" / "workshop_fields.png"


def main() -> None:
    """Draws six pictures along the line."""
    cell = set_up(load_scene("line"))
    shape, kinematics = ArmShape(cell.robot), InverseKinematics(cell.robot)
    frames, q, noise = [], cell.robot.home, np.random.default_rng(0)
    with camera_of(cell) as camera, SimulatedArm(cell.robot, cell.world, cell.noise, cell.follower.q_start) as arm:
        for s in np.linspace(0.1, 1.0, 6):
            q = kinematics.search(cell.reference.pose(s), q)
            arm.reset(q)
            frames.append(camera.frame(arm.truth.tcp, noise, (shape.at(arm.q_a), shape.radii)))
    rows = np.vstack([np.hstack(frames[:3]), np.hstack(frames[3:])])
    cv2.imwrite(str(PICTURE), rows, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
