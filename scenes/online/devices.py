"""Addresses of the devices of a run, and how the arm is opened."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ideal_robot.interfaces import LinkSettings, connected_arm
from ideal_robot.robots.robot import Robot
from scenes.online.live_arm import Link


@dataclass(frozen=True)
class Devices:
    """Addresses and settings of the devices.

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
        check: whether the cell is checked before the task.
        tool_mass: of all that hangs on the force sensor [kg], by which its gain is measured; None where nobody knows.
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
    tool_mass: float | None = None


@contextmanager
def opened_arm(devices: Devices, robot: Robot, answers_within: float) -> Iterator[Link]:
    """Opens and connects the arm; with RSI it waits for the controller.

    Args:
        devices: addresses of the devices, the arm's among them.
        robot: with the cycle of the controller.
        answers_within: time in which its loop answers a command [s].

    Raises:
        InputError: an address that cannot be used, or no controller there.
    """
    settings = LinkSettings(devices.bridge, answers_within, devices.relative, devices.rsi_config, devices.controller)
    with connected_arm(devices.arm, robot, settings, devices.patience) as link:
        yield link
