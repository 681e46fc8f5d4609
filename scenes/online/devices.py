"""Which devices a run uses, and how the arm among them is opened."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiRobot
from ideal_robot.rsi.message import RsiFormat
from ideal_robot.rtde import RtdeRobot
from ideal_robot.rtde.wire import RtdeError
from scenes.online.camera_process import CalibratedCamera
from scenes.online.cell_check import Look
from scenes.online.cycle import CycleLog, Task
from scenes.online.line_job import CalibrationMotion
from scenes.online.live_arm import Link, LiveArm
from scenes.online.live_sensors import LiveCamera, LiveForce
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_search import DetectionSettings
from sensing.stream import host_and_port

RSI_PORT, RTDE_PORT = 49152, 30004  # of KUKA's example of RSI, and the one that UR's controllers listen on


@dataclass(frozen=True)
class Devices:
    """Addresses and what has to be known of the devices.

    Attributes:
        arm: ``rsi://host:port``, where this computer listens for the controller, or ``rtde://host:port``, where the
            controller listens.
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
        RsiError, RtdeError: no controller there.
    """
    scheme, _, rest = devices.arm.partition(":")
    if scheme == "rsi":
        host, port = host_and_port(rest, "--arm", RSI_PORT)
        form = RsiFormat(hold_on=True if devices.relative else None)
        if devices.rsi_config is not None:
            form = RsiFormat.read(devices.rsi_config, robot.n)
        with RsiRobot(robot, host=host, port=port, relative=devices.relative, form=form, bridge=devices.bridge,
                      controller=devices.controller, answers_within=answers_within) as rsi:
            rsi.connect(devices.patience)
            yield rsi
    elif scheme == "rtde":
        host, port = host_and_port(rest, "--arm", RTDE_PORT)
        with RtdeRobot(robot, host, port=port, bridge=devices.bridge, answers_within=answers_within) as rtde:
            _connect(rtde, devices.patience)
            yield rtde
    else:
        raise InputError("expected an address such as rsi://127.0.0.1:49152 or rtde://192.168.1.30", field="--arm",
                         value=devices.arm[:80])


def _connect(rtde: RtdeRobot, patience: float) -> None:
    """Connects as soon as somebody listens and the program there runs, up to ``patience`` [s]."""
    deadline = Deadline.within(patience)
    while True:
        try:
            rtde.connect(deadline.left)
            return
        except RtdeError as error:
            if not isinstance(error.__cause__, OSError) or deadline.passed:
                raise
        time.sleep(0.2)


# What following a line and following a surface have in common, for whoever runs them on devices.

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
    def look(self) -> Look | None:
        """What is looked at before the job; None where no camera is calibrated."""
        ...

    @property
    def q_start(self) -> Array:
        """Where the arm has to rest at first ``(n,)`` [rad]."""
        ...

    def rehearse(self) -> None:
        """Loads what is compiled: nothing of it may fall into a cycle."""
        ...

    def calibration_motion(self) -> CalibrationMotion:
        """From ``q_start`` and back, for the camera to be calibrated on; raises ``SceneError`` where there is none."""
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
        """What the recording holds besides the arm's own, at times of the run ``t (N,)`` [s]; times in it are such."""
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
