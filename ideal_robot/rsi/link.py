"""Packets from one controller and answers to it: the socket, who the controller is, and what does not count."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass

from ideal_robot.errors import InputError
from ideal_robot.rsi.arrivals import received, stamp_arrivals
from ideal_robot.rsi.message import MAX_PACKET, RobMessage, parse_rob
from ideal_robot.rsi.rsi_error import PacketError, RsiError
from ideal_robot.rsi.stamps import Stamps

_QUEUE = 64
"""Waiting packets that are looked through in one cycle: who floods the port must not hold up the answer."""


@dataclass
class LinkCounts:
    """What happened on the link.

    Attributes:
        cycles: packets that were a cycle of their own.
        lost: cycles whose packet never came, or was found when a newer one was there already.
        repeated: packets that came again and got the same answer again.
        outdated: packets of a cycle already past; not answered.
        refused: packets that are no message of a controller, or with a time stamp that cannot be; not answered.
        foreign: packets from another sender; not answered.
        ignored: optional elements that could not be used.
        implausible: measured positions that cannot be; they count as missing.
        late: answers the controller counted as late.
        resynchronised: times the measured position at rest told where relative corrections have led.
        unsent: answers the system did not take.
        last_refused: why the last refused packet was refused.
        last_ignored: which optional elements were ignored last.
    """

    cycles: int = 0
    lost: int = 0
    repeated: int = 0
    outdated: int = 0
    refused: int = 0
    foreign: int = 0
    ignored: int = 0
    implausible: int = 0
    late: int = 0
    resynchronised: int = 0
    unsent: int = 0
    last_refused: str = ""
    last_ignored: str = ""

    def refuse(self, reason: str) -> None:
        """Counts a packet that is not answered."""
        self.refused, self.last_refused = self.refused + 1, reason


class PacketLink:
    """A UDP socket on which one controller is listened to: the sender of the first sound packet.

    Args:
        host, port: where to listen; port 0 for any free one.
        n: number of axes.
        controller: the one address whose packets count; None for whoever is first.

    Raises:
        InputError: an address that cannot be listened on.

    Attributes:
        counts: what happened.
        arrived: when the last sound packet came, by ``time.perf_counter`` [s].
    """

    def __init__(self, host: str, port: int, n: int, controller: str | None = None) -> None:
        self.counts, self.arrived = LinkCounts(), 0.0
        self._n, self._controller = n, controller
        self._peer: tuple[str, int] | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        stamp_arrivals(self._socket)
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
            RsiError: none came, or the system closed the port.
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

    def newest(self, message: RobMessage, stamps: Stamps, most: int = _QUEUE) -> tuple[RobMessage, int]:
        """The newest of ``message`` and those that wait, and how many were passed over for it.

        Whoever answers the oldest of a queue is late for ever.

        Args:
            message: a message that came before them.
            stamps: which of two is newer.
            most: packets that are looked through at most.

        Raises:
            RsiError: the system closed the port.
        """
        self._socket.settimeout(0.0)
        passed_over = 0
        for _ in range(most):
            try:
                other = self._read()
            except BlockingIOError:
                break
            if other is None:
                continue
            if stamps.newer(message.ipoc, other.ipoc):
                message, passed_over = other, passed_over + 1
            elif other.ipoc == message.ipoc:
                self.counts.repeated += 1
            else:
                self.counts.outdated += 1
        return message, passed_over

    def send(self, answer: bytes) -> None:
        """Sends to the controller, if there is one; what the system does not take is an answer that is missing."""
        if self._peer is not None:
            try:
                self._socket.sendto(answer, self._peer)
            except OSError:
                self.counts.unsent += 1

    def close(self) -> None:
        """Stops listening."""
        self._socket.close()

    def _read(self) -> RobMessage | None:
        """The next packet, None where it counts for nothing.

        Raises:
            TimeoutError, BlockingIOError: no packet, as the socket's timeout has it.
            RsiError: the system closed the port.
        """
        try:
            packet, sender, arrived = received(self._socket, MAX_PACKET + 1)
        except ConnectionError:
            # Some systems report here that an earlier answer found no one; the silence will show it.
            return None
        except (TimeoutError, BlockingIOError):
            raise
        except OSError as error:
            raise RsiError(f"the system does not let the port be read any more ({error})") from error
        if (sender != self._peer) if self._peer is not None else (self._controller not in (None, sender[0])):
            self.counts.foreign += 1
            return None
        try:
            message = parse_rob(packet, self._n)
        except PacketError as error:
            self.counts.refuse(str(error))
            return None
        if message.ignored:
            self.counts.ignored += len(message.ignored)
            self.counts.last_ignored = " ".join(message.ignored)
        self._peer, self.arrived = sender, arrived
        return message
