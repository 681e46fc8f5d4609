"""What following a line and following a surface have in common, for whoever runs them on devices."""

from __future__ import annotations

from typing import Any, Protocol

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from scenes.cycle import CycleLog, Task
from scenes.follow.camera_file import CalibratedCamera
from scenes.follow.live_arm import LiveArm
from scenes.follow.live_camera import LiveCamera
from scenes.follow.live_force import LiveForce
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_search import DetectionSettings


class Job(Protocol):
    """Something that is followed.

    Attributes:
        robot: with the controller's cycle.
        answers_within: time in which the arm's loop answers a command [s].
        braking: deceleration of a stop on the path [m/s²].
        longest: time after which a run is stuck [s].
        expected: usual length of a run [s].
        detection: how the line looks.
        calibration: of the camera, and whether it is to be made by moving.
    """

    robot: Robot
    answers_within: float
    braking: float
    longest: float
    expected: float
    detection: DetectionSettings
    calibration: CalibratedCamera

    @property
    def log(self) -> CycleLog:
        """What happened."""
        ...

    @property
    def camera(self) -> CameraModel | None:
        """As it is believed to be; None where none is needed."""
        ...

    @property
    def q_start(self) -> Array:
        """Where the arm has to rest at first ``(n,)`` [rad]."""
        ...

    def rehearse(self) -> None:
        """Loads what is compiled: nothing of it may fall into a cycle."""
        ...

    def calibrate(self, arm: LiveArm, camera: LiveCamera) -> CalibratedCamera:
        """Calibrates the camera by moving, and keeps it in its file.

        Args:
            arm: connected, at ``q_start``; it is left there.
            camera: on the arm.
        """
        ...

    def ready(self, arm: LiveArm, camera: LiveCamera | None, force: LiveForce | None) -> Task:
        """Whatever has to be moved for before; the arm is at ``q_start`` and is left there.

        Args:
            arm: connected, at the start.
            camera: None where none is needed.
            force: None where none is needed.
        """
        ...

    def columns(self, t: Array) -> dict[str, Array]:
        """What the recording holds besides the arm's own, at times of the run ``t (N,)`` [s]."""
        ...

    def figures(self) -> dict[str, Any]:
        """Key figures for ``--json``."""
        ...

    def planned(self) -> Array:
        """Time [s] and planned deviation from the reference [m] of each cycle ``(N, 2)``."""
        ...

    def needs(self) -> tuple[str, ...]:
        """Devices beside the arm: ``camera``, ``force``."""
        ...
