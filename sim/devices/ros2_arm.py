"""A simulated arm behind ROS 2's controllers, for tests and to try a program without a robot.

Written from the documentation of ``ros2_control`` alone: joint states from a broadcaster, ``Float64MultiArray`` to a
forward command controller, ``JointTrajectory`` to a joint trajectory controller, which interpolates by cubic
polynomials from where its reference is now. Beside it a gripper publishes its own joint states on the same topic.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import LimitError
from ideal_robot.robots.interface import RobotState
from sim.arm.arm import SimulatedArm

_MORE = 3e-3
"""Time in which another command would come behind it [s]."""
_GRIPPER = 10
"""Cycles between two joint states of the gripper."""
Delivered = Callable[[int], list[float]]
"""Delays with which a joint state goes out [s]: none if it is lost, two if it comes twice."""


@dataclass
class Ros2Run:
    """What the simulated controllers received in a run.

    Attributes:
        commands: references of every cycle ``(n,)`` [rad].
        heard: commands that arrived.
        refused: why the arm refused to go on, or None.
    """

    commands: list[Array] = field(default_factory=list)
    heard: int = 0
    refused: str | None = None


class Ros2Arm:
    """Controllers of ROS 2 around a simulated arm, in a node of their own.

    Args:
        arm: at rest.
        namespace: of all topics.
        domain: ``ROS_DOMAIN_ID``; None for that of the environment.
        shuffled: order in which joint states name the joints; that of the URDF if None.
        reliable: whether joint states are reliable.
        durable: whether the controllers require publishers that keep their messages (``transient_local``).
        delivered: see ``Delivered``; None delivers each at once.
        degrees: whether joint states are degrees, as of a node with an error.
        prefix: prefix of the joints' names, such as where one description holds two arms.

    Attributes:
        run: log of the run.
        frozen: while true the time stamps do not advance.
        silent: while true no joint state is published.
        timeout: how long a command is waited for where no clock decides [s].
    """

    def __init__(self, arm: SimulatedArm, *, namespace: str = "", domain: int | None = None,
                 shuffled: list[int] | None = None, reliable: bool = True, durable: bool = False,
                 delivered: Delivered | None = None, degrees: bool = False, prefix: str = "") -> None:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64MultiArray
        from trajectory_msgs.msg import JointTrajectory

        self.arm, self.run, self.frozen, self.silent, self.timeout = arm, Ros2Run(), False, False, 0.5
        self._names = [prefix + name for name in arm.robot.joint_names]
        self._order = shuffled or list(range(arm.robot.n))
        self._delivered, self._degrees, self._kind = delivered, degrees, JointState
        self._rclpy, self._context = rclpy, rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain,
                   signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        self.node = rclpy.create_node("simulated_controllers", context=self._context, namespace=namespace or None,
                                      enable_rosout=False, start_parameter_services=False)
        keeps = DurabilityPolicy.TRANSIENT_LOCAL if durable else DurabilityPolicy.VOLATILE
        self._quality = QoSProfile(
            depth=10, reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT)
        self.publish_states()
        listened = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE, durability=keeps)
        for kind, topic, taken in (
                (Float64MultiArray, "forward_position_controller/commands", self._command),
                (JointTrajectory, "joint_trajectory_controller/joint_trajectory", self._trajectory)):
            self.node.create_subscription(kind, topic, taken, listened)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._reference, self._speed = arm.truth.q_m.copy(), np.zeros(arm.robot.n)
        self._state = RobotState(arm.t, self._reference, np.zeros(arm.robot.n))
        self._points: list[tuple[float, Array, Array]] = []
        self._waiting: list[tuple[float, Any]] = []
        self._stopped, self._k, self._stamp = False, 0, 100.0

    def publish_states(self) -> None:
        """Creates the publisher of the joint states, ``states``, anew."""
        self.states = self.node.create_publisher(self._kind, "joint_states", self._quality)

    def stop(self) -> None:
        """Ends ``play`` from another thread."""
        self._stopped = True

    def play(self, *, slowed: float = 1.0) -> Ros2Run:
        """Simulates in real time until ``stop``.

        Args:
            slowed: how many times as long every cycle takes; 0: a cycle ends when a command has come, so that the
                result does not depend on the computer's load.
        """
        T = self.arm.t_ipo
        due = time.perf_counter()
        while not self._stopped:
            self.cycle()
            if not slowed:
                self._answered()
                continue
            due += slowed * T
            while not self._stopped:
                self._deliver()
                remaining = due - time.perf_counter()
                self._executor.spin_once(timeout_sec=max(min(remaining, 0.002), 0.0))
                if remaining <= 0:
                    break
            due = max(due, time.perf_counter() - 0.5)
        return self.run

    def _answered(self) -> None:
        """Waits for a command; not longer than a cycle before the first one, then until it is surely not coming."""
        heard, begun = self.run.heard, time.perf_counter()
        patience = self.timeout if heard else self.arm.t_ipo
        while not self._stopped and time.perf_counter() - begun < patience:
            self._deliver()
            before = self.run.heard
            self._executor.spin_once(timeout_sec=_MORE)
            # A command does not say which state it answers: of several for earlier states, the last one is used.
            if self.run.heard == before > heard:
                return

    def cycle(self) -> None:
        """One cycle of the controllers: reference, arm, joint states."""
        reference = self.reference()
        try:
            state = self.arm.cycle(reference)
        except LimitError as error:
            # As real hardware: it stops and reports why.
            self.run.refused, self._stopped = str(error), True
            return
        self.run.commands.append(reference)
        self.tell(state)

    @property
    def led(self) -> bool:
        """Whether a trajectory extends into the coming cycle."""
        return bool(self._points) and self._points[-1][0] > self._stamp + 1e-9

    def reference(self) -> Array:
        """Reference of the controllers for the coming cycle ``(n,)`` [rad]."""
        if self._points:
            self._along()
        return self._reference.copy()

    def rest(self, q: Array) -> None:
        """Resets the controllers with the arm at rest at ``q (n,)`` [rad]."""
        self._points, self._reference, self._speed = [], q.copy(), np.zeros_like(q)

    def listen(self, end: float) -> bool:
        """Waits for a command until ``end`` by ``time.perf_counter`` [s]; whether one arrived."""
        heard = self.run.heard
        while self.run.heard == heard and (remaining := end - time.perf_counter()) > 0:
            self._deliver()
            self._executor.spin_once(timeout_sec=min(remaining, 2e-3))
        return self.run.heard > heard

    def tell(self, state: RobotState) -> None:
        """Publishes the arm's state at the end of a cycle, with the next stamp."""
        self._state = state
        self._k += 1
        if not self.frozen:
            self._stamp += self.arm.t_ipo
        if not self.silent:
            self._publish()

    def close(self) -> None:
        """Destroys the node, so that it leaves the ROS graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        self._rclpy.shutdown(context=self._context)

    def _publish(self) -> None:
        scale = 180.0 / np.pi if self._degrees else 1.0
        message = self._message([self._names[i] for i in self._order], scale * self._state.q[self._order],
                                self._state.tau[self._order])
        for delay in [0.0] if self._delivered is None else self._delivered(self._k):
            self._waiting.append((time.perf_counter() + delay, message))
        if self._k % _GRIPPER == 0:
            self._waiting.append((time.perf_counter(), self._message(["finger"], np.zeros(1), np.zeros(1))))
        self._deliver()

    def _message(self, names: list[str], q: Array, effort: Array) -> Any:
        message = self._kind(name=names, position=q.tolist(), effort=effort.tolist())
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(1e9 * self._stamp), 10**9)
        return message

    def _deliver(self) -> None:
        """Publishes what is due."""
        now = time.perf_counter()
        for item in [item for item in self._waiting if item[0] <= now]:
            self._waiting.remove(item)
            self.states.publish(item[1])

    def _command(self, message: Any) -> None:
        """Takes a command as a forward command controller does: the newest message is the reference."""
        if len(message.data) == self.arm.robot.n:
            self.run.heard += 1
            self._points = []
            self._reference = np.array(message.data)

    def _trajectory(self, message: Any) -> None:
        """Takes a trajectory as a joint trajectory controller does: from the header's time on, else from its arrival.

        They replace what was there; until the first of them the reference goes there from where it is.
        """
        if sorted(message.joint_names) != sorted(self._names) or not message.points:
            return
        self.run.heard += 1
        at = [list(message.joint_names).index(name) for name in self._names]
        stamp = message.header.stamp
        begin = stamp.sec + 1e-9 * stamp.nanosec or self._stamp
        self._points = [(self._stamp, self._reference.copy(), self._speed.copy())] if begin > self._stamp + 1e-9 else []
        for point in message.points:
            t = begin + point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
            speed = np.array(point.velocities)[at] if len(point.velocities) else np.zeros(len(at))
            self._points.append((t, np.array(point.positions)[at], speed))

    def _along(self) -> None:
        """Reference of the coming cycle on the trajectory: a cubic polynomial between two points, rest behind them."""
        t = self._stamp + self.arm.t_ipo
        behind = next((i for i, (at, *_) in enumerate(self._points) if at >= t - 1e-9), None)
        if behind is None:
            self._reference, self._speed = self._points[-1][1].copy(), np.zeros(self.arm.robot.n)
            return
        if behind == 0:
            self._reference, self._speed = self._points[0][1].copy(), self._points[0][2].copy()
            return
        (t0, q0, v0), (t1, q1, v1) = self._points[behind - 1], self._points[behind]
        span = t1 - t0
        u = (t - t0) / span
        h = (2 * u**3 - 3 * u**2 + 1, u**3 - 2 * u**2 + u, -2 * u**3 + 3 * u**2, u**3 - u**2)
        d = (6 * u**2 - 6 * u, 3 * u**2 - 4 * u + 1, -6 * u**2 + 6 * u, 3 * u**2 - 2 * u)
        self._reference = h[0] * q0 + h[1] * span * v0 + h[2] * q1 + h[3] * span * v1
        self._speed = (d[0] * q0 + d[1] * span * v0 + d[2] * q1 + d[3] * span * v1) / span
