"""Force/torque samples, the interface of force sensors, and the deviations that follow from forces ([L] (3))."""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import BAD_ADDRESS, InputError
from ideal_robot.registry import Registry
from sensing.clock_relation import ClockRelation
from sensing.stream import Kind, StreamConnection, host_and_port, options


@dataclass(frozen=True)
class WrenchSample:
    """One reading of a force sensor.

    Attributes:
        t, t_arrival: instants of measurement, and at which it is available [s].
        wrench: force [N] and moment [N m] of the tool on the sensor, in the tool frame about its origin ``(6,)``: what
            the environment does to the tool, plus the tool's own weight, plus bias.
    """

    t: float
    t_arrival: float
    wrench: Array


class ForceSensor(Protocol):
    """A force/torque sensor as a device.

    It samples on its own clock. Each sample carries the *controller's* time of its measurement as well as the device
    knows it; where the sensor's clock drifts, diagnosis finds it (effect ``clock_drift``).
    """

    def arrived(self, t: float) -> list[WrenchSample]:
        """The samples that have arrived by the controller time ``t`` [s], in order of arrival, each once."""
        ...


@dataclass(frozen=True)
class ForceDeviation:
    """How far the tip has to move for the wanted force.

    Attributes:
        value, sigma: along the direction, positive out of the surface, and its standard deviation [m].
        force: component of the contact force along the direction [N].
    """

    value: float
    sigma: float
    force: float


def force_deviation(force: Array, direction: Array, wanted: float, elasticity: float, *, sigma: float,
                    elasticity_error: float = 0.05, normal: Array | None = None) -> ForceDeviation:
    """Δx_a = (F_r − F) / E, [L] (3), along ``direction``.

    The direction points out of the surface; a force that is too small gives a deviation against it, into the surface.
    Raises ``InputError`` for an elasticity that is not positive.

    Args:
        force: of the environment on the tool ``(3,)`` [N].
        direction: unit vector in which the deviation is wanted, the same frame.
        wanted: F_r [N].
        elasticity: E [N/m].
        sigma: standard deviation of the force [N].
        elasticity_error: relative error of E that the standard deviation allows for.
        normal: of the surface, if it is known better than ``direction``; the force along it is used, without friction.
    """
    if not elasticity > 0:
        raise InputError("expected a positive elasticity [N/m]", field="elasticity", value=elasticity)
    along = direction if normal is None else normal
    pressed = float(force @ along)
    deviation = -(wanted - pressed) / elasticity / float(along @ direction)
    return ForceDeviation(deviation, float(np.hypot(sigma / elasticity, elasticity_error * deviation)), pressed)


# Opens force sensors by their addresses, as the command line takes them.

@dataclass(frozen=True)
class Reading:
    """One reading: instant by the sensor's clock [s]; force [N] and moment [N m] ``(6,)`` in the sensor's frame."""

    stamp: float
    wrench: Array


@dataclass
class ReadingCounts:
    """Numbers of readings from a sensor that were used, invalid or missing.

    Attributes:
        readings: number of readings that were passed on.
        lost: number of readings that never came.
        outdated: readings that came twice or after a newer one.
        refused: packets that are none of the sensor's, or readings with numbers that are not finite.
        invalid: readings that the sensor itself says are wrong.
        last_invalid: the error that it reported.
    """

    readings: int = 0
    lost: int = 0
    outdated: int = 0
    refused: int = 0
    invalid: int = 0
    last_invalid: str = field(default="")


class WrenchSource(Protocol):
    """A force/torque sensor, as long as it is open.

    Attributes:
        clock: how the stamps relate to this computer's clock; ``read`` adds to it.
        counts: numbers of its readings that were used, invalid or missing.
    """

    clock: ClockRelation
    counts: ReadingCounts

    def read(self, timeout: float) -> list[Reading]:
        """The readings of the next packet, none if none comes within ``timeout`` [s]; never raises."""
        ...

    def close(self) -> None:
        """Closes the sensor and releases the device."""
        ...


# ATI's NetFT: raw data transfer over UDP, as its manual (9620-05-NET FT) describes it.
#
# A request is three big-endian numbers: uint16 0x1234, uint16 command (2: stream, 0: stop), uint32 samples (0: without
# end). Answers are records of 36 bytes: uint32 rdt_sequence, ft_sequence, status, int32 × 6 counts Fx Fy Fz Tx Ty Tz;
# some settings put up to 40 of them into a packet. Counts become newtons and newton metres by the calibration's counts
# per unit. ``ft_sequence`` counts the sensor's own samples, at its own rate: it is the sensor's clock.

PORT = 49152
"""UDP port of a NetFT box."""
_REQUEST, _RECORD = struct.Struct(">HHI"), struct.Struct(">IIIiiiiii")
_HEADER, _STREAM, _STOP = 0x1234, 2, 0  # header of a request, and its commands
_MOST = 40
"""Records of a packet."""
_ERROR = 1 << 31
"""Bit of the status that says that something is wrong."""
_AGAIN = 0.5
"""Silence after which the stream is asked for again [s]."""
_PACED, _PIECES, _AS_GOOD = 1.0, 8, 3e-4
"""Time in which a rate is found [s], pieces of it, and the share by which it may be wrong then: the quickest message of
a piece is late by a tenth of a millisecond."""
_PATIENCE = 3.0
"""How long a sensor is waited for whose rate is to be found [s]."""
_FURTHEST = 100_000
"""Numbers that may be missing between two records; more is another sensor, or one that began anew."""


class _Pace:
    """The rate of a counter, from how it rises with this computer's clock."""

    def __init__(self) -> None:
        self._seen: list[tuple[float, float]] = []

    def rate(self, sample: float, arrived: float) -> float:
        """Samples a second [Hz] with this one, which came at ``arrived`` [s]; 0 while it is not known.

        Messages come late, never early: the quickest of each piece of time tell the slope, which is taken for the
        roundest number that is as good as it.
        """
        self._seen.append((sample, arrived))
        if arrived - self._seen[0][1] < _PACED or len(self._seen) < 4 * _PIECES:
            return 0.0
        n, t = np.array(self._seen).T
        self._seen.clear()
        if not np.all(np.diff(n) > 0.0):
            return 0.0
        usual = (t[-1] - t[0]) / (n[-1] - n[0])
        late = t - usual * n
        quickest = [piece[np.argmin(late[piece])] for piece in np.array_split(np.arange(len(n)), _PIECES)]
        found = 1.0 / (usual + float(np.polyfit(n[quickest], late[quickest], 1)[0]))
        round_ones = (float(f"{found:.{digits}g}") for digits in range(1, 6))
        return next((rate for rate in round_ones if abs(rate / found - 1.0) < _AS_GOOD), found)


class NetFT:
    """A ``WrenchSource`` over ATI's raw data transfer (UDP); packets of other addresses are ignored.

    Raises ``InputError`` where there is no such address.

    Args:
        host, port: address of the sensor, and UDP port.
        rate: sample rate of the sensor, by which its counter is a clock [Hz]; 0 estimates it from the counter and this
            computer's clock. No reading is returned before it is known.
        counts_force, counts_torque: counts per newton, and per newton metre.
        least_delay: from the measurement to the packet's arrival, at least, the sensor's filter included [s].
    """

    def __init__(self, host: str, port: int = PORT, *, rate: float = 7000.0, counts_force: float = 1e6,
                 counts_torque: float = 1e6, least_delay: float = 0.0) -> None:
        if not 0.0 <= rate < np.inf:
            raise InputError("expected a positive number, or 0 to estimate the rate", field="force rate",
                             value=rate)
        for name, value in (("counts_force", counts_force), ("counts_torque", counts_torque)):
            if not value > 0:
                raise InputError("expected a positive number", field=f"force {name}", value=value)
        self.clock, self.counts = ClockRelation(least_delay), ReadingCounts()
        self.rate, self._pace, self._scale = rate, _Pace(), 1.0 / np.repeat([counts_force, counts_torque], 3)
        self._number: int | None = None
        self._sample = self._begun = 0
        self._asked = self._heard = 0.0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.connect((host, port))
        except BAD_ADDRESS as error:
            self._socket.close()
            raise InputError(f"no such address ({error})", field="force", value=f"{host}:{port}") from error
        self._ask(_STREAM)

    def read(self, timeout: float) -> list[Reading]:
        """The readings of the next packet, none if none comes within ``timeout`` [s]; see ``WrenchSource.read``."""
        now = time.perf_counter()
        if now - max(self._asked, self._heard) > _AGAIN:
            self._ask(_STREAM)
        self._socket.settimeout(max(timeout, 1e-4))
        try:
            packet = self._socket.recv(_MOST * _RECORD.size + 1)
        except OSError:
            # The sensor is silent or not there yet, so the request is repeated.
            return []
        arrived = time.perf_counter()
        if not packet or len(packet) % _RECORD.size or len(packet) > _MOST * _RECORD.size:
            self.counts.refused += 1
            return []
        self._heard = arrived
        readings = [self._record(record, arrived) for record in _RECORD.iter_unpack(packet)]
        return [reading for reading in readings if reading is not None]

    def find_rate(self, patience: float) -> None:
        """Reads until the sensor's sample rate is known, for at most ``patience`` [s]."""
        deadline = Deadline.within(patience)
        while not self.rate and not deadline.passed:
            self.read(min(deadline.left, 0.1))

    def close(self) -> None:
        """Stops the stream."""
        self._ask(_STOP)
        self._socket.close()

    def _ask(self, command: int) -> None:
        self._asked = time.perf_counter()
        try:
            self._socket.send(_REQUEST.pack(_HEADER, command, 0))
        except OSError:
            return

    def _record(self, record: tuple[int, ...], arrived: float) -> Reading | None:
        number, sample, status, *counts = record
        if self._number is not None:
            since = (number - self._number + 2**31) % 2**32 - 2**31
            if abs(since) > _FURTHEST:
                self._number = None
            elif since <= 0:
                self.counts.outdated += 1
                return None
            else:
                self.counts.lost += since - 1
        if self._number is None:
            self._begun, self._sample = sample, 0
        self._number = number
        # The counter of samples is unwrapped: it restarts at 0 after 2³².
        ahead = (sample - self._begun - self._sample + 2**31) % 2**32 - 2**31
        self._sample += ahead
        if not self.rate:
            self.rate = self._pace.rate(self._sample, arrived)
            return None
        stamp = self._sample / self.rate
        if not self.clock.add(stamp, arrived):
            self.counts.refused += 1
            return None
        if status & _ERROR:
            self.counts.invalid += 1
            self.counts.last_invalid = f"status {status:#010x}; see the list of status codes in the sensor's manual"
            return None
        self.counts.readings += 1
        return Reading(stamp, self._scale * np.array(counts, dtype=float))


_WRENCH = struct.Struct(">I6d")


class StreamForce:
    """A ``WrenchSource`` over a TCP stream; stamps are of the sender's clock, which is requested over it.

    Raises ``InputError`` where no one listens there.

    Args:
        host, port: address of the sender, and TCP port.
        patience: how long the sender is waited for [s].
    """

    def __init__(self, host: str, port: int, patience: float = 5.0) -> None:
        self._connection = StreamConnection(host, port, patience)
        self.clock, self.counts = self._connection.clock, ReadingCounts()
        self._number: int | None = None
        self._broken = 0

    def read(self, timeout: float) -> list[Reading]:
        """The readings of the next packet, none if none comes within ``timeout`` [s]; see ``WrenchSource.read``."""
        package = self._connection.next(timeout)
        if package is None:
            return []
        if package.kind != Kind.WRENCH or len(package.payload) != _WRENCH.size or not self.clock.known:
            self.counts.refused += 1
            return []
        number, *values = _WRENCH.unpack(package.payload)
        wrench = np.array(values)
        if not (np.isfinite(wrench).all() and np.isfinite(package.stamp)):
            self.counts.refused += 1
            return []
        if self._number is not None:
            since = (number - self._number + 2**31) % 2**32 - 2**31
            if since <= 0 and self._broken == self._connection.broken:
                self.counts.outdated += 1
                return []
            self.counts.lost += max(since - 1, 0) if self._broken == self._connection.broken else 0
        self._number, self._broken = number, self._connection.broken
        self.counts.readings += 1
        return [Reading(package.stamp, wrench)]

    def close(self) -> None:
        """Ends the connection."""
        self._connection.close()


Opener = Callable[[str, float], WrenchSource]
"""Opens a sensor: what stands behind its scheme, and the least delay from measurement to arrival [s]."""
_NETFT = {"rate": 0.0, "counts_force": 1e6, "counts_torque": 1e6}  # samples a second, counts per N and N m


def _netft(rest: str, least_delay: float) -> WrenchSource:
    host, port = host_and_port(rest, "force", PORT)
    sensor = NetFT(host, port, least_delay=least_delay, **options(rest, _NETFT, "force"))
    sensor.find_rate(_PATIENCE)
    return sensor


def _stream(rest: str, least_delay: float) -> WrenchSource:
    return StreamForce(*host_and_port(rest, "force"))


FORCE_SENSORS: Registry[Opener] = Registry("force sensor", "ideal_robot.force_sensors", {
    "netft": "sensing.force.sensors:_netft",
    "stream": "sensing.force.sensors:_stream",
    "ros2": "sensing.ros2:opened_force",
})
"""How force sensors are opened, by the scheme of their address."""


def open_force(address: str, least_delay: float = 0.0) -> WrenchSource:
    """Opens a force sensor by its address.

    ``netft://host:port?rate=7000&counts_force=1e6&counts_torque=1e6``, its rate found where it is not given,
    ``stream://host:port`` or ``ros2:///topic``. The least delay from the measurement to the packet's arrival [s] is not
    needed for ``stream``. Raises ``InputError`` where there is no such scheme, or the sensor cannot be opened.
    """
    scheme, colon, rest = address.partition(":")
    if not colon or scheme not in FORCE_SENSORS.names():
        raise InputError(f"expected an address that begins with "
                         f"{', '.join(name + ':' for name in FORCE_SENSORS.names())}", field="force",
                         value=address[:80])
    return FORCE_SENSORS.get(scheme)(rest, least_delay)
