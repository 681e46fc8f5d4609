"""The data that a follower knows before the motion, without those of the simulated world."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from ideal_robot.robots.robot import Robot
from planning.path.reference import ReferencePath
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from sensing.camera.camera_model import CameraModel
from sensing.camera.detector import LineDetector
from sensing.camera.hand_eye import PRIOR
from sensing.camera.line_search import DetectionSettings


@dataclass(kw_only=True)
class Known:
    """Data for a follower that are known before the motion.

    Attributes:
        scene: the scene file; its tables of the simulated world are not used.
        robot: as its data sheet has it, with the controller's cycles.
        delay: cycles between the hand-over of a command and the begin of its interpolation.
        reference: the path.
        camera: the camera model: nominal at first, then calibrated; used where the scene has a camera.
        detector: finds a line's points in a field.
        detection: how the line looks.
        clear: how far the tip keeps away from the reference while the camera is calibrated [m].
        prior: of that calibration.
    """

    clear: ClassVar[float] = 0.0
    prior: ClassVar[Mapping[str, float]] = PRIOR
    scene: LineScene | ForceScene
    robot: Robot
    delay: int
    reference: ReferencePath
    camera: CameraModel
    detector: LineDetector
    detection: DetectionSettings = field(default_factory=DetectionSettings)
