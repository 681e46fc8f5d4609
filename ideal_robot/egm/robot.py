"""An arm behind ABB's Externally Guided Motion (EGM), as one more implementation of ``RobotInterface``.

Joint position guidance (``EGMActJoint``, ``EGMRunJoint``): the controller sends its state every 4 to 24 ms to where
this computer listens, and takes the joints of each answer as its new reference. The messages are those of
``abb-robot-client``. Time is the number of the controller's message, not its arrival.
"""

from __future__ import annotations

import socket
import time
from contextlib import suppress
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import BAD_ADDRESS, IdealRobotError, InputError
from ideal_robot.interfaces import LinkSettings
from ideal_robot.robots.address import Address
from ideal_robot.robots.interface import LinkedRobot, RobotState, cycles_since, read_waiting
from ideal_robot.robots.robot import Robot

PORT = 6510
"""UDP port of ABB's examples."""
_OWN = 6
"""Joints of a message; a seventh is its first external one."""
_LARGEST = 1e4
"""No angle is as large [deg]."""
_PACE = 25
"""Messages after which their time stamps tell the cycle."""
_WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")


class EgmError(IdealRobotError):
    """The controller is not reachable, refuses to be commanded, or has stopped the arm."""


class EgmRobot(LinkedRobot):
    """A ``RobotInterface`` to an arm whose controller speaks EGM; listens from its creation on.

    Without an answer the controller holds its last reference.

    Args:
        robot: six or seven joints, limits, and the controller's cycle (its ``SampleRate``).
        host: address of ours to listen on.
        port: UDP port; 0 for any free one, see ``address``.
        timeout: silence of the controller after which the link is taken as broken [s].
        bridge: how long messages may be lost in a row [s].
        answers_within: time in which the arm's loop answers a command, for the watch over following [s].

    Raises:
        InputError: an address that cannot be listened on, an arm with another number of joints.
    """

    lost_link, packets = EgmError, "messages"

    def __init__(self, robot: Robot, *, host: str = "127.0.0.1", port: int = PORT, timeout: float = 1.0,
                 bridge: float = 0.1, answers_within: float = 0.5) -> None:
        if robot.n not in (_OWN, _OWN + 1) or robot.prismatic.any():
            raise InputError(f"EGM moves arms with {_OWN} or {_OWN + 1} joints that turn", field="robot",
                             value=f"{robot.name}: {robot.n}")
        super().__init__(robot, bridge, answers_within)
        self.horizon = self.max_lost
        self._timeout = timeout
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except BAD_ADDRESS as error:
            self._socket.close()
            raise InputError(f"cannot listen there ({error})", field="host:port", value=f"{host}:{port}") from error
        self._peer: tuple[str, int] | None = None
        self._answers = 0
        self._library: Any = None

    @property
    def address(self) -> tuple[str, int]:
        """Host and port on which it listens."""
        host, port = self._socket.getsockname()
        return host, port

    def connect(self, patience: float = 60.0) -> RobotState:
        """Waits for the controller's messages, up to ``patience`` [s], and until it can be commanded.

        Returns the state at rest, ``t = 0``. ``commanded`` is then the controller's setpoint.

        Raises:
            EgmError: no message, or an arm that is not given to this computer.
        """
        from abb_robot_client._egm_protobuf import egm_pb2

        self._library, deadline = egm_pb2, Deadline.within(patience)
        message = self._next(deadline)
        while (reason := self._stopped(message)) is not None:
            if deadline.left < self.t_ipo:
                raise EgmError(f"the arm cannot be commanded: {reason}")
            # Until then the answers repeat the present position, so that the controller does not time out.
            self._number = message.header.seqno
            self._answer(self._joints(message.feedBack))
            message = self._next(deadline)
        measured, planned = self._joints(message.feedBack), self._joints(message.planned)
        # Messages with another number of joints are not of this arm.
        assert measured is not None
        self._begun = self._number = message.header.seqno
        self._clock, self._paced = message.header.tm, message.header.seqno
        self._at_rest(measured if planned is None else planned, measured)
        return self._state(message)

    def _stands_now(self) -> Array | None:
        with suppress(EgmError):
            return self._joints(self._next(Deadline.within(0.0)).feedBack)
        return None

    def _handed_over(self, q_c: Array) -> None:
        self._answer(self._with_ahead(q_c)[0])

    def _received(self) -> RobotState:
        """See ``LinkedRobot.receive``: waits for the next message.

        Raises EgmError for silence, an arm that the controller has stopped, more missed than can be bridged.
        """
        deadline, late = Deadline.within(self._timeout), 0
        while True:
            message = self._awaited(deadline, self._read, lambda q, ahead: self._answer(q))
            message = self._next(deadline) if message is None else message
            since = cycles_since(message.header.seqno, self._number)
            if since > self._stood_in:
                break
            self.counts.repeated += since == 0
            self.counts.outdated += since < 0
            if since > 0:
                self._came_late(since)
                late += 1
        if (reason := self._stopped(message)) is not None:
            raise EgmError(f"the controller has stopped the arm: {reason}")
        self._bridged(since, late, self._stood_in)
        self._came()
        self._number = message.header.seqno
        self._check_pace(message.header.tm)
        return self._state(message)

    def close(self) -> None:
        """Stops listening; the controller ends its motion after its communication timeout."""
        self._socket.close()
        self._peer = None

    def _check_pace(self, tm: int) -> None:
        """Raises EgmError where the controller's time stamps [ms] show another cycle than expected."""
        count = (self._number - self._paced) % 2**32
        if count < _PACE:
            return
        pace = 1e-3 * ((tm - self._clock) % 2**32) / count
        self._clock, self._paced = tm, self._number
        # Stamps are rounded to milliseconds, and some controllers send none.
        if pace > 0.0 and abs(pace - self.t_ipo) * count > 2e-3 + 0.1 * self.t_ipo * count:
            raise EgmError(f"the controller sends every {1e3 * pace:.3g} ms, {1e3 * self.t_ipo:g} ms are expected; "
                           "--cycle says which")

    def _answer(self, q: Array | None) -> None:
        """Sends joint angles ``(n,)`` [rad] as the controller's new reference."""
        if q is None or self._peer is None:
            return
        sensor, angles = self._library.EgmSensor(), np.degrees(q).tolist()
        self._answers = (self._answers + 1) % 2**32
        sensor.header.seqno, sensor.header.tm = self._answers, round(1e3 * time.monotonic()) % 2**32
        sensor.header.mtype = self._library.EgmHeader.MSGTYPE_CORRECTION
        sensor.planned.joints.joints.extend(angles[:_OWN])
        if self.robot.n > _OWN:
            sensor.planned.externalJoints.joints.extend(angles[_OWN:])
        try:
            self._socket.sendto(sensor.SerializeToString(), self._peer)
        except OSError as error:
            raise EgmError(f"the system cannot send to {self._peer[0]} ({error})") from error

    def _next(self, deadline: Deadline) -> Any:
        """The newest message of the controller; raises EgmError for silence."""
        if (message := self._read(deadline)) is None:
            raise EgmError("no message of a controller; check the UDPUC device's remote address and port, that EGM "
                           "is active in its program, and the network")
        return message

    def _read(self, deadline: Deadline) -> Any:
        """The newest message that is there; None where none comes by the deadline."""
        self._newest = None
        try:
            read_waiting(self._socket, deadline, self._taken)
        except OSError as error:
            raise EgmError(f"the system does not permit reading the port any more ({error})") from error
        return self._newest

    def _taken(self, packet: bytes, sender: Any) -> bool:
        if self._peer not in (None, sender):
            self.counts.foreign += 1
            return False
        message = self._decoded(packet)
        if message is None:
            self.counts.refused += 1
            return False
        if self._newest is not None and cycles_since(message.header.seqno, self._newest.header.seqno) < 0:
            self.counts.outdated += 1
            return False
        self._peer, self._newest, self.arrived = sender, message, time.perf_counter()
        return True

    def _decoded(self, packet: bytes) -> Any:
        """A state of the arm; None for another message, another number of joints, or angles that cannot be."""
        message = self._library.EgmRobot()
        try:
            message.ParseFromString(packet)
        except Exception:  # the library's own DecodeError, whose module differs between versions
            return None
        joints = self._joints(message.feedBack)
        return message if joints is not None and (np.abs(np.degrees(joints)) < _LARGEST).all() else None

    def _joints(self, part: Any) -> Array | None:
        """Joint angles ``(n,)`` [rad] of feedback or plan; None where there are others than the arm's."""
        angles = np.array([*part.joints.joints, *list(part.externalJoints.joints)[: self.robot.n - _OWN]])
        return np.radians(angles) if angles.shape == (self.robot.n,) else None

    def _stopped(self, message: Any) -> str | None:
        """Why the arm is not given to this computer; None while it is."""
        if message.HasField("motorState") and message.motorState.state == message.motorState.MOTORS_OFF:
            return "the motors are off"
        if message.HasField("rapidExecState") and message.rapidExecState.state == message.rapidExecState.RAPID_STOPPED:
            return "the controller's program does not run"
        if message.HasField("mciState") and message.mciState.state != message.mciState.MCI_RUNNING:
            error = message.mciState.state == message.mciState.MCI_ERROR
            return "EGM reports an error" if error else "EGM does not move the arm (EGMRunJoint)"
        return None

    def _state(self, message: Any) -> RobotState:
        """EGM reports no torques."""
        measured, planned = self._joints(message.feedBack), self._joints(message.planned)
        assert measured is not None
        nothing = np.full(self.robot.n, np.nan)
        force = list(message.measuredForce.force) if message.HasField("measuredForce") else []
        wrench = force if len(force) == len(_WRENCH) else [float("nan")] * len(_WRENCH)
        return RobotState(((self._number - self._begun) % 2**32) * self.t_ipo, self._looked_at(measured), nothing, {
            "q_set": nothing if planned is None else planned,
            "utilization": float(message.utilizationRate) if message.HasField("utilizationRate") else float("nan"),
            **dict(zip(_WRENCH, wrench, strict=True))})


def opened(address: Address, robot: Robot, settings: LinkSettings) -> EgmRobot:
    """Listens on ``egm://host:port?waits=0`` of this computer for a controller; raises InputError where it cannot.

    Args:
        address, robot, settings: see ``ideal_robot.interfaces``.
    """
    address.knows("waits")
    # Without a host it listens on every address of this computer, as the controller is configured with one of them.
    host, port = address.at(PORT, "0.0.0.0")
    link = EgmRobot(robot, host=host, port=port, **settings.given())
    link.clocked = not address.number("waits", 0, 0, 1)
    return link
