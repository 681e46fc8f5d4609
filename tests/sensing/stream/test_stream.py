"""The stream's parser: any cut of the bytes gives the same packages, and nothing makes it grow or raise else."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ideal_robot.errors import InputError
from ideal_robot.rsi.link import PacketLink
from ideal_robot.rtde.wire import RtdeConnection, RtdeError
from sensing.clock_relation import ClockRelation
from sensing.force.sensors import NetFT
from sensing.stream import HEADER, LARGEST, Kind, Reader, StreamConnection, StreamError, _packed


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=60)), max_size=8), st.integers(1, 50))
def test_any_cut_gives_the_same_packages(sent: list[tuple[int, bytes]], size: int) -> None:
    wire = b"".join(HEADER.pack(b"IR", 1, kind, len(load), 0.5) + load for kind, load in sent)
    reader, messages = Reader(), []
    for i in range(0, len(wire), size):
        messages += reader.feed(wire[i : i + size])
    assert [(message.kind, message.payload) for message in messages] == sent


@pytest.mark.parametrize("wire", [b"GET / HTTP/1.1\r\n\r\n", HEADER.pack(b"IR", 2, 1, 0, 0.0),
                                  HEADER.pack(b"IR", 1, 2, LARGEST + 1, 0.0)])
def test_another_protocol_another_version_and_what_is_too_large_are_refused(wire: bytes) -> None:
    with pytest.raises(StreamError):
        list(Reader().feed(wire))


@pytest.mark.parametrize("host", ["a\udcffb", "a\0b", ".." * 40, "x" * 300])
@pytest.mark.parametrize("connect", [
    lambda host: StreamConnection(host, 9, 0.0), lambda host: NetFT(host), lambda host: RtdeConnection(host, 9, 0.1),
    lambda host: PacketLink(host, 0, 6)])
def test_an_address_that_is_no_text_is_refused_by_every_device(host: str, connect: Callable[[str], object]) -> None:
    """Once a traceback, "encoding of hostname failed"."""
    with pytest.raises((InputError, RtdeError)):
        connect(host)


def test_the_documented_bytes() -> None:
    assert _packed(Kind.ASK, 1.5, struct.pack(">d", 2.0)).hex() == (
        "4952" "01" "05" "00000008" "3ff8000000000000" "4000000000000000")


def test_twenty_thousand_mutated_packages_raise_nothing_else_and_hold_nothing() -> None:
    rng = np.random.default_rng(3)
    sound = _packed(Kind.WRENCH, 1.0, struct.pack(">I6d", 1, *range(6)))
    for _ in range(20_000):
        wire = bytearray(sound)
        for place in rng.integers(0, len(wire), rng.integers(1, 4)):
            wire[place] = rng.integers(0, 256)
        reader = Reader()
        try:
            list(reader.feed(bytes(wire)))
        except StreamError:
            continue
        assert len(reader._waiting) <= len(wire)


# Offset and drift of a device's clock are recovered from stamps and arrivals; what cannot be is refused.

def heard(relation: ClockRelation, *, offset: float, drift: float, seconds: float, rate: float = 50.0,
          delay: float = 0.004) -> None:
    """A device whose clock shows ``s`` at ``h = offset + (1 + drift) s``; exponential delays above the least one."""
    rng = np.random.default_rng(1)
    for s in np.arange(0.0, seconds, 1.0 / rate):
        relation.add(s, offset + (1.0 + drift) * s + delay + rng.exponential(0.0003))


@pytest.mark.parametrize("drift", [-50e-6, 20e-6, 50e-6])
def test_offset_and_drift_are_recovered(drift: float) -> None:
    relation = ClockRelation(least_delay=0.004)
    heard(relation, offset=1234.5, drift=drift, seconds=60.0)
    report = relation.report()
    assert abs(1e-6 * report.drift_ppm - drift) < 4e-6
    assert abs(relation.host(60.0) - (1234.5 + 60.0 * (1.0 + drift))) < 2e-4
    assert abs(relation.stamp(relation.host(12.3)) - 12.3) < 1e-9
    assert 0.0 <= report.late_ms < 1.0
    assert report.refused == 0


def test_a_short_while_tells_the_offset_and_leaves_the_drift_at_its_prior() -> None:
    relation = ClockRelation()
    heard(relation, offset=-7.0, drift=20e-6, seconds=0.6, delay=0.0)
    assert abs(relation.host(0.5) - (-6.5)) < 2e-4
    assert relation.report().drift_std_ppm > 50.0


def test_late_messages_and_stalls_do_not_move_the_line() -> None:
    relation, rng = ClockRelation(), np.random.default_rng(2)
    for k in range(3000):
        late = 0.3 - 0.02 * (k % 500 - 100) if 100 <= k % 500 < 115 else rng.exponential(0.001)
        relation.add(0.02 * k, 100.0 + 0.02 * k + late)
    assert abs(relation.host(60.0) - 160.0) < 5e-4


@pytest.mark.parametrize("stamp", [np.nan, np.inf, 100.1, 50.0, 1e9])
def test_one_impossible_stamp_is_refused_and_changes_nothing(stamp: float) -> None:
    relation = ClockRelation()
    heard(relation, offset=3.0, drift=0.0, seconds=100.0, rate=10.0, delay=0.0)
    before = relation.host(100.0)
    assert not relation.add(stamp, 103.0)
    assert relation.host(100.0) == before
    assert relation.report().refused == 1
    assert relation.add(100.0, 103.0001)


@pytest.mark.parametrize("period", [0.7, 1.7, 4.0])
def test_messages_that_are_held_up_for_seconds_set_no_clock_back(period: float) -> None:
    """A sender that does not keep up is late by now more, now less; what its clock shows is as true as before."""
    relation, rng = ClockRelation(), np.random.default_rng(3)
    for k in range(3000):
        t = 0.004 * k
        held_up = 0.2 + 0.15 * np.sin(2.0 * np.pi * t / period) if 4.0 < t < 8.0 else 0.0
        relation.add(t, 100.0 + t + held_up + 0.0005 * rng.exponential())
        assert relation.host(t) == pytest.approx(100.0 + t, abs=2e-3)
    assert relation.restarts == 0


def test_a_clock_that_stood_still_is_noticed_within_two_seconds() -> None:
    relation, rng = ClockRelation(), np.random.default_rng(4)
    for k in range(1000):
        relation.add(0.012 * k, 0.012 * k + rng.exponential(2e-4) + (0.04 if k > 700 else 0.0))
        if k == 700 + round(2.0 / 0.012):
            assert abs(relation.host(8.0) - 8.04) < 1e-3
    assert relation.report().restarts == 1
    assert abs(relation.report().drift_ppm) < 100.0


def test_a_device_that_began_anew_is_believed_after_three_stamps() -> None:
    relation = ClockRelation()
    heard(relation, offset=3.0, drift=0.0, seconds=100.0, rate=10.0, delay=0.0)
    assert [relation.add(s, 105.0 + s) for s in (0.0, 0.1, 0.2)] == [False, False, True]
    assert abs(relation.host(10.0) - 115.0) < 1e-3
    assert relation.report().restarts == 1


# The device's side of a stream for tests: accepts clients one after the other and sends what it is told.

def package(kind: int, stamp: float, payload: bytes) -> bytes:
    return struct.pack(">2sBBId", b"IR", 1, kind, len(payload), stamp) + payload


@contextmanager
def device(hello: bytes, messages: Callable[[int], bytes | None], *, clock: Callable[[], float] = time.perf_counter,
           every: float = 0.01) -> Iterator[tuple[str, int]]:
    """Sends ``hello`` and then ``messages(k)`` every so often until it gives None, which closes the connection."""
    stopped, count = threading.Event(), 0
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.05)

    def answers(client: socket.socket) -> None:
        with client:
            while not stopped.is_set():
                try:
                    questions = client.recv(4096)
                except OSError:
                    return
                if not questions:
                    return
                for i in range(0, len(questions) - 23, 24):
                    try:
                        client.sendall(package(6, clock(), questions[i + 16 : i + 24]))
                    except OSError:
                        return

    def serve() -> None:
        nonlocal count
        while not stopped.is_set():
            try:
                client, _ = listener.accept()
            except TimeoutError:
                continue
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=answers, args=(client,), daemon=True).start()
            try:
                client.sendall(hello)
                while not stopped.is_set() and (message := messages(count)) is not None:
                    count += 1
                    client.sendall(message)
                    time.sleep(every)
                count += 1
                client.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield listener.getsockname()
    finally:
        stopped.set()
        thread.join(5.0)
        listener.close()


def test_where_messages_jitter_their_clock_is_the_same_at_the_end_as_where_a_sensor_was_calibrated() -> None:
    """By the soonest message of all it went by more than a millisecond between 15 and 60 s."""
    moved = []
    for seed in range(20):
        rng, clock = np.random.default_rng(seed), ClockRelation()
        for k in range(1500):
            clock.add(0.04 * k, 50.0 + 0.04 * k + 0.04 + 0.004 * float(rng.standard_normal()))
            if k == 375:
                calibrated = clock.host(15.0)
        moved.append(clock.host(60.0) - 45.0 - calibrated)
    assert abs(np.mean(moved)) < 5e-4
    assert np.std(moved) < 1.2e-3


@pytest.mark.parametrize("by", [-0.02, 0.02])
def test_a_clock_that_is_set_by_more_than_messages_jitter_is_another_one(by: float) -> None:
    rng, clock = np.random.default_rng(6), ClockRelation()
    for k in range(2000):
        s = 0.02 * k
        clock.add(s, 7.0 + s + 0.002 * float(rng.exponential()) + (by if s > 30.0 else 0.0))
    assert clock.restarts == 1
    assert clock.host(40.0) == pytest.approx(47.0 + by, abs=1e-3)


@pytest.mark.parametrize("seed", range(5))
def test_messages_that_jitter_set_no_clock_anew(seed: int) -> None:
    """Pictures over a network, 4 ms sooner or later: every few seconds their clock was taken for another."""
    rng, clock = np.random.default_rng(seed), ClockRelation()
    for k in range(1500):
        clock.add(0.04 * k, 50.0 + 0.04 * k + 0.04 + 0.004 * float(rng.standard_normal()))
        # A first message that came late is no clock yet.
        if k < 10:
            begun = clock.restarts
    assert clock.restarts == begun
    # The soonest messages tell: those of five standard deviations at most.
    assert 0.02 < clock.host(60.0) - 110.0 < 0.04
    # One that is really set back is noticed nevertheless.
    for stamp in 60.0 + 0.04 * np.arange(100):
        clock.add(float(stamp), 50.03 + float(stamp) + 0.04 + 0.004 * float(rng.standard_normal()))
    assert clock.restarts == begun + 1
    assert 0.05 < clock.host(64.0) - 114.0 < 0.075
