"""An arm behind FANUC's Stream Motion, as one more implementation of ``RobotInterface``.

``airo-fanuc`` packs and unpacks the packets and speaks RMI, by which the controller's program is started. The
controller is the clock: a status comes every interpolation cycle, the command goes back with its number. Time is that
number, not the arrival, which would move commands by milliseconds against the controller's ticks.
"""

from __future__ import annotations

import socket
import struct
import time
from contextlib import suppress
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.interfaces import LinkSettings
from ideal_robot.robots.address import Address
from ideal_robot.robots.interface import LinkedRobot, RobotState, cycles_since, read_waiting
from ideal_robot.robots.robot import Robot

PORT, RMI_PORT = 60015, 16001
"""Of Stream Motion (UDP) and of RMI (TCP) on the controller."""
_AXES, _WIRE_AXES = 6, 9
_STOP, _CAPABILITY, _START, _COMMAND, _STATUS, _STATUS_WITH_FORCE = 2, 7, 200, 201, 202, 204
_HEADER, _ASKED = struct.Struct(">II"), struct.Struct(">IIIIIII")
_VERSION = 3
"""Version that is asked for first; the controller says which it has."""
_PROGRAM = "STREAM_MOTN"
"""The controller's program that gives motion to the stream."""
_LARGEST = 1e4
"""No angle is as large [deg]."""
_MOVES, _IN_ERROR, _TEACH, _E_STOP = 0x1, 0x1, 0x2, 0x4
_AGAIN = 0.2
"""Time between two attempts [s]."""
_FORCE = ("force_x", "force_y", "force_z", "moment_x", "moment_y", "moment_z")


class StreamMotionError(IdealRobotError):
    """The controller is not reachable, refuses to be commanded, or has stopped the arm."""


class StreamMotionRobot(LinkedRobot):
    """A ``RobotInterface`` to a FANUC arm with the options Stream Motion and Remote Motion Interface.

    Args:
        robot: six joints, limits, and the controller's cycle.
        host: address of the controller.
        port, rmi_port: of Stream Motion and of RMI.
        j23: coupling of joint 2 into the controller's joint 3: ``q_3 = J3 + j23 · J2``.
        timeout: silence of the controller after which the link is taken as broken [s].
        bridge: how long packets may be lost in a row [s].
        answers_within: time in which the arm's loop answers a command, for the watch over following [s].

    Raises:
        InputError: an arm without six joints.
    """

    lost_link = StreamMotionError

    def __init__(self, robot: Robot, host: str, *, port: int = PORT, rmi_port: int = RMI_PORT, j23: float = 0.0,
                 timeout: float = 1.0, bridge: float = 0.1, answers_within: float = 0.8) -> None:
        if robot.n != _AXES:
            raise InputError(f"Stream Motion moves arms with {_AXES} joints", field="robot",
                             value=f"{robot.name}: {robot.n}")
        super().__init__(robot, bridge, answers_within)
        self.horizon = self.max_lost
        self.host, self.port, self.rmi_port = host, port, rmi_port
        self._timeout, self._wire = timeout, np.eye(_AXES)
        self._wire[2, 1] = j23
        self._socket: socket.socket | None = None
        self._rmi: Any = None
        self._version, self._answered = _VERSION, False

    def connect(self, patience: float = 60.0) -> RobotState:
        """Starts the controller's program and the stream; commands have to follow from then on.

        Returns the state at rest, ``t = 0``. ``commanded`` is then the arm's position.

        Raises:
            StreamMotionError: no controller within ``patience`` [s], another cycle, an arm that cannot be commanded
                now.
        """
        from airo_fanuc import _core
        from airo_fanuc.exceptions import FanucError, RmiError
        from airo_fanuc.rmi_client import RmiClient

        self._core, deadline = _core, Deadline.within(patience)
        self._errors = (FanucError, RmiError, OSError)
        self._rmi = RmiClient(self.host, self.rmi_port, connect_timeout=min(5.0, patience))
        while True:
            try:
                self._rmi.start()
                self._rmi.initialize()
                break
            except self._errors as error:
                if deadline.left < _AGAIN:
                    raise StreamMotionError(f"no controller answers RMI at {self.host}:{self.rmi_port} ({error}); "
                                            "check address, AUTO mode, and that no other program is connected"
                                            ) from error
                time.sleep(_AGAIN)
        self._agree(deadline)
        try:
            self._rmi.program_call(_PROGRAM)
        except self._errors as error:
            raise StreamMotionError(f"the controller does not start {_PROGRAM}: {error}") from error
        self._tell(_HEADER.pack(_START, self._version))
        status = self._next(Deadline.within(self._timeout))
        while not status["status"] & _MOVES:
            self._check(status)
            if deadline.passed:
                raise StreamMotionError(f"the controller's program {_PROGRAM} does not give motion control to the "
                                        "stream")
            status = self._next(Deadline.within(self._timeout))
        self._begun = self._number = int(status["sequence_no"])
        stands = self._angles(status)
        self._at_rest(stands, stands)
        return self._state(status)

    def send(self, q_c: Array) -> None:
        """First half of ``cycle``: sends a command; as a status is answered once, a second one waits for the next."""
        if self._answered:
            self.receive()
        super().send(q_c)

    def _stands_now(self) -> Array | None:
        with suppress(StreamMotionError):
            status = self._next(Deadline.within(0.0))
            # Each number is answered once, and only the newest one.
            self._number = int(status["sequence_no"])
            return self._angles(status)
        return None

    def _handed_over(self, q_c: Array) -> None:
        self._command(self._with_ahead(q_c)[0], last=False)
        self._answered = True

    def _received(self) -> RobotState:
        """See ``LinkedRobot.receive``: waits for the next status.

        Raises StreamMotionError for silence, an arm that the controller has stopped, more missed than can be bridged.
        """
        deadline = Deadline.within(self._timeout)
        late = 0
        while True:
            status = self._awaited(deadline, self._read, lambda q, ahead: self._command(q, False, ahead))
            status = self._next(deadline) if status is None else status
            since = cycles_since(int(status["sequence_no"]), self._number)
            if since > self._stood_in:
                break
            self.counts.repeated += since == 0
            self.counts.outdated += since < 0
            if since > 0:
                self._came_late(since)
                late += 1
        self._check(status)
        if not status["status"] & _MOVES:
            raise StreamMotionError("the controller has ended motion control by the stream" + self._alarm())
        self._bridged(since, late, self._stood_in)
        self._came()
        self._number, self._answered = int(status["sequence_no"]), False
        return self._state(status)

    def close(self) -> None:
        """Ends the stream with the last command, and closes the connection."""
        if self._socket is not None:
            with suppress(OSError, StreamMotionError):
                if np.isfinite(self.commanded).all():
                    # Each number is answered once, so the last command needs a status without an answer.
                    if self._answered:
                        self._number = int(self._next(Deadline.within(_AGAIN))["sequence_no"])
                    self._command(self.commanded, last=True)
            self._tell(_HEADER.pack(_STOP, self._version))
            self._socket.close()
            self._socket = None
        if self._rmi is not None:
            with suppress(*self._errors):
                self._rmi.stop()
            self._rmi = None

    def _agree(self, deadline: Deadline) -> None:
        """Opens the stream's socket and asks which version and cycle the controller has."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((self.host, self.port))
        self._socket.settimeout(_AGAIN)
        self._tell(_HEADER.pack(_STOP, self._version))
        while True:
            self._tell(_ASKED.pack(_CAPABILITY, self._version, 1, 0, 0, 0, 0))
            try:
                packet = self._socket.recv(2048)
            except OSError as error:
                if deadline.left < _AGAIN:
                    raise StreamMotionError(f"no controller answers Stream Motion at {self.host}:{self.port}; check "
                                            "the option and its port") from error
                continue
            if len(packet) >= _ASKED.size and (answer := _ASKED.unpack_from(packet))[0] == _CAPABILITY:
                break
        cycle, self._version = 1e-3 * answer[3], answer[5]
        if abs(cycle - self.t_ipo) > 1e-6:
            raise StreamMotionError(f"the controller's cycle is {1e3 * cycle:g} ms, {1e3 * self.t_ipo:g} ms are "
                                    f"expected; --cycle {cycle:g}")

    def _tell(self, packet: bytes) -> None:
        if self._socket is not None:
            with suppress(ConnectionRefusedError):  # the controller has gone, which its silence will show
                self._socket.send(packet)

    def _command(self, q: Array, last: bool, ahead: int = 0) -> None:
        """Sends joint angles ``(n,)`` [rad] as the answer to the last status, or to one so many cycles ahead."""
        angles = [*np.degrees(np.linalg.solve(self._wire, q)), *[0.0] * (_WIRE_AXES - _AXES)]
        packet = self._core.encode_command_packet((self._number + ahead) % 2**32, last, 1, angles)
        self._tell(_HEADER.pack(_COMMAND, self._version) + packet[_HEADER.size:])

    def _next(self, deadline: Deadline) -> dict[str, Any]:
        """The newest status that is one; raises StreamMotionError for silence."""
        if (status := self._read(deadline)) is None:
            raise StreamMotionError("the controller is silent; its program has ended, or the network is gone")
        return status

    def _read(self, deadline: Deadline) -> dict[str, Any] | None:
        """The newest status that is there; None where none comes by the deadline."""
        assert self._socket is not None
        return self._newest if read_waiting(self._socket, deadline, self._taken, 2048) else None

    def _taken(self, packet: bytes, sender: Any) -> bool:
        self.arrived, status = time.perf_counter(), self._decoded(packet)
        if status is None:
            self.counts.refused += 1
            return False
        self._newest = status
        return True

    def _decoded(self, packet: bytes) -> dict[str, Any] | None:
        """A status packet, taken apart; None for another one, or angles that cannot be."""
        try:
            kind = _HEADER.unpack_from(packet)[0]
            if kind not in (_STATUS, _STATUS_WITH_FORCE):
                return None
            read = self._core.decode_status_v3 if kind == _STATUS else self._core.decode_status_204
            status: dict[str, Any] = read(packet)
        except (ValueError, struct.error):
            return None
        return status if (np.abs(status["joint_angle"]) < _LARGEST).all() else None

    def _check(self, status: dict[str, Any]) -> None:
        """Raises StreamMotionError where the controller has stopped the arm."""
        bits = int(status["robot_status"])
        reasons = [text for bit, text in ((_E_STOP, "emergency stop"), (_IN_ERROR, "an alarm"),
                                          (_TEACH, "the teach pendant is enabled")) if bits & bit]
        if int(status["contact_stop_status"]):
            reasons.append("contact stop")
        if reasons:
            raise StreamMotionError(f"the controller has stopped the arm: {', '.join(reasons)}{self._alarm()}")

    def _alarm(self) -> str:
        """What the controller's last alarm says, with a colon before it; empty where it says nothing."""
        with suppress(*self._errors):
            texts = ", ".join(text.strip() for text in self._rmi.read_error().messages if text.strip())
            return f": {texts}" if texts else ""
        return ""

    def _angles(self, status: dict[str, Any]) -> Array:
        """Joint angles ``(n,)`` [rad] of a status."""
        return np.asarray(self._wire @ np.radians(status["joint_angle"][:_AXES]))

    def _state(self, status: dict[str, Any]) -> RobotState:
        """Torque is the current in ampere times the drive gain, NaN where the controller reports none."""
        measured = self._looked_at(self._angles(status))
        current = np.array(status["current"][:_AXES])
        current = current if current.any() else np.full(_AXES, np.nan)
        force = [float(status[name]) for name in _FORCE] if int(status["packet_type"]) == _STATUS_WITH_FORCE else (
            [float("nan")] * len(_FORCE))
        ticks = (self._number - self._begun) % 2**32
        return RobotState(ticks * self.t_ipo, measured, current * self.robot.drive_gain, {
            "current": current, "speed_scale": float(status["safety_scale"]),
            **dict(zip(("fx", "fy", "fz", "mx", "my", "mz"), force, strict=True))})


def opened(address: Address, robot: Robot, settings: LinkSettings) -> StreamMotionRobot:
    """The link to the controller at ``fanuc://host:port?rmi=16001&j23=0``, not yet connected; raises InputError.

    Without ``j23`` the arm's data say how joint 3 is counted.

    Args:
        address, robot, settings: see ``ideal_robot.interfaces``.
    """
    address.knows("rmi", "j23", "waits")
    host, port = address.at(PORT)
    link = StreamMotionRobot(robot, host, port=port, rmi_port=int(address.number("rmi", RMI_PORT, 1, 65535)),
                             j23=address.number("j23", -float(robot.counted[2, 1]), -1.0, 1.0), **settings.given())
    link.clocked = not address.number("waits", 0, 0, 1)
    return link
