"""Force sensors as devices: NetFT's records over UDP, and our own stream."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from ideal_robot.errors import InputError
from sensing.force.netft import NetFT
from sensing.force.sensors import open_force
from sensing.force.stream_force import StreamForce
from sensing.force.wrench_source import Reading, WrenchSource
from tests.sensing.stream.device import device, package


def record(rdt: int, ft: int, status: int = 0, counts: tuple[int, ...] = (1_000_000, -2_000_000, 0, 0, 0, 500_000)
           ) -> bytes:
    return struct.pack(">IIIiiiiii", rdt % 2**32, ft % 2**32, status, *counts)


@contextmanager
def sensor(packets: list[bytes]) -> Iterator[tuple[tuple[str, int], list[bytes]]]:
    """Waits for a request, answers with the packets one every 4 ms; yields its address and the requests."""
    asked: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        link.settimeout(2.0)

        def serve() -> None:
            request, client = link.recvfrom(64)
            asked.append(request)
            for packet in packets:
                link.sendto(packet, client)
                time.sleep(0.004)
            link.settimeout(1.0)
            try:
                asked.append(link.recv(64))
            except OSError:
                return

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield link.getsockname(), asked
        thread.join(5.0)


def readings(source: WrenchSource, wanted: int, seconds: float = 2.0) -> list[Reading]:
    end, found = time.perf_counter() + seconds, []
    while len(found) < wanted and time.perf_counter() < end:
        found += source.read(0.02)
    return found


def test_records_become_newtons_with_the_sensors_own_clock() -> None:
    packets = [record(2**32 - 3 + k, 2**32 - 100 + 28 * k) for k in range(10)]
    with sensor(packets) as ((host, port), asked):
        netft = open_force(f"netft://{host}:{port}?rate=7000&counts_torque=5e5")
        found = readings(netft, 10)
        netft.close()
    assert asked == [bytes.fromhex("1234000200000000"), bytes.fromhex("1234000000000000")]
    assert len(found) == 10
    np.testing.assert_allclose(found[0].wrench, [1.0, -2.0, 0.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(np.diff([one.stamp for one in found]), 28 / 7000)


def test_lost_doubled_wrong_and_cut_records_are_counted_and_not_handed_on() -> None:
    packets = [record(1, 0), record(2, 28), record(2, 28), record(5, 112), record(4, 84), record(6, 140, 1 << 31),
               record(7, 168)[:-1], b"", b"x" * 3000, record(7, 168) + record(8, 196)]
    with sensor(packets) as ((host, port), _):
        netft = NetFT(host, port)
        found = readings(netft, 5)
        netft.close()
    counts = netft.counts
    assert len(found) == 5
    assert (counts.lost, counts.outdated, counts.invalid, counts.refused) == (2, 2, 1, 3)
    assert "0x80000000" in counts.last_invalid


def test_packets_of_another_sender_do_not_count() -> None:
    with sensor([record(1, 0)]) as ((host, port), _), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as foreign:
        netft = NetFT(host, port)
        foreign.sendto(record(9, 9, 0, (9, 9, 9, 9, 9, 9)), netft._socket.getsockname())
        found = readings(netft, 2, seconds=0.3)
        netft.close()
    assert len(found) == 1
    assert found[0].wrench[0] == 1.0


def test_ten_thousand_mutated_packets_raise_nothing() -> None:
    rng = np.random.default_rng(5)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        netft = NetFT(*link.getsockname())
        client = link.recvfrom(64)[1]
        for k in range(10_000):
            packet = bytearray(record(k, 28 * k))
            for place in rng.integers(0, len(packet), rng.integers(0, 4)):
                packet[place] = rng.integers(0, 256)
            link.sendto(packet[: rng.integers(1, 37)] if rng.random() < 0.3 else packet, client)
            for reading in netft.read(0.001):
                assert np.isfinite(reading.wrench).all()
                assert np.isfinite(reading.stamp)
        netft.close()


@pytest.mark.parametrize(("values", "sound"), [((1.0, 2, 3, 4, 5, 6), True), ((np.nan, 2, 3, 4, 5, 6), False),
                                               ((1.0, np.inf, 3, 4, 5, 6), False)])
def test_a_stream_of_wrenches(values: tuple[float, ...], sound: bool) -> None:
    def message(k: int) -> bytes:
        return package(4, time.perf_counter() - 0.02, struct.pack(">I6d", k, *values))

    with device(package(3, 0.0, struct.pack(">d", 250.0)), message) as (host, port):
        source: WrenchSource = StreamForce(host, port)
        found = readings(source, 10, seconds=0.4)
        source.close()
    assert bool(found) == sound
    assert sound or source.counts.refused > 3
    if sound:
        np.testing.assert_allclose(found[0].wrench, values)


@pytest.mark.parametrize("address", ["netft://", "netft://h:1?rate=0", "netft://h:1?speed=3", "serial:/dev/tty",
                                     "stream://127.0.0.1"])
def test_an_address_that_cannot_be_is_refused(address: str) -> None:
    opener: Callable[[str], WrenchSource] = open_force
    with pytest.raises(InputError):
        opener(address)
