"""An arm behind ROS 2's controllers, as one more implementation of ``RobotInterface``.

``sensor_msgs/JointState`` has the joint angles by name, and is the clock: a command follows each. Commands go to a
``forward_command_controller`` (``Float64MultiArray``) or, as a horizon with its times, to a
``joint_trajectory_controller``: there a message that is late or lost changes nothing as long as the horizon reaches.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError
from ideal_robot.interfaces import LinkSettings
from ideal_robot.robots.address import Address
from ideal_robot.robots.interface import LinkedRobot, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.ros2.node import Node, Ros2Error, full_name, seconds
from ideal_robot.ros2.states import KIND, STATES, JointStates, discovered

COMMANDS = "forward_position_controller/commands"
HORIZON = 0.1
"""How far a trajectory reaches ahead [s]: longer than a network or a computer usually stands still."""
_SETTLED = 8
"""States whose stamps tell the cycle before anything moves."""
_OTHERS = 1.0
"""Time between two looks at whether another publisher commands the arm [s]."""


class Ros2Robot(LinkedRobot):
    """A ``RobotInterface`` to an arm behind ROS 2.

    Args:
        robot: joints by the names of its URDF, limits, and the cycle of the joint states.
        states: full name of the topic with ``sensor_msgs/JointState``.
        commands: full name of the topic of the commands.
        trajectory: whether commands are ``trajectory_msgs/JointTrajectory``, else ``std_msgs/Float64MultiArray``.
        joints: names of the joints in the order of the controller; those of the URDF if empty.
        sim_time: whether time is that of ``/clock``.
        subnet: whether others than this computer's programs are discovered, where the environment does not say it.
        timeout: silence after which the link is taken as broken [s].
        bridge: how long joint states may be lost in a row [s].
        answers_within: time in which the arm's loop answers a command, for the watch over following [s].

    Raises:
        InputError: joints that the URDF does not have.
    """

    lost_link, packets = Ros2Error, "joint states"

    def __init__(self, robot: Robot, states: str, commands: str, *, trajectory: bool = False,
                 joints: tuple[str, ...] = (), sim_time: bool = False, subnet: bool = False, timeout: float = 1.0,
                 bridge: float = 0.1, answers_within: float = 0.5) -> None:
        names = robot.joint_names
        if joints and sorted(joints) != sorted(names):
            raise InputError(f"expected the joints of {robot.name} in some order: {', '.join(names)}", field="joints",
                             value=", ".join(joints)[:80])
        super().__init__(robot, bridge, answers_within)
        self.states, self.commands, self.trajectory = states, commands, trajectory
        self.horizon = max(math.ceil(HORIZON / robot.t_ipo), 2) if trajectory else self.max_lost
        self._names, self._order = names, [names.index(name) for name in joints or names]
        self._timeout, self._sim_time, self._subnet = timeout, sim_time, subnet
        self._node: Node | None = None
        self._joint_states: JointStates | None = None

    def connect(self, patience: float = 60.0) -> RobotState:
        """Waits up to ``patience`` [s] for joint states and a subscriber of commands, and checks that both match.

        Returns the state at rest, ``t = 0``. ``commanded`` is then the arm's position.

        Raises:
            Ros2Error: nobody publishes or listens, another publisher commands the arm, joints are missing, quality of
                service does not match, stamps stand still or come at another cycle, angles are degrees.
        """
        from std_msgs.msg import Float64MultiArray
        from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

        deadline = Deadline.within(patience)
        self._node = node = Node(sim_time=self._sim_time, subnet=self._subnet)
        kind, name = ((JointTrajectory, "trajectory_msgs/msg/JointTrajectory") if self.trajectory
                      else (Float64MultiArray, "std_msgs/msg/Float64MultiArray"))
        self._message, self._point = kind, JointTrajectoryPoint
        self._publisher = node.publisher(kind, self.commands)
        self._joint_states = joint_states = JointStates(node, self.states, self.robot, self.counts)
        node.require_publisher(KIND, self.states, deadline)
        node.require_alone(name, self.commands, deadline)
        self._looked = time.perf_counter()
        # The publisher may exist before it publishes.
        stamps = [self._stamp(self._next(max(deadline.left, self._timeout))[-1])]
        while len(stamps) < _SETTLED:
            stamps += [self._stamp(message) for message in self._next(self._timeout)]
        self._check_cycle(np.diff(stamps))
        state = self._next(self._timeout)[-1]
        self._begun = self._last = self._stamp(state)
        stands = joint_states.positions(state)
        joint_states.require_radians(state)
        self._at_rest(stands, stands)
        return self._state(state)

    def _stands_now(self) -> Array | None:
        assert self._joint_states is not None
        if not (waiting := self._joint_states.waiting()):
            return None
        return self._joint_states.positions(self._taken(waiting)[-1])

    def _handed_over(self, q_c: Array) -> None:
        if self.trajectory:
            self._publisher.publish(self._trajectory(q_c))
        else:
            self._publish(self._with_ahead(q_c)[0])

    def _publish(self, q: Array) -> None:
        """Commands joint angles ``(n,)`` [rad] from now on."""
        self._publisher.publish(self._message(data=q[self._order].tolist()))

    def _received(self) -> RobotState:
        """See ``LinkedRobot.receive``: waits for the next joint state.

        Raises Ros2Error for silence, stamps that stand still, more missed than can be bridged.
        """
        deadline, older = Deadline.within(self._timeout), list[Any]()
        while True:
            messages = None
            if not self.trajectory:
                messages = self._awaited(deadline, self._read, lambda q, ahead: self._publish(q))
            *more, message = self._next(self._timeout) if messages is None else messages
            older += more
            since = round((self._stamp(message) - self._last) / self.t_ipo)
            if since > self._stood_in:
                break
            self._came_late(since)
            older.append(message)
        # A trajectory controller continues along its horizon.
        self._bridged(since, len(older), None if self.trajectory else self._stood_in)
        self._came()
        self.unanswered = tuple(self._state(one) for one in older)
        self._last = self._stamp(message)
        self._check_others()
        return self._state(message)

    def close(self) -> None:
        """Leaves the ROS graph; a controller keeps its last command, or completes its trajectory."""
        if self._node is not None:
            self._node.close()
            self._node = None

    def _next(self, timeout: float) -> list[Any]:
        """Joint states that have come, the newest last; raises Ros2Error where none comes in time [s]."""
        assert self._joint_states is not None
        return self._taken(self._joint_states.next(timeout))

    def _read(self, deadline: Deadline) -> list[Any] | None:
        """Joint states that are there; None where none comes by the deadline."""
        assert self._joint_states is not None
        waiting = self._joint_states.waiting(deadline.left)
        return self._taken(waiting) if waiting else None

    def _taken(self, messages: list[tuple[Any, float]]) -> list[Any]:
        """Messages without the times at which they were read; notes that of the newest, which is the last."""
        self.arrived = messages[-1][1]
        return [message for message, _ in messages]

    @staticmethod
    def _stamp(message: Any) -> float:
        return seconds(message.header.stamp)

    def _check_cycle(self, steps: Array) -> None:
        """Raises Ros2Error where joint states come at another cycle than the robot's."""
        usual = float(np.median(steps))
        if not 0.75 < usual / self.t_ipo < 1.35:
            raise Ros2Error(f"{self.states} comes every {1e3 * usual:.3g} ms, {1e3 * self.t_ipo:g} ms are expected; "
                            f"--cycle {max(round(usual, 3), 1e-3):g}")

    def _check_others(self) -> None:
        """Notes where another publisher has begun to command the arm."""
        if self.arrived - self._looked > _OTHERS and self._node is not None:
            self._looked = self.arrived
            if self._node.ros.count_publishers(self.commands) > 1 and (others := self._node.others(self.commands)):
                self.fault = self.fault or f"{', '.join(others)} publishes on {self.commands}, too"

    def _trajectory(self, q_c: Array) -> Any:
        """The command of this cycle and those expected behind it, with their times."""
        message = self._message(joint_names=[self._names[i] for i in self._order])
        # Stamped by the clock of the joint states, so that a delayed message refers to the same instants.
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(round(1e9 * (self._last + self.t_ipo)), 10**9)
        rows = self._with_ahead(q_c)[:, self._order]
        speeds = np.gradient(rows, self.t_ipo, axis=0)
        for k, (row, speed) in enumerate(zip(rows, speeds, strict=True)):
            point = self._point(positions=row.tolist(), velocities=speed.tolist() if k < len(rows) - 1 else
                                [0.0] * len(row))
            point.time_from_start.sec, point.time_from_start.nanosec = divmod(round(1e9 * self.t_ipo * k), 10**9)
            message.points.append(point)
        return message

    def _state(self, message: Any) -> RobotState:
        """Torque is the effort, NaN where the message has none."""
        assert self._joint_states is not None
        at = self._joint_states.indices(message)
        measured = self._looked_at(self._joint_states.positions(message))
        whole = len(message.name)
        effort, speed = (np.array(values)[at] if len(values) == whole else np.full(self.robot.n, np.nan)
                         for values in (message.effort, message.velocity))
        return RobotState(self._stamp(message) - self._begun, measured, effort, {"qd": speed})


def opened(address: Address, robot: Robot, settings: LinkSettings) -> Ros2Robot:
    """The link to an arm at ``ros2://namespace?states=…&commands=…&waits=1``, not yet connected; raises InputError.

    Args:
        address, robot, settings: see ``ideal_robot.interfaces``.
    """
    address.knows("states", "commands", "trajectory", "joints", "sim_time", "discovery", "waits")
    options = address.options
    if "commands" in options and "trajectory" in options:
        raise InputError("expected either commands or trajectory", field=address.option, value=address.text[:80])
    namespace = address.host + address.path
    link = Ros2Robot(
        robot, full_name(namespace, options.get("states", STATES)),
        full_name(namespace, options.get("trajectory") or options.get("commands") or COMMANDS),
        trajectory="trajectory" in options, joints=tuple(filter(None, options.get("joints", "").split(","))),
        **discovered(address), **settings.given())
    # Publishers without a real-time kernel are late more often than joint states are lost, so the link waits by
    # default.
    link.clocked = not address.number("waits", 1, 0, 1)
    return link
