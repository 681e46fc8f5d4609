"""Which devices a run uses, and how the arm among them is opened."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ideal_robot.arrays import Array
from ideal_robot.execution.following import Following
from ideal_robot.interfaces import LinkSettings, connected_arm
from ideal_robot.loop.from_model import loop_model
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import TOLERANCE
from ideal_robot.robots.robot import Robot
from scenes.line_way import shapes_about
from scenes.methods import SceneMethod
from scenes.online.camera_process import CalibratedCamera
from scenes.online.cell_check import CalibrationMotion, Look, Piece
from scenes.online.configured import Configured
from scenes.online.force_known import Known as ForceKnown
from scenes.online.line_known import Known as LineKnown
from scenes.online.live_arm import Link, LiveArm, response_of
from scenes.online.live_sensors import LiveCamera, LiveForce
from scenes.online.log import TaskLog
from scenes.online.task import Task
from scenes.scene_files.force_scene import ForceScene
from scenes.scene_files.line_scene import LineScene
from sensing.camera.camera_model import CameraModel


@dataclass(frozen=True)
class Devices:
    """Addresses and what has to be known of the devices.

    Attributes:
        arm: address of the arm's interface, see ``ideal_robot.interfaces``.
        camera: see ``sensing.camera.cameras.open_camera``; None without one.
        force: see ``sensing.force.sensors.open_force``; None without one.
        camera_delay: from mid-exposure to the picture's arrival, at least [s]; not needed for ``stream``.
        force_delay: from the measurement to its arrival, at least [s].
        relative: whether an RSI controller takes corrections as relative.
        rsi_config: the controller's RSI ethernet XML; None for the usual names.
        controller: address of the controller behind RSI; None for whoever sends first.
        cycle: interpolation cycle [s]; the robot's if None.
        delay: whether the standard planner's delay of one cycle is in force.
        bridge: how long packets may be lost in a row [s].
        patience: how long each device is waited for [s].
        core: processor core to keep to; None for any.
        check: whether the cell is looked at before the job.
    """

    arm: str
    camera: str | None = None
    force: str | None = None
    camera_delay: float = 0.0
    force_delay: float = 0.0
    relative: bool = False
    rsi_config: Path | None = None
    controller: str | None = None
    cycle: float | None = None
    delay: bool = False
    bridge: float = 0.1
    patience: float = 60.0
    core: int | None = None
    check: bool = True


@contextmanager
def opened_arm(devices: Devices, robot: Robot, answers_within: float) -> Iterator[Link]:
    """The arm, connected; with RSI it is waited for.

    Args:
        devices: where it is.
        robot: with the cycle of the controller.
        answers_within: time in which its loop answers a command [s].

    Raises:
        InputError: an address that cannot be used.
        IdealRobotError: no controller there.
    """
    settings = LinkSettings(devices.bridge, answers_within, devices.relative, devices.rsi_config, devices.controller)
    with connected_arm(devices.arm, robot, settings, devices.patience) as link:
        yield link


# What following a line and following a surface have in common, for whoever runs them on devices.

class Job(ABC):
    """Something that is followed.

    Args:
        scene: what is followed; of its tables those of the world are not looked at.
        robot: with the controller's cycle.
        model: of the arm.
        method: how what is sensed becomes commands.
        delay: cycles of the controller's own delay.
        answers_within: time in which the arm's loop answers a command [s].
        calibration: of the camera, and whether it is to be made by moving.

    Attributes:
        needs: devices beside the arm: ``camera``, ``force``.
        braking: deceleration of a stop on the path [m/s²].
        longest: time after which a run is stuck [s].
        expected: usual length of a run [s].
        configured: the task and its sensors.
        detection: how the line looks.
    """

    needs: tuple[str, ...]
    braking: float
    longest: float
    expected: float
    configured: Configured
    _known: LineKnown | ForceKnown

    def __init__(self, scene: LineScene | ForceScene, robot: Robot, model: Model, method: SceneMethod, delay: int,
                 answers_within: float, calibration: CalibratedCamera) -> None:
        self.scene, self.robot, self.model, self.method, self.delay = scene, robot, model, method, delay
        self.answers_within, self.calibration, self.detection = answers_within, calibration, scene.line.detection
        self._set_up()

    @abstractmethod
    def _set_up(self) -> None:
        """What is known, the task, and the attributes that follow from them."""

    @property
    def camera(self) -> CameraModel | None:
        """As it is believed to be; None where none is needed."""
        return self.calibration.camera if "camera" in self.needs else None

    @property
    def look(self) -> Look | None:
        """What is looked at before the job; None where no camera is calibrated."""
        if self.camera is None or not self.calibration.known:
            return None
        return Look(self._known.reference, self.scene.reference.run_up, self.q_start, self.camera, self.model)

    @property
    def q_start(self) -> Array:
        """Where the arm has to rest at first ``(n,)`` [rad]."""
        return self.configured.task.q_start

    @property
    def log(self) -> TaskLog:
        """What happened."""
        return self.configured.task.log

    def calibration_motion(self) -> CalibrationMotion:
        """From ``q_start`` and back, for the camera to be calibrated on; raises ``SceneError`` where there is none."""
        known, ends = self._known, self.scene.reference
        piece = Piece(known.reference, 0.5 * (ends.run_up + (known.reference.length - ends.run_out)), self.q_start,
                      known.clear, shapes_about(self.scene, self.robot), known.prior)
        return CalibrationMotion.planned(piece, self.calibration.camera, self.model, self.robot, self.detection)

    def approach(self, arm: LiveArm, force: LiveForce | None) -> None:
        """Brings the arm from near ``q_start``, where it is held, to it; what is learned on the way is kept.

        Args:
            arm: connected.
            force: None where none is needed.

        Raises:
            SceneError: it is not near, or what is felt on the way cannot be.
            FollowStoppedError: it could not go on.
        """
        self.watch_following(arm)
        arm.approach(self.q_start)

    def watch_following(self, arm: LiveArm) -> None:
        """From now on the guard looks whether the arm goes where its commands lead."""
        def loaded() -> Following:
            loop = loop_model(self.model, self.robot, delay=self.delay)
            return Following(lambda: arm.link.commanded, self.robot, response_of(loop, self.robot),
                             tolerance=getattr(arm.link, "tolerance", None) or TOLERANCE,
                             cause=getattr(arm.link, "cause", None))

        arm.guard.watches.append(arm.meanwhile(loaded))

    @abstractmethod
    def rehearse(self) -> None:
        """Loads what is compiled: nothing of it may fall into a cycle."""

    @abstractmethod
    def ready(self, arm: LiveArm, camera: LiveCamera | None, force: LiveForce | None) -> Task:
        """Whatever has to be moved for before; the arm is at ``q_start`` and is left there.

        Args:
            arm: connected, at the start.
            camera: None where none is needed.
            force: None where none is needed.
        """

    @abstractmethod
    def columns(self, t: Array) -> dict[str, Array]:
        """What the recording holds besides the arm's own, at times of the run ``t (N,)`` [s]; times in it are such."""

    @abstractmethod
    def figures(self) -> dict[str, Any]:
        """Key figures for ``--json``."""

    @abstractmethod
    def planned(self) -> Array:
        """Time [s] and planned deviation from the reference [m] of each cycle ``(N, 2)``."""
