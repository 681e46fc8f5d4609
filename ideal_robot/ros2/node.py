"""A ROS 2 node that subscribes to one topic and, for an arm, publishes on one; mismatches are named."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from itertools import count
from typing import Any

from ideal_robot.deadline import Deadline
from ideal_robot.errors import IdealRobotError, InputError

_NUMBERS = count(1)
_LOOKS = 0.05
"""Time between two looks at who is there [s]."""
_DISCOVERED = 0.5
"""Time in which those that are there have made themselves known [s]."""


class Ros2Error(IdealRobotError):
    """No publisher or subscriber matches, or it has fallen silent."""


class Node:
    """A node in its own context; received messages are processed by the caller that waits.

    Args:
        sim_time: whether the node's clock is that of ``/clock``.
        subnet: whether others than this computer's programs are discovered, where the environment does not say it.

    Raises:
        InputError: ROS 2 cannot be started here.

    Attributes:
        ros: the node of ``rclpy``.
    """

    def __init__(self, *, sim_time: bool = False, subnet: bool = False) -> None:
        # The environment is read when the first node of a process is created.
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET" if subnet else "LOCALHOST")
        import rclpy
        from rclpy.parameter import Parameter

        self._rclpy, self._context = rclpy, rclpy.Context()
        self._listened: list[tuple[Any, Callable[[Any], None]]] = []
        try:
            rclpy.init(context=self._context, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
            self.ros = rclpy.create_node(
                f"ideal_robot_{os.getpid()}_{next(_NUMBERS)}", context=self._context, enable_rosout=False,
                start_parameter_services=False, use_global_arguments=False,
                parameter_overrides=[Parameter("use_sim_time", value=sim_time)])
        except Exception as error:  # the library's own exceptions, whose types differ between middlewares
            raise InputError(f"ROS 2 does not start here ({' '.join(str(error).split())}); check ROS_DOMAIN_ID and "
                             "RMW_IMPLEMENTATION", field="ros2") from error
        self._waits: Any = None

    @property
    def domain(self) -> str:
        """Its ROS domain and discovery range, in words."""
        reach = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET").lower()
        return f"ROS_DOMAIN_ID {self._context.get_domain_id()}, discovery on {reach}"

    def spin(self, timeout: float) -> None:
        """Processes every waiting message, oldest first; waits up to ``timeout`` [s] for one.

        An executor of ``rclpy`` would take only one message per turn and rebuild its wait set each time.
        """
        if self._take_waiting():
            return
        if self._waits is None:
            time.sleep(max(timeout, 0.0))
            return
        self._waits.clear_entities()
        for subscription, _ in self._listened:
            self._waits.add_subscription(subscription.handle)
        self._waits.wait(round(1e9 * max(timeout, 0.0)))
        self._take_waiting()

    def _take_waiting(self) -> bool:
        """Takes what waits; whether there was anything."""
        found = False
        for subscription, taken in self._listened:
            while (waiting := subscription.handle.take_message(subscription.msg_type, False)) is not None:
                found = True
                taken(waiting[0])
        return found

    def listen(self, kind: Any, topic: str, taken: Callable[[Any], None], depth: int) -> None:
        """Subscribes so that any publisher matches, reliable or not.

        Args:
            kind: class of the messages.
            topic: its full name.
            taken: called with each message.
            depth: messages that wait at most.

        Raises:
            Ros2Error: the topic is of another type.
        """
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        quality = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT,
                             durability=DurabilityPolicy.VOLATILE)
        from rclpy.impl.implementation_singleton import rclpy_implementation

        try:
            self._listened.append((self.ros.create_subscription(kind, topic, taken, quality), taken))
            self._waits = rclpy_implementation.WaitSet(len(self._listened), 0, 0, 0, 0, 0, self._context.handle)
        except Exception as error:  # the library's own exception for a topic of another type
            raise Ros2Error(f"{topic} cannot be subscribed to as {kind.__name__}: {' '.join(str(error).split())}"
                            ) from error

    def publisher(self, kind: Any, topic: str) -> Any:
        """A reliable publisher with a queue of one message.

        Args:
            kind: class of the messages.
            topic: its full name.
        """
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        return self.ros.create_publisher(kind, topic, QoSProfile(
            depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.VOLATILE))

    def require_publisher(self, kind: str, topic: str, deadline: Deadline) -> None:
        """Waits for a publisher of a topic; raises Ros2Error, with the existing topics, if there is none.

        Args:
            kind: of the messages, ``package/msg/Name``.
            topic: its full name.
            deadline: until when it is waited for.
        """
        self._until(lambda: self.ros.count_publishers(topic) > 0, deadline)
        if self.ros.count_publishers(topic) == 0:
            raise Ros2Error(f"no node publishes {topic}; {self._instead(kind)} ({self.domain})")
        for info in self.ros.get_publishers_info_by_topic(topic):
            if info.topic_type != kind:
                raise Ros2Error(f"{topic} is of {info.topic_type}, {kind} is expected; {self._instead(kind)}")

    def require_alone(self, kind: str, topic: str, deadline: Deadline) -> None:
        """Waits for a subscriber of a topic that this node publishes; raises Ros2Error where it does not match.

        Args:
            kind: of the messages, ``package/msg/Name``.
            topic: its full name.
            deadline: until when it is waited for.
        """
        self._until(lambda: self.ros.count_subscribers(topic) > 0, deadline)
        begun = time.perf_counter()
        self._until(lambda: time.perf_counter() - begun > _DISCOVERED, Deadline.within(2 * _DISCOVERED))
        listeners = self.ros.get_subscriptions_info_by_topic(topic)
        if not listeners:
            raise Ros2Error(f"no node subscribes to {topic}: is that controller active? {self._instead(kind)} "
                            f"({self.domain})")
        if (others := self.others(topic)):
            raise Ros2Error(f"{', '.join(others)} publishes on {topic}, too; two programs would command the arm: "
                            "end the other one")
        mine = next(info for info in self.ros.get_publishers_info_by_topic(topic)
                    if info.node_name == self.ros.get_name())
        from rclpy.qos import QoSCompatibility, qos_check_compatible

        for info in listeners:
            if info.topic_type != kind:
                raise Ros2Error(f"{info.node_name} expects {info.topic_type} on {topic}, not {kind}")
            fits, why = qos_check_compatible(mine.qos_profile, info.qos_profile)
            if fits == QoSCompatibility.ERROR:
                raise Ros2Error(f"quality of service of {info.node_name} on {topic} does not match a reliable, "
                                f"volatile publisher: {' '.join(why.split())}")

    def others(self, topic: str) -> list[str]:
        """Names of other nodes that publish a topic."""
        return sorted({info.node_name for info in self.ros.get_publishers_info_by_topic(topic)
                       if info.node_name != self.ros.get_name()})

    def close(self) -> None:
        """Destroys the node, so that it leaves the ROS graph."""
        self._waits = None
        self.ros.destroy_node()
        self._rclpy.shutdown(context=self._context)

    def _of_others(self, topic: str) -> bool:
        """Whether another node publishes a topic or listens to it."""
        ends = [*self.ros.get_publishers_info_by_topic(topic), *self.ros.get_subscriptions_info_by_topic(topic)]
        return any(info.node_name != self.ros.get_name() for info in ends)

    def _until(self, there: Callable[[], bool], deadline: Deadline) -> None:
        while not there() and not deadline.passed:
            self.spin(min(_LOOKS, max(deadline.left, 0.0)))

    def _instead(self, kind: str) -> str:
        """Topics of a kind that there are, in words."""
        topics = sorted(name for name, kinds in self.ros.get_topic_names_and_types()
                        if kind in kinds and self._of_others(name))
        return f"topics of {kind} are {', '.join(topics)}" if topics else f"there is no topic of {kind}"


def full_name(namespace: str, topic: str) -> str:
    """A topic's full name in a namespace, where it is not full already.

    >>> full_name("/left", "joint_states"), full_name("", "joint_states"), full_name("left", "/joint_states")
    ('/left/joint_states', '/joint_states', '/joint_states')
    """
    space = f"/{namespace.strip('/')}" if namespace.strip("/") else ""
    return topic if topic.startswith("/") else f"{space}/{topic}"


def seconds(stamp: Any) -> float:
    """A header's time stamp in seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)
