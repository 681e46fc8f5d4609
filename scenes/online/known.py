"""What is known before anything moves, by whoever follows: nothing of the world."""

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
    """What a follower is given.

    Attributes:
        scene: the file; of its tables those of the world are not looked at.
        robot: as its data sheet has it, with the controller's cycles.
        delay: cycles between the hand-over of a command and the begin of its interpolation.
        reference: the path.
        camera: as it is believed: by hand at first, then as calibrated; looked through where the scene has one.
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
