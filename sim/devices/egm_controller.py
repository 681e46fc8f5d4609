"""The controller's side of ABB's EGM around a simulated arm: for tests, and to try a program without a robot.

Written from ABB's application manual alone: joint position guidance, messages of protobuf's wire format, without the
library that packs and unpacks them on the other side.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from sim.arm.arm import SimulatedArm
from sim.devices.datagrams import sent_when_open

# Protobuf's wire format: fields of a number and a kind, 0 a number of variable length, 1 eight bytes, 2 with a length.

Field = tuple[int, int | float | bytes]
"""Number of a field and its value."""


def packed(fields: list[Field]) -> bytes:
    """Encodes a message from its fields: whole numbers, floats and nested messages.

    >>> packed([(1, 300), (2, packed([(1, 1)]))]).hex()
    '08ac0212020801'
    """
    parts = []
    for number, value in fields:
        if isinstance(value, bytes):
            parts.append(_varint(number << 3 | 2) + _varint(len(value)) + value)
        elif isinstance(value, float):
            parts.append(_varint(number << 3 | 1) + struct.pack("<d", value))
        else:
            parts.append(_varint(number << 3) + _varint(value))
    return b"".join(parts)


def unpacked(message: bytes) -> Iterator[Field]:
    """Decodes the fields of a message one by one; raises ValueError for a malformed one."""
    at = 0
    while at < len(message):
        key, at = _read_varint(message, at)
        kind, value = key & 7, 0
        if kind == 0:
            value, at = _read_varint(message, at)
            yield key >> 3, value
        elif kind in (1, 5):
            size = 8 if kind == 1 else 4
            if at + size > len(message):
                raise ValueError("a number is cut off")
            yield key >> 3, struct.unpack("<d" if kind == 1 else "<f", message[at : at + size])[0]
            at += size
        elif kind == 2:
            size, at = _read_varint(message, at)
            if at + size > len(message):
                raise ValueError("a message is cut off")
            yield key >> 3, message[at : at + size]
            at += size
        else:
            raise ValueError(f"no kind of field: {kind}")


def _varint(value: int) -> bytes:
    parts = bytearray()
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    return bytes([*parts, value])


def _read_varint(message: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(message):
            break
        byte, at = message[at], at + 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value, at
    raise ValueError("a number has no end")


# Messages: EgmRobot to the sensor, EgmSensor from it.

_HEADER, _FEEDBACK, _PLANNED, _MOTORS, _MCI, _CONVERGED, _RAPID, _FORCE, _UTILIZATION = 1, 2, 3, 4, 5, 6, 8, 9, 10
_DATA, _CORRECTION = 2, 3
"""Kinds of messages in the header: from the controller, and to it."""
ON, OFF = 1, 2
"""Of the motors."""
MCI_ERROR, MCI_STOPPED, MCI_RUNNING = 1, 2, 3
RAPID_STOPPED, RAPID_RUNNING = 1, 2


def robot_message(number: int, ms: int, measured: Array, planned: Array, *, force: Array | None = None,
                  motors: int = ON, mci: int = MCI_RUNNING, rapid: int = RAPID_RUNNING) -> bytes:
    """Encodes the controller's message of a cycle.

    Args:
        number, ms: of the message, and the controller's time [ms].
        measured, planned: joint angles and their references ``(n,)`` [deg].
        force: wrench of a force sensor ``(6,)`` [N, N m]; None without one.
        motors, mci, rapid: states of motors, EGM and the program.
    """
    def joints(angles: Array) -> bytes:
        own, external = ([(1, float(angle)) for angle in part] for part in (angles[:6], angles[6:]))
        clock = packed([(1, ms // 1000), (2, ms % 1000 * 1000)])
        return packed([(1, packed([*own])), *([(3, packed([*external]))] if external else []), (4, clock)])

    fields: list[Field] = [(_HEADER, packed([(1, number), (2, ms), (3, _DATA)])), (_FEEDBACK, joints(measured)),
                           (_PLANNED, joints(planned)), (_MOTORS, packed([(1, motors)])), (_MCI, packed([(1, mci)])),
                           (_CONVERGED, 0), (_RAPID, packed([(1, rapid)]))]
    if force is not None:
        fields.append((_FORCE, packed([(1, 1), *((2, float(value)) for value in force)])))
    return packed([*fields, (_UTILIZATION, 10.0)])


def sensor_joints(message: bytes) -> Array | None:
    """The reference joints of an answer ``(n,)`` [deg]; None where it has none, or is malformed."""
    angles: list[float] = []
    try:
        fields = dict(unpacked(message))
        header = dict(unpacked(_bytes(fields[1])))
        if header.get(3) != _CORRECTION:
            return None
        for number, value in unpacked(_bytes(fields[2])):
            if number in (1, 3):
                angles += _doubles(_bytes(value))
    except (KeyError, TypeError, ValueError):
        return None
    return np.array(angles) if angles and np.isfinite(angles).all() else None


def _bytes(value: int | float | bytes) -> bytes:
    if not isinstance(value, bytes):
        raise TypeError("expected a field with bytes, as of an embedded message")
    return value


def _doubles(message: bytes) -> list[float]:
    """Repeated doubles, each with its key or all together."""
    values: list[float] = []
    for number, value in unpacked(message):
        if number == 1 and isinstance(value, bytes):
            values += np.frombuffer(value, dtype="<f8").tolist()
        elif number == 1:
            values.append(float(value))
    return values


Disturbance = Callable[[int, bytes], list[bytes]]
"""What is sent in place of the message of a cycle: called with its number and the message."""


@dataclass
class EgmRun:
    """What a simulated controller measured and received in a run.

    Attributes:
        commands: references of every cycle ``(n,)`` [rad].
        answered: whether each had an answer.
        ended: why it ended.
    """

    commands: list[Array] = field(default_factory=list)
    answered: list[bool] = field(default_factory=list)
    ended: str = ""


class EgmController:
    """Sends its state every cycle and follows the joints of each answer; without an answer it keeps the last ones.

    Args:
        arm: the arm; its posture now is where EGM begins.
        address: where the program listens.
        timeout: how long an answer is waited for [s], the simulated time standing still meanwhile; None for as long as
            a cycle takes, as a real controller does.
        patience: cycles in a row without an answer after which EGM ends (``CommTimeout``); fifty times as many before
            the first answer.
        disturbance: see ``Disturbance``; None sends every message as it is.

    Attributes:
        motors, mci, rapid: states that are reported; a test changes them.
        force: reported wrench ``(6,)``; None for none.
    """

    def __init__(self, arm: SimulatedArm, address: tuple[str, int], *, timeout: float | None = 0.3, patience: int = 25,
                 disturbance: Disturbance | None = None) -> None:
        self.arm, self.address, self.timeout, self.patience = arm, address, timeout, patience
        self.disturbance = disturbance
        self.motors, self.mci, self.rapid = ON, MCI_RUNNING, RAPID_RUNNING
        self.force: Array | None = None
        self._stopped = threading.Event()

    def stop(self) -> None:
        """Ends ``run`` from another thread."""
        self._stopped.set()

    def message(self, number: int, state: RobotState, planned: Array) -> bytes:
        """Encodes the message of a cycle from the state and the planned joints.

        Args:
            number: of the cycle.
            state: of the arm.
            planned: reference in force ``(n,)`` [rad].
        """
        return robot_message(number, round(1e3 * self.arm.t_ipo * number), np.degrees(state.q), np.degrees(planned),
                             force=self.force, motors=self.motors, mci=self.mci, rapid=self.rapid)

    def answer(self, link: socket.socket, end: float) -> Array | None:
        """The reference of the newest answer ``(n,)`` [rad] received by ``end`` [s]; None without one.

        Args:
            link: socket that the message went through.
            end: until when it is waited for, by ``time.perf_counter``.
        """
        newest: Array | None = None
        while not self._stopped.is_set():
            remaining = end - time.perf_counter()
            link.settimeout(0.0 if newest is not None else min(max(remaining, 0.0), 0.05))
            try:
                angles = sensor_joints(link.recv(65536))
            except (TimeoutError, BlockingIOError):
                if newest is not None or remaining <= 0:
                    return newest
                continue
            except ConnectionError:
                continue
            if angles is not None and angles.shape == (self.arm.robot.n,):
                newest = np.radians(angles)
        return newest

    def run(self, cycles: int = 1_000_000) -> EgmRun:
        """Simulates up to ``cycles`` cycles, fewer if answers stop coming or ``stop`` is called."""
        run, silent = EgmRun(ended="all cycles played"), 0
        reference = self.arm.truth.q_m.copy()
        state = RobotState(self.arm.t, reference, np.zeros(self.arm.robot.n))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.connect(self.address)
            begin = time.perf_counter()
            for k in range(cycles):
                message = self.message(k, state, reference)
                sent = [message] if self.disturbance is None else self.disturbance(k, message)
                end = time.perf_counter() + (self.arm.t_ipo if self.timeout is None else self.timeout)
                sent_when_open(link, sent, end, self._stopped.is_set)
                # Without ``timeout`` each cycle lasts its real time, and answers to earlier messages may arrive in it.
                wanted = self.answer(link, end) if sent or self.timeout is None else None
                if self._stopped.is_set():
                    run.ended = "stopped"
                    break
                silent = silent + 1 if wanted is None else 0
                if silent >= self.patience * (1 if any(run.answered) else 50):
                    run.ended = f"no answer in {silent} cycles"
                    break
                moves = wanted is not None and self.mci == MCI_RUNNING
                reference = wanted if wanted is not None and moves else reference
                run.answered.append(wanted is not None)
                run.commands.append(reference)
                state = self.arm.cycle(reference)
                if self.timeout is None:
                    time.sleep(max(begin + (k + 1) * self.arm.t_ipo - time.perf_counter(), 0.0))
        return run
