"""Opens arms behind makers' interfaces by their addresses.

A package outside adds one by ``INTERFACES.register`` or an entry point of the group ``ideal_robot.interfaces``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, cast

from ideal_robot.deadline import Deadline
from ideal_robot.errors import IdealRobotError, InputError, did_you_mean
from ideal_robot.registry import Registry, imported
from ideal_robot.robots.address import Address
from ideal_robot.robots.interface import LinkedRobot
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.state_reader import StateReader


@dataclass(frozen=True)
class LinkSettings:
    """Known settings of a controller, besides its address.

    Attributes:
        bridge: how long packets may be lost in a row [s].
        answers_within: time in which the arm's loop answers a command [s]; None for the interface's usual one.
        relative: whether an RSI controller takes corrections as relative.
        rsi_config: an RSI controller's ethernet XML; None for the usual names.
        controller: address of the controller behind RSI; None for whoever sends first.
    """

    bridge: float = 0.1
    answers_within: float | None = None
    relative: bool = False
    rsi_config: Path | None = None
    controller: str | None = None

    def given(self) -> dict[str, Any]:
        """The settings that were given, as arguments of a link."""
        return {"bridge": self.bridge} | ({} if self.answers_within is None
                                          else {"answers_within": self.answers_within})


Opener = Callable[[Address, Robot, LinkSettings], LinkedRobot]
"""Makes the link to an address for a robot; it is connected by whoever asked for it."""
ReaderOpener = Callable[[Address, Robot, float], StateReader]
"""Begins to read the states at an address, of a robot, waited for so long [s]."""


@dataclass(frozen=True)
class ArmInterface:
    """A maker's positional interface.

    Attributes:
        title: name of the interface.
        opened: ``"module:function"`` of an ``Opener``, imported on first use.
        example: an address.
        cycles: interpolation cycles, in words.
        reports: quantities that the controller reports, in words.
        tried: devices it was tested with, in words.
        package: of the wire, as it is imported; empty where the wire is ours.
        extra: of ``pip install 'ideal-robot[…]'``; empty where none is needed.
        cycle: the interpolation cycle where there is only one [s]; None where the robot's data or ``--cycle`` say it.
        read: ``"module:function"`` of a ``ReaderOpener``; empty where only the commanding client receives states.
    """

    title: str
    opened: str
    example: str
    cycles: str
    reports: str
    tried: str
    package: str = ""
    extra: str = ""
    cycle: float | None = None
    read: str = ""

    @property
    def installed(self) -> bool:
        """Whether its library can be imported."""
        try:
            self.require()
        except InputError:
            return False
        return True

    def require(self, option: str = "--arm") -> None:
        """Raises InputError where its library is not installed, with the command that installs it."""
        if not self.package:
            return
        try:
            import_module(self.package)
        except ImportError as error:
            raise InputError(f"{self.title} needs {self.package} ({error}); pip install 'ideal-robot[{self.extra}]'",
                             field=option) from error


RSI = ArmInterface(
    "KUKA RSI", "ideal_robot.rsi.robot:opened", "rsi://127.0.0.1:49152", "4 or 12 ms", "angles, currents, late answers",
    "own and four public simulators")
RTDE = ArmInterface(
    "Universal Robots RTDE", "ideal_robot.rtde.robot:opened", "rtde://192.168.1.30", "2 or 8 ms",
    "angles, currents, safety state, override, payload, accelerometer", "own simulator; ur_rtde as client",
    read="ideal_robot.rtde.reader:reader")
FRANKA = ArmInterface(
    "Franka FCI", "ideal_robot.fci.robot:opened", "franka://192.168.1.11", "1 ms, or whole milliseconds interpolated",
    "angles, setpoints, torques, external torques and wrench, mode", "franky-sim (MuJoCo)", "pylibfranka", "franka",
    1e-3)
FANUC = ArmInterface(
    "FANUC Stream Motion", "ideal_robot.stream_motion.robot:opened", "fanuc://192.168.1.100", "8 ms",
    "angles, currents, speed scale, wrench", "airo-fanuc's emulated controller", "airo_fanuc", "fanuc", 8e-3)
EGM = ArmInterface(
    "ABB EGM", "ideal_robot.egm.robot:opened", "egm://:6510", "4 to 24 ms", "angles, references, utilization, wrench",
    "own controller, which two clients of others lead", "abb_robot_client", "egm")
ROS2 = ArmInterface(
    "ROS 2", "ideal_robot.ros2.robot:opened", "ros2://?commands=/forward_position_controller/commands",
    "of the joint states", "angles, speeds, efforts", "own node", "rclpy", "ros2",
    read="ideal_robot.ros2.states:reader")

INTERFACES: Registry[ArmInterface] = Registry("interface", "ideal_robot.interfaces", {
    "rsi": "ideal_robot.interfaces:RSI",
    "rtde": "ideal_robot.interfaces:RTDE",
    "franka": "ideal_robot.interfaces:FRANKA",
    "fanuc": "ideal_robot.interfaces:FANUC",
    "egm": "ideal_robot.interfaces:EGM",
    "ros2": "ideal_robot.interfaces:ROS2",
})
"""Interfaces by the scheme of their address."""


def interface_of(address: str, option: str = "--arm") -> tuple[ArmInterface, Address]:
    """The interface of an address, with its library installed, and the parsed address.

    Args:
        address: ``scheme://…``.
        option: the command line's name of it, for messages.

    Raises:
        InputError: no address, an unknown scheme, a library that is not installed.
    """
    example = "rsi://127.0.0.1:49152 or rtde://192.168.1.30"
    place = Address.parse(address, option, example)
    if place.scheme not in INTERFACES:
        raise InputError(f"{did_you_mean(place.scheme, INTERFACES.names())}expected an address such as {example}; "
                         f"interfaces are {', '.join(INTERFACES.names())}", field=option, value=address[:80])
    interface = INTERFACES.get(place.scheme)
    interface.require(option)
    return interface, place


@contextmanager
def connected_arm(address: str, robot: Robot, settings: LinkSettings, patience: float, option: str = "--arm"
                  ) -> Iterator[LinkedRobot]:
    """The arm at an address, connected and at rest; the link is closed at the end of the block.

    Args:
        address: ``scheme://…``.
        robot: with the cycle of the controller.
        settings: further known settings.
        patience: how long it is waited for [s].
        option: the command line's name of the address, for messages.

    Raises:
        InputError: an address that cannot be used, a robot that does not fit the interface, no controller there, or one
            that refuses commands. The arm has not moved then.
    """
    interface, place = interface_of(address, option)
    opened: Opener = imported(cast(Any, interface.opened))
    with opened(place, robot, settings) as link:
        with _at(address, option):
            _connect(link, patience)
        yield link


@contextmanager
def read_arm(address: str, robot: Robot, patience: float, option: str) -> Iterator[StateReader]:
    """Reads the states of an arm that another program commands, until the end of the block.

    Args:
        address: ``scheme://…``.
        robot: the robot with its joints, and the requested cycle of states.
        patience: how long it is waited for [s].
        option: the command line's name of the address, for messages.

    Raises:
        InputError: an address that cannot be used, an interface without passive readers, no controller, states that are
            not the robot's.
    """
    interface, place = interface_of(address, option)
    if not interface.read:
        names = [name for name in INTERFACES.names() if INTERFACES.get(name).read]
        raise InputError(f"{interface.title} reports to nobody but the program that leads the arm; expected "
                         f"{' or '.join(f'{name}://' for name in names)}, on which others read along", field=option,
                         value=address[:80])
    opened: ReaderOpener = imported(cast(Any, interface.read))
    with _at(address, option):
        reader = opened(place, robot, patience)
    with reader:
        yield reader


@contextmanager
def _at(address: str, option: str) -> Iterator[None]:
    """Names the address where nobody is found at it within the block."""
    try:
        yield
    except InputError:
        raise
    except IdealRobotError as error:
        raise InputError(str(error), field=option, value=address[:80]) from error


def _connect(link: LinkedRobot, patience: float) -> None:
    """Connects as soon as somebody listens there, up to ``patience`` [s]."""
    deadline = Deadline.within(patience)
    while True:
        try:
            link.connect(max(deadline.left, 0.01))
            return
        except IdealRobotError as error:
            if not isinstance(error.__cause__, OSError) or deadline.passed:
                raise
        time.sleep(0.2)
