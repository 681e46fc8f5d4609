"""Force sensing: calibration by moving, filter, and the deviation of [L] (3)."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import GRAVITY
from ideal_robot.errors import InputError
from sensing import SensingError
from sensing.force.force_calibration import ToolLoad, identify_elasticity, identify_tool, require_gravity
from sensing.force.sensors import NetFT, Reading, StreamForce, WrenchSource, force_deviation, open_force
from sim.contact.contact import ForceSensor, ForceSensorSettings
from tests.sensing.stream.test_stream import device, package


def test_bias_and_weight_are_told_apart() -> None:
    rng = np.random.default_rng(0)
    settings = ForceSensorSettings(mass=1.3, com=(0.02, -0.01, 0.07))
    sensor = ForceSensor(settings, rng)
    poses = [pin.SE3(pin.exp3(rng.uniform(-1.5, 1.5, 3)), np.zeros(3)) for _ in range(10)]
    wrenches = np.array([np.mean([sensor.sample(0.0, pose, np.zeros(3)).wrench for _ in range(200)], axis=0)
                         for pose in poses])
    load = identify_tool(wrenches, [pose.rotation for pose in poses])
    assert load.mass == pytest.approx(1.3, abs=0.01)
    np.testing.assert_allclose(load.com, settings.com, atol=1e-3)
    # What is left of a touch in another orientation is the touch.
    pose = pin.SE3(pin.exp3(np.array([0.3, -1.0, 0.5])), np.zeros(3))
    push = np.array([1.0, -2.0, 15.0])
    sensed = np.mean([sensor.sample(0.0, pose, push).wrench for _ in range(400)], axis=0)
    np.testing.assert_allclose(pose.rotation @ load.contact(sensed, pose.rotation)[:3], push, atol=0.1)


def test_an_untouched_tool_shows_no_contact_in_any_orientation() -> None:
    """Weight acts at the tool's centre: its moment about the sensor is com × weight, and is taken away as such."""
    com, mass, bias = np.array([0.02, -0.01, 0.07]), 1.3, np.array([1.0, -2.0, 3.0, 0.1, 0.2, -0.3])
    rng = np.random.default_rng(3)
    for _ in range(5):
        rotation = pin.exp3(rng.uniform(-2.0, 2.0, 3))
        weight = rotation.T @ np.array([0.0, 0.0, -9.81 * mass])
        sensed = bias + np.concatenate([weight, np.cross(com, weight)])
        touch = rng.normal(size=6)
        load = ToolLoad(bias, mass, com, np.zeros(2))
        np.testing.assert_allclose(load.contact(sensed + touch, rotation), touch, atol=1e-12)
        felt = ForceSensor(ForceSensorSettings(mass=mass, com=tuple(com), noise=(0.0, 0.0), bias=(0.0, 0.0)), rng)
        np.testing.assert_allclose(felt.sample(0.0, pin.SE3(rotation, np.zeros(3)), np.zeros(3)).wrench, sensed - bias)


def test_one_orientation_is_not_enough() -> None:
    with pytest.raises(SensingError, match="different orientations"):
        identify_tool(np.zeros((5, 6)), [np.eye(3)] * 5)


def test_elasticity_by_moving() -> None:
    rng = np.random.default_rng(1)
    position = np.linspace(0.004, -0.008, 200)
    force = np.maximum(0.0, 4000 * (0.001 - position)) + 0.3 * rng.standard_normal(200)
    fit = identify_elasticity(position, force)
    assert abs(fit.stiffness - 4000) < 3 * fit.std
    assert fit.touch == pytest.approx(0.001, abs=5e-5)
    with pytest.raises(SensingError, match="press harder"):
        identify_elasticity(position, 0.1 * np.abs(force) / 4)
    with pytest.raises(SensingError, match="does not rise"):
        identify_elasticity(-position, force)


def test_deviation_is_force_error_over_elasticity() -> None:
    """[L] (3), and friction along the surface does not count when the normal is known."""
    up = np.array([0.0, 0.0, 1.0])
    weak = force_deviation(np.array([0.0, 0.0, 12.0]), up, 20.0, 4000.0, sigma=0.3)
    assert weak.value == pytest.approx(-0.002)
    normal = np.array([-0.2, 0.0, 1.0]) / np.hypot(0.2, 1.0)
    along = np.array([1.0, 0.0, 0.2]) / np.hypot(0.2, 1.0)
    rubbing = force_deviation(20.0 * normal - 3.0 * along, up, 20.0, 4000.0, sigma=0.3, normal=normal)
    assert rubbing.value == pytest.approx(0.0, abs=1e-12)
    with pytest.raises(InputError, match="positive elasticity"):
        force_deviation(up, up, 20.0, 0.0, sigma=0.3)


@pytest.mark.parametrize("force", [19.9, 12.0, 40.0])
def test_the_deviation_is_as_sure_as_its_noise_and_the_stiffness_let_it_be(force: float) -> None:
    """Over contacts whose true stiffness is about the assumed one: what is left scatters as the deviation says."""
    rng, up, wanted, assumed, sigma, error = np.random.default_rng(6), np.array([0.0, 0.0, 1.0]), 20.0, 5e3, 0.3, 0.1
    true = (force - wanted) / assumed
    errors, sigmas = [], []
    for _ in range(4000):
        felt = wanted + true * assumed / (1.0 + error * rng.standard_normal()) + sigma * rng.standard_normal()
        deviation = force_deviation(felt * up, up, wanted, assumed, sigma=sigma, elasticity_error=error)
        errors.append(deviation.value - true)
        sigmas.append(deviation.sigma)
    assert np.median(sigmas) == pytest.approx(np.std(errors), rel=0.06)


# Force sensors as devices: NetFT's records over UDP, and our own stream.

def record(rdt: int, ft: int, status: int = 0, counts: tuple[int, ...] = (1_000_000, -2_000_000, 0, 0, 0, 500_000)
           ) -> bytes:
    return struct.pack(">IIIiiiiii", rdt % 2**32, ft % 2**32, status, *counts)


@contextmanager
def sensor(packets: list[bytes]) -> Iterator[tuple[tuple[str, int], list[bytes]]]:
    """Waits for a request, answers with the packets one every 4 ms; yields its address and the requests."""
    requests: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        link.settimeout(2.0)

        def serve() -> None:
            request, client = link.recvfrom(64)
            requests.append(request)
            for packet in packets:
                link.sendto(packet, client)
                time.sleep(0.004)
            link.settimeout(1.0)
            try:
                requests.append(link.recv(64))
            except OSError:
                return

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield link.getsockname(), requests
        thread.join(5.0)


def readings(source: WrenchSource, wanted: int, seconds: float = 2.0) -> list[Reading]:
    end, received = time.perf_counter() + seconds, []
    while len(received) < wanted and time.perf_counter() < end:
        received += source.read(0.02)
    return received


def test_records_become_newtons_with_the_sensors_own_clock() -> None:
    packets = [record(2**32 - 3 + k, 2**32 - 100 + 28 * k) for k in range(10)]
    with sensor(packets) as ((host, port), requests):
        netft = open_force(f"netft://{host}:{port}?rate=7000&counts_torque=5e5")
        received = readings(netft, 10)
        netft.close()
    assert requests == [bytes.fromhex("1234000200000000"), bytes.fromhex("1234000000000000")]
    assert len(received) == 10
    np.testing.assert_allclose(received[0].wrench, [1.0, -2.0, 0.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(np.diff([reading.stamp for reading in received]), 28 / 7000)


@pytest.mark.parametrize("seed", range(6))
def test_a_rate_that_nobody_told_is_found(seed: int) -> None:
    """Whatever messages are late by, and however many there are; the readings before it is known are not handed on."""
    rng = np.random.default_rng(seed)
    true = float(rng.choice([100.0, 250.0, 1000.0, 6944.0, 7000.0, 7812.5]))
    each = max(round(true / 250.0), 1)
    netft = NetFT("127.0.0.1", rate=0.0)
    handed = [netft._record((k, each * k, 0, *([0] * 6)), 5.0 + each * k / true + 2e-4 * rng.exponential())
              for k in range(600)]
    assert netft.rate == pytest.approx(true, rel=3e-4)
    first = next(k for k, reading in enumerate(handed) if reading is not None)
    assert 1.0 <= each * first / true < 1.5
    assert all(reading is not None for reading in handed[first:])
    netft.close()


def test_lost_doubled_wrong_and_cut_records_are_counted_and_not_handed_on() -> None:
    packets = [record(1, 0), record(2, 28), record(2, 28), record(5, 112), record(4, 84), record(6, 140, 1 << 31),
               record(7, 168)[:-1], b"", b"x" * 3000, record(7, 168) + record(8, 196)]
    with sensor(packets) as ((host, port), _):
        netft = NetFT(host, port)
        received = readings(netft, 5)
        netft.close()
    counts = netft.counts
    assert len(received) == 5
    assert (counts.lost, counts.outdated, counts.invalid, counts.refused) == (2, 2, 1, 3)
    assert "0x80000000" in counts.last_invalid


def test_packets_of_another_sender_do_not_count() -> None:
    with sensor([record(1, 0)]) as ((host, port), _), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as foreign:
        netft = NetFT(host, port)
        foreign.sendto(record(9, 9, 0, (9, 9, 9, 9, 9, 9)), netft._socket.getsockname())
        received = readings(netft, 2, seconds=0.3)
        netft.close()
    assert len(received) == 1
    assert received[0].wrench[0] == 1.0


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
        received = readings(source, 10, seconds=0.4)
        source.close()
    assert bool(received) == sound
    assert sound or source.counts.refused > 3
    if sound:
        np.testing.assert_allclose(received[0].wrench, values)


@pytest.mark.parametrize("address", ["netft://", "netft://h:1?rate=0", "netft://h:1?speed=3", "serial:/dev/tty",
                                     "stream://127.0.0.1"])
def test_an_address_that_cannot_be_is_refused(address: str) -> None:
    opener: Callable[[str], WrenchSource] = open_force
    with pytest.raises(InputError):
        opener(address)


POSTURES = [pin.rpy.rpyToMatrix(np.pi + b, 0.3 * a, a) for a, b in
            ((0.0, 0.0), (0.0, 0.4), (0.0, -0.4), (0.5, 0.3), (1.0, 0.5), (-0.5, 0.4), (-1.0, -0.3))]


def weighed(mass: float, turned: np.ndarray | None = None, drift: float = 0.0, leap: float = 0.0) -> np.ndarray:
    bias, rng, turned = np.array([4.0, -2.7, 2.4]), np.random.default_rng(1), np.eye(3) if turned is None else turned
    f = np.array([turned @ (R.T @ (mass * GRAVITY) + bias) for R in POSTURES]) + 0.03 * rng.standard_normal((7, 3))
    f[:, 2] += drift * 1.3 * np.arange(7)
    f[4:, 2] += leap
    return np.hstack([f, np.zeros((7, 3))])


@pytest.mark.parametrize("mass", [0.1, 0.8, 5.0])
def test_a_weight_that_turns_with_the_postures_is_believed(mass: float) -> None:
    require_gravity(weighed(mass), POSTURES, 1.3 * np.arange(7), np.full(3, 0.03))


@pytest.mark.parametrize(("wrenches", "says"), [
    (weighed(0.0), "same weight of the tool in 7 postures"), (weighed(0.8, -np.eye(3)), "wrong sign"),
    (weighed(0.8, np.eye(3)[[2, 0, 1]]), r"\(y, z, x\)"), (weighed(0.8, np.diag([1.0, 1.0, -1.0])), r"\(x, y, -z\)"),
    (weighed(0.8, drift=0.2), "drifts by 0.2 N/s"), (weighed(0.8, leap=1.0), "does not turn with the postures")])
def test_what_is_wrong_with_a_sensor_is_told_by_how_a_weight_turns(wrenches: np.ndarray, says: str) -> None:
    with pytest.raises(SensingError, match=says):
        require_gravity(wrenches, POSTURES, 1.3 * np.arange(7), np.full(3, 0.03))
