"""Reads the states of an arm behind RTDE beside another client that commands it."""

from __future__ import annotations

import numpy as np

from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError
from ideal_robot.robots.address import Address
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.state_reader import ReportedState, StateReader, no_radians
from ideal_robot.rtde.robot import AXES, PORT
from ideal_robot.rtde.wire import RtdeConnection, RtdeError

_FIELDS = {"timestamp": "DOUBLE", "actual_q": "VECTOR6D"}
_ANSWERS = 5.0
"""Time that the controller has at most to agree on what it sends [s]."""


class RtdeReader(StateReader):
    """A ``StateReader`` that reads only time and joint angles, and writes no register.

    Args:
        robot: six joints, and the requested cycle of states.
        host, port: address at which the controller listens.
        patience: how long it is waited for [s].

    Raises:
        InputError: an arm without six joints.
        RtdeError: no controller there, another protocol, angles that are none of the arm's.
    """

    def __init__(self, robot: Robot, host: str, port: int, patience: float) -> None:
        if robot.n != AXES:
            raise InputError(f"RTDE reports arms with {AXES} joints", field="robot", value=f"{robot.name}: {robot.n}")
        self._connection = RtdeConnection(host, port, min(patience, _ANSWERS))
        try:
            self._connection.agree()
            self._recipe = self._connection.outputs(_FIELDS, 1.0 / robot.t_ipo)
            self._connection.start()
            first = self._read(Deadline.within(patience))[0]
            if (why := no_radians(robot, robot.joint_names, first.q, "actual_q")) is not None:
                raise RtdeError(why)
        except RtdeError:
            self.close()
            raise

    def read(self, timeout: float) -> list[ReportedState]:
        """States since the last call; see ``StateReader.read``. Raises RtdeError where the connection is broken."""
        return self._read(Deadline.within(timeout), quiet=True)

    def _read(self, deadline: Deadline, quiet: bool = False) -> list[ReportedState]:
        packages = self._connection.every(self._recipe, deadline, quiet)
        return [ReportedState(data["timestamp"][0], arrived, np.array(data["actual_q"])) for data, arrived in packages]

    def close(self) -> None:
        """Closes the connection; see ``StateReader.close``."""
        self._connection.pause()
        self._connection.close()


def reader(address: Address, robot: Robot, patience: float) -> RtdeReader:
    """Reads the states at ``rtde://host:port``.

    Args:
        address: of the arm's interface.
        robot: the robot whose joints they are.
        patience: how long they are waited for [s].

    Raises:
        InputError: an option, an arm without six joints.
        RtdeError: see ``RtdeReader``.
    """
    address.knows()
    return RtdeReader(robot, *address.at(PORT), patience)
