"""Force sensors by address, as one gives it on the command line."""

from __future__ import annotations

from collections.abc import Callable

from ideal_robot.errors import InputError
from ideal_robot.registry import Registry
from sensing.force.netft import PORT, NetFT
from sensing.force.stream_force import StreamForce
from sensing.force.wrench_source import WrenchSource
from sensing.stream.address import host_and_port, options

Opener = Callable[[str, float], WrenchSource]
"""Opens a sensor: what stands behind its scheme, and the least delay from measurement to arrival [s]."""
_NETFT = {"rate": 7000.0, "counts_force": 1e6, "counts_torque": 1e6}


def _netft(rest: str, least_delay: float) -> WrenchSource:
    host, port = host_and_port(rest, "force", PORT)
    return NetFT(host, port, least_delay=least_delay, **options(rest, _NETFT, "force"))


def _stream(rest: str, least_delay: float) -> WrenchSource:
    return StreamForce(*host_and_port(rest, "force"))


FORCE_SENSORS: Registry[Opener] = Registry("force sensor", "ideal_robot.force_sensors", {
    "netft": "sensing.force.sensors:_netft",
    "stream": "sensing.force.sensors:_stream",
})
"""How force sensors are opened, by the scheme of their address."""


def open_force(address: str, least_delay: float = 0.0) -> WrenchSource:
    """Opens a force sensor by its address.

    ``netft://host:port?rate=7000&counts_force=1e6&counts_torque=1e6`` or ``stream://host:port``.

    Args:
        address: as above.
        least_delay: from the measurement to the packet's arrival, at least [s]; not needed for ``stream``.

    Raises:
        InputError: no such scheme, or the sensor cannot be opened.
    """
    scheme, colon, rest = address.partition(":")
    if not colon or scheme not in FORCE_SENSORS.names():
        raise InputError(f"expected an address that begins with "
                         f"{', '.join(name + ':' for name in FORCE_SENSORS.names())}", field="force",
                         value=address[:80])
    return FORCE_SENSORS.get(scheme)(rest, least_delay)
