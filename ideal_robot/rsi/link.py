"""Packets from one controller and answers to it: the socket, who the controller is, and what does not count."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass

from ideal_robot.errors import InputError
from ideal_robot.rsi.message import MAX_PACKET, RobMessage, parse_rob
from ideal_robot.rsi.rsi_error import PacketError, RsiError

_IPOC_RANGE = 2**32
"""Where a 32-bit time stamp starts anew."""


@dataclass
class LinkCounts:
    """What happened on the link.

    Attributes:
        cycles: packets that were a cycle of their own.
        lost: cycles whose packet never came, or was found when a newer one was there already.
        repeated: packets that came again and got the same answer again.
        outdated: packets of a cycle already past; not answered.
        refused: packets that are no message of a controller; not answered.
        foreign: packets from another sender; not answered.
        late: answers the controller counted as late.
        last_refused: why the last refused packet was refused.
    """

    cycles: int = 0
    lost: int = 0
    repeated: int = 0
    outdated: int = 0
    refused: int = 0
    foreign: int = 0
    late: int = 0
    last_refused: str = ""


def passed(before: RobMessage, after: RobMessage) -> int:
    """Time from one message to another by the controller's time stamps [ms]."""
    time_between = after.ipoc - before.ipoc
    return time_between + _IPOC_RANGE if time_between < -_IPOC_RANGE // 2 else time_between


class PacketLink:
    """A UDP socket on which one controller is listened to: the sender of the first sound packet.

    Args:
        host, port: where to listen; port 0 for any free one.
        n: number of axes.

    Raises:
        InputError: an address that cannot be listened on.

    Attributes:
        counts: what happened.
        arrived: when the last sound packet was read, by ``time.perf_counter`` [s].
    """

    def __init__(self, host: str, port: int, n: int) -> None:
        self.counts, self.arrived = LinkCounts(), 0.0
        self._n = n
        self._peer: tuple[str, int] | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise InputError(f"cannot listen there ({error})", field="host:port", value=f"{host}:{port}") from error

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens: host and port."""
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def next(self, end: float, patience: float) -> RobMessage:
        """The next message before ``end`` by ``time.perf_counter``, ``patience`` [s] after the last one that counted.

        Raises:
            RsiError: none came.
        """
        while (left := end - time.perf_counter()) > 0:
            self._socket.settimeout(left)
            try:
                message = self._read()
            except TimeoutError:
                break
            if message is not None:
                return message
        refused = f"; the last of {self.counts.refused} refused packets: {self.counts.last_refused}"
        raise RsiError(f"no packet from the controller within {patience:.3g} s{refused if self.counts.refused else ''}")

    def newest(self, message: RobMessage) -> RobMessage:
        """The newest of ``message`` and those that wait: whoever answers the oldest of a queue is late for ever."""
        self._socket.settimeout(0.0)
        while True:
            try:
                other = self._read()
            except BlockingIOError:
                return message
            if other is not None and passed(message, other) > 0:
                message = other

    def send(self, answer: bytes) -> None:
        """Sends to the controller, if there is one."""
        if self._peer is not None:
            self._socket.sendto(answer, self._peer)

    def close(self) -> None:
        """Stops listening."""
        self._socket.close()

    def _read(self) -> RobMessage | None:
        """The next packet, None where it counts for nothing.

        Raises:
            TimeoutError, BlockingIOError: no packet, as the socket's timeout has it.
        """
        try:
            packet, sender = self._socket.recvfrom(MAX_PACKET + 1)
        except ConnectionError:
            # Some systems report here that an earlier answer found no one; the silence will show it.
            return None
        arrived = time.perf_counter()
        if self._peer is not None and sender != self._peer:
            self.counts.foreign += 1
            return None
        try:
            message = parse_rob(packet, self._n)
        except PacketError as error:
            self.counts.refused += 1
            self.counts.last_refused = str(error)
            return None
        self._peer, self.arrived = sender, arrived
        return message
