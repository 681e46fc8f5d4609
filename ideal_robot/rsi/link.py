"""The UDP link to one controller: its sockets, the identification of the controller, and rejected packets.

The sender of the first valid packet is the controller. From then on its packets come through a socket connected to it,
so that other packets at the port fill another queue.
"""

from __future__ import annotations

import socket
import struct
import sys
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from ideal_robot.deadline import Deadline
from ideal_robot.errors import BAD_ADDRESS, InputError
from ideal_robot.rsi.message import MAX_PACKET, PacketError, RobMessage, RsiError, RsiFormat, parse_rob

# Arrival times of packets by the system, so that a delay of this program does not make them look late.

_TIMESTAMP = 35
"""``SO_TIMESTAMPNS`` of Linux, which Python does not name."""
_STAMPED = sys.platform.startswith("linux")


def stamp_arrivals(link: socket.socket) -> None:
    """Makes the system record the arrival time of each packet, where it can."""
    if _STAMPED:
        link.setsockopt(socket.SOL_SOCKET, _TIMESTAMP, 1)


def received(link: socket.socket, size: int = 4096) -> tuple[bytes, Any, float]:
    """A packet, its sender, and its arrival time by ``time.perf_counter`` [s]; raises as ``recvfrom`` does.

    Without ``stamp_arrivals`` the time of reading is used. A packet has at most ``size`` bytes.
    """
    if not _STAMPED:
        return *link.recvfrom(size), time.perf_counter()
    packet, extra, _, sender = link.recvmsg(size, 64)
    now, wall = time.perf_counter(), time.time()
    for level, kind, data in extra:
        if (level, kind) == (socket.SOL_SOCKET, _TIMESTAMP):
            seconds, nanoseconds = struct.unpack("@ll", data[: struct.calcsize("@ll")])
            # A system clock that was reset must not give an arrival before the packet was sent, or in the future.
            return packet, sender, now - min(max(wall - (seconds + 1e-9 * nanoseconds), 0.0), 1.0)
    return packet, sender, now


# Increase of a controller's time stamps, from its first packets: the cycle in ms, one, or none.

_RANGE = 2**32
"""Where a 32-bit time stamp starts anew."""
_STILL = 5
"""Packets in a row with the same stamp, right at the start, after which the stamp counts as never rising."""
_SLOW_START = 3
"""Steps within which the expected rise has to show."""


class Stamps:
    """Cycles between packets by their time stamps.

    Args:
        step: interpolation cycle [ms].

    Attributes:
        rise: increase of the stamp per cycle, 0 if it never rises; None until it is known.
        in_step: whether two packets in a row have come.
    """

    def __init__(self, step: int) -> None:
        self.step = step
        self.rise: int | None = None
        self.in_step = False
        self._same = self._steps = 0

    def cycles(self, before: int, after: int) -> int:
        """Cycles from one stamp to another: 0 for the same packet again, negative for an older one.

        Raises RsiError where the stamp rises neither by the cycle nor by one.
        """
        since = (after - before + _RANGE // 2) % _RANGE - _RANGE // 2
        if self.rise == 0:
            return 1
        if since <= 0:
            return self._never(since)
        if self.rise is None:
            self.rise = self._found(since)
        if since % self.rise:
            raise self._wrong(since)
        cycles = since // self.rise
        self.in_step = self.in_step or cycles == 1
        self._steps += 1
        # One large step is a loss, three at the start are another cycle time.
        if not self.in_step and self._steps >= _SLOW_START:
            raise self._wrong(since)
        return cycles

    def newer(self, before: int, after: int) -> bool:
        """Whether the second of two waiting packets is newer than the first."""
        return self.rise == 0 or (after - before + _RANGE // 2) % _RANGE > _RANGE // 2

    def described(self) -> str:
        """Increase of the controller's time stamps, in words."""
        if self.rise is None:
            return "not known"
        return {0: "do not rise: repeated and late packets cannot be recognised",
                self.step: f"rise by {self.step} ms a cycle"
                }.get(self.rise, "rise by 1 a packet: the cycle cannot be checked by them")

    def _never(self, since: int) -> int:
        self._same = self._same + 1 if since == 0 and self.rise is None else 0
        if self._same >= _STILL:
            self.rise, self.in_step = 0, True
            return 1
        return min(since, 0)

    def _found(self, since: int) -> int:
        if since % self.step == 0:
            return self.step
        # No controller has a cycle of 2 or 3 ms: the stamp counts packets, and one or two were lost.
        if since <= 3:
            return 1
        raise self._wrong(since)

    def _wrong(self, since: int) -> RsiError:
        return RsiError(f"the controller's time stamp rose by {since} in a cycle; {self.step} (ms) or 1 (a packet) are "
                        "expected; tell the controller's cycle with --cycle, or t_ipo in the robot's data")


_QUEUE = 64
"""Waiting packets that are looked through in one cycle: who floods the port must not hold up the answer."""
_BEFORE = 100_000
"""Packets that may have queued up before the controller was known."""
_READ = 8
"""Packets of other senders that are read in one cycle, to see whether they are a second controller's."""


@dataclass
class LinkCounts:
    """Statistics of the link.

    Attributes:
        cycles: packets that were a cycle of their own.
        lost: cycles whose packet never came, or only after a newer one.
        repeated: packets that came again and got the same answer again.
        outdated: packets of a cycle already past; not answered.
        refused: packets that are no message of a controller, or with a time stamp that cannot be; not answered.
        foreign: packets from another sender, or another port; not answered. In a flood the system drops most uncounted.
        second: packets from another sender that are valid messages of a controller.
        ignored: optional elements that could not be used.
        implausible: implausible measured positions, which are treated as missing.
        late: answers that the controller reported as late.
        resynchronised: number of times that the position after relative corrections was read from the measurement at
            rest.
        unsent: answers the system did not take.
        last_refused: why the last refused packet was refused.
        last_ignored: which optional elements were ignored last.
        last_foreign: who sent the last packet from another sender.
    """

    cycles: int = 0
    lost: int = 0
    repeated: int = 0
    outdated: int = 0
    refused: int = 0
    foreign: int = 0
    second: int = 0
    ignored: int = 0
    implausible: int = 0
    late: int = 0
    resynchronised: int = 0
    unsent: int = 0
    last_refused: str = ""
    last_ignored: str = ""
    last_foreign: str = ""

    @property
    def others(self) -> str:
        """Refused and foreign packets as the end of a message; empty where none came."""
        text = f"; the last of {self.refused} refused packets: {self.last_refused}" if self.refused else ""
        if not self.foreign:
            return text
        second = f" ({self.second} sound: a second controller; name yours with --controller)" if self.second else ""
        return f"{text}; {self.foreign} packets from other senders, the last from {self.last_foreign}{second}"

    def refuse(self, reason: str) -> None:
        """Counts a packet that is not answered."""
        self.refused, self.last_refused = self.refused + 1, reason


class PacketLink:
    """A UDP socket for one controller, the sender of the first valid packet.

    Args:
        host, port: address to listen at; port 0 for any free one.
        n: number of axes.
        controller: the only accepted address; None for the first sender.
        form: further required elements of a packet, see ``parse_rob``.

    Raises:
        InputError: an address that cannot be listened on.

    Attributes:
        counts: statistics of the link.
        arrived: when the last sound packet came, by ``time.perf_counter`` [s].
    """

    def __init__(self, host: str, port: int, n: int, controller: str | None = None,
                 form: RsiFormat | None = None) -> None:
        self.counts, self.arrived = LinkCounts(), 0.0
        self._n, self._controller, self._form = n, controller, form
        self._peer: tuple[str, int] | None = None
        self._socket = self._door = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._waiting: deque[tuple[bytes, Any, float]] = deque(maxlen=_QUEUE)
        stamp_arrivals(self._socket)
        try:
            self._socket.bind((host, port))
        except BAD_ADDRESS as error:
            self._socket.close()
            raise InputError(f"cannot listen there ({error})", field="host:port", value=f"{host}:{port}") from error

    @property
    def address(self) -> tuple[str, int]:
        """Host and port on which it listens."""
        host, port = self._socket.getsockname()
        return str(host), int(port)

    @property
    def controller(self) -> str:
        """Address of the controller, once it is known."""
        return "" if self._peer is None else "{}:{}".format(*self._peer)

    def next(self, deadline: Deadline) -> RobMessage:
        """The next message before the deadline; raises RsiError where none came, or the system closed the port."""
        while (seconds := deadline.left) > 0.0:
            self._socket.settimeout(seconds)
            try:
                message = self._read()
            except TimeoutError:
                break
            if message is not None:
                return message
        self._look_at_the_door(_QUEUE)
        known = "" if self._peer is None else f", which is {self.controller}"
        raise RsiError(f"no packet from the controller within {deadline.seconds:.3g} s{known}{self.counts.others}")

    def newest(self, message: RobMessage, stamps: Stamps, most: int = _QUEUE) -> tuple[RobMessage, int]:
        """The newest of ``message`` and the waiting ones, and the number that was skipped.

        Answering the oldest of a queue would always be late. Raises RsiError where the system closed the port.

        Args:
            message, stamps: a message that came before them, and which of two is newer.
            most: largest number of packets to read.
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
        """Sends to the controller, if there is one; a packet that the system refuses is a missing answer."""
        if self._peer is not None:
            try:
                self._sent(answer, self._peer)
            except OSError:
                self.counts.unsent += 1
        self._look_at_the_door(_QUEUE)

    def close(self) -> None:
        """Stops listening."""
        self._socket.close()
        self._door.close()

    def _sent(self, answer: bytes, peer: tuple[str, int]) -> None:
        if self._socket is self._door:
            self._socket.sendto(answer, peer)
            return
        try:
            self._socket.send(answer)
        except ConnectionRefusedError:
            # An error here is about an earlier answer; this one has not been sent yet and is sent again.
            self._socket.send(answer)

    def _read(self) -> RobMessage | None:
        """The next packet; None for one that is not used.

        Raises TimeoutError or BlockingIOError where there is none, as the socket's timeout has it, RsiError where the
        system closed the port.
        """
        try:
            packet, sender, arrived = (self._waiting.popleft() if self._waiting
                                       else received(self._socket, MAX_PACKET + 1))
        except ConnectionError:
            # Some systems report here that an earlier answer had no receiver; a silence will show it.
            return None
        except (TimeoutError, BlockingIOError):
            raise
        except OSError as error:
            raise RsiError(f"the system does not permit reading the port any more ({error})") from error
        if (sender != self._peer) if self._peer is not None else (self._controller not in (None, sender[0])):
            self._stranger(packet, sender)
            return None
        try:
            message = parse_rob(packet, self._n, self._form)
        except PacketError as error:
            self.counts.refuse(str(error))
            return None
        if message.ignored:
            self.counts.ignored += len(message.ignored)
            self.counts.last_ignored = " ".join(message.ignored)
        if self._peer is None:
            self._begin_with(sender)
        self.arrived = arrived
        return message

    def _begin_with(self, peer: tuple[str, int]) -> None:
        """Keeps the packets of the controller apart from all others, where the system can."""
        self._peer, (host, port) = peer, self.address
        if not sys.platform.startswith("linux") or host == "0.0.0.0":
            # On a socket for every address the local address of a packet is unknown, so no connected socket is made.
            return
        wire = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            # Only between these two lines may the port have a second owner, also of this program.
            for owner in (self._door, wire):
                owner.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            wire.bind((host, port))
            wire.connect(peer)
        except OSError:
            wire.close()
            return
        finally:
            self._door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        wire.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 0)
        stamp_arrivals(wire)
        wire.settimeout(self._socket.gettimeout())
        self._socket = wire
        self._door.settimeout(0.0)
        self._look_at_the_door(_BEFORE)

    def _look_at_the_door(self, most: int) -> None:
        """Counts up to so many packets of other senders; those of the controller from before wait to be read."""
        for i in range(most if self._socket is not self._door else 0):
            try:
                packet = received(self._door, MAX_PACKET + 1)
            except OSError:
                return
            if packet[1] == self._peer:
                self._waiting.append(packet)
            else:
                self._stranger(packet[0], packet[1], i < _READ)

    def _stranger(self, packet: bytes, sender: tuple[str, int], read: bool = True) -> None:
        self.counts.foreign, self.counts.last_foreign = self.counts.foreign + 1, "{}:{}".format(*sender)
        if not read:
            return
        try:
            parse_rob(packet, self._n, self._form)
        except PacketError:
            return
        self.counts.second += 1
