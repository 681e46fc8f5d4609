"""The joint states of one arm on a ROS 2 topic that may also carry others."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError
from ideal_robot.robots.address import Address
from ideal_robot.robots.interface import LinkCounts
from ideal_robot.robots.robot import Robot
from ideal_robot.robots.state_reader import ReportedState, StateReader, no_radians
from ideal_robot.ros2.node import Node, Ros2Error, full_name, seconds

STATES = "joint_states"
KIND = "sensor_msgs/msg/JointState"
_WAITING = 1000
"""States that are kept for whoever reads all of them: a second at the shortest cycle."""
_QUEUE = 100
"""Messages that wait at most: those of a computer that stood still for a tenth of a second came, and are not lost."""


class JointStates:
    """Messages of ``sensor_msgs/JointState`` that have all joints of an arm; others, as a gripper's, are skipped.

    Args:
        node: listens.
        topic: its full name.
        robot: joints by the names of its URDF.
        counts: of messages that are passed over.
        every: whether all messages are returned as received; otherwise only those with rising stamps.

    Attributes:
        names: of the joints.
    """

    def __init__(self, node: Node, topic: str, robot: Robot, counts: LinkCounts, *, every: bool = False) -> None:
        from sensor_msgs.msg import JointState

        self.names = robot.joint_names
        self._node, self._topic, self._robot, self._counts, self._every = node, topic, robot, counts, every
        self._taken: deque[tuple[Any, float]] = deque(maxlen=_WAITING)
        self._newest = -np.inf
        self._places: tuple[tuple[str, ...], list[int]] = ((), [])
        node.listen(JointState, topic, self._take, _QUEUE)

    def next(self, timeout: float) -> list[tuple[Any, float]]:
        """Messages since the last call, with their times of reading by ``time.perf_counter`` [s].

        The newest is the last one. Raises Ros2Error where none comes within ``timeout`` [s], or only unusable ones.
        """
        deadline, outdated, partial = Deadline.within(timeout), self._counts.outdated, self._counts.partial
        while not self._taken:
            self._node.spin(min(deadline.left, 0.1))
            if deadline.passed and not self._taken:
                raise Ros2Error(self._silent(timeout, self._counts.outdated > outdated, self._counts.partial > partial))
        return self.waiting()

    def waiting(self, timeout: float = 0.0) -> list[tuple[Any, float]]:
        """Messages since the last call, possibly none, after waiting up to ``timeout`` [s]; see ``next``."""
        self._node.spin(timeout)
        taken = list(self._taken)
        self._taken.clear()
        return taken

    def indices(self, message: Any) -> list[int]:
        """Indices of the arm's joints in a message."""
        names = tuple(message.name)
        if names != self._places[0]:
            self._places = names, [names.index(name) for name in self.names]
        return self._places[1]

    def positions(self, message: Any) -> Array:
        """Joint angles ``(n,)`` [rad] of a message, in the order of the URDF."""
        return np.array(message.position)[self.indices(message)]

    def require_radians(self, message: Any) -> None:
        """Raises Ros2Error where the angles of a message can only be degrees."""
        if (why := no_radians(self._robot, self.names, self.positions(message), self._topic)) is not None:
            raise Ros2Error(why)

    def _take(self, message: Any) -> None:
        stamp = seconds(message.header.stamp)
        if not set(self.names) <= set(message.name) or len(message.position) != len(message.name):
            self._counts.partial += 1
        elif not self._every and stamp <= self._newest:
            self._counts.outdated += 1
        else:
            self._newest = stamp
            self._taken.append((message, time.perf_counter()))

    def _silent(self, timeout: float, outdated: bool, partial: bool) -> str:
        """Why no message came, in words."""
        if outdated:
            return (f"stamps of {self._topic} stand still or go back; is the simulation paused, or was its time set "
                    "anew?")
        if partial:
            return f"{self._topic} has not all joints of {self._robot.name}: {', '.join(self.names)}"
        if self._node.ros.count_publishers(self._topic) == 0:
            return f"the publisher of {self._topic} is gone"
        return f"no message on {self._topic} for {timeout:g} s"


class Ros2Reader(StateReader):
    """A ``StateReader`` of joint states.

    Args:
        robot: joints by the names of its URDF.
        topic: full name of the topic.
        patience: how long it is waited for [s].
        sim_time: whether the node's time is that of ``/clock``.
        subnet: whether others than this computer's programs are discovered, where the environment does not say it.

    Raises:
        Ros2Error: nobody publishes there, joints are missing, angles are degrees.
    """

    def __init__(self, robot: Robot, topic: str, patience: float, *, sim_time: bool = False, subnet: bool = False
                 ) -> None:
        deadline, self.counts = Deadline.within(patience), LinkCounts()
        self._node = Node(sim_time=sim_time, subnet=subnet)
        try:
            self._states = JointStates(self._node, topic, robot, self.counts, every=True)
            self._node.require_publisher(KIND, topic, deadline)
            (message, _), *_ = self._states.next(max(deadline.left, 1.0))
            self._states.require_radians(message)
        except Ros2Error:
            self.close()
            raise

    def read(self, timeout: float) -> list[ReportedState]:
        """States since the last call; waits for a publisher that is silent or gone; see ``StateReader.read``."""
        try:
            taken = self._states.next(timeout)
        except Ros2Error:
            return []
        return [ReportedState(seconds(message.header.stamp), arrived, self._states.positions(message))
                for message, arrived in taken]

    def close(self) -> None:
        """Closes the node; see ``StateReader.close``."""
        self._node.close()


def reader(address: Address, robot: Robot, patience: float) -> Ros2Reader:
    """Reads the states at ``ros2://namespace?states=…``; options of commands are passed over.

    Args:
        address: of the arm's interface.
        robot: the robot whose joints they are.
        patience: how long they are waited for [s].

    Raises:
        InputError: another option.
        Ros2Error: see ``Ros2Reader``.
    """
    address.knows("states", "commands", "trajectory", "joints", "sim_time", "discovery", "waits")
    return Ros2Reader(robot, full_name(address.host + address.path, address.options.get("states", STATES)), patience,
                      **discovered(address))


def discovered(address: Address) -> dict[str, bool]:
    """The entries ``sim_time`` and ``subnet`` of an address as truth values; raises InputError for other values."""
    discovery = address.options.get("discovery", "localhost")
    if discovery not in ("localhost", "subnet"):
        raise InputError("expected localhost or subnet", field=f"{address.option} ?discovery", value=discovery[:40])
    return {"sim_time": bool(address.number("sim_time", 0, 0, 1)), "subnet": discovery == "subnet"}
