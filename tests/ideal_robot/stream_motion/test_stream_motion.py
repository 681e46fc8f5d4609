"""Stream Motion against the controller that ``airo-fanuc`` emulates, which checks every packet of ours."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import Array
from ideal_robot.deadline import Deadline
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.stream_motion import StreamMotionError, StreamMotionRobot
from studies.other_arms import CRX_DATA, CRX_HOME, answered_cycle, crx_urdf

testing = pytest.importorskip("airo_fanuc.testing", reason="pip install 'ideal-robot[fanuc]'")
HOME, T = np.array(CRX_HOME), 0.008


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Robot:
    folder = tmp_path_factory.mktemp("crx")
    (folder / "crx10ial.urdf").write_text(crx_urdf(), encoding="utf-8")
    (folder / "crx10ial.toml").write_text(CRX_DATA, encoding="utf-8")
    return Robot.load(folder / "crx10ial.urdf")


@contextmanager
def lockstep(robot: Robot, *, version: int = 3, **options: Any) -> Iterator[tuple[StreamMotionRobot, Any]]:
    """Link and emulated controller; it ticks as soon as its last status was answered, so that no clock decides."""
    config = testing.FakeCRXConfig(available_version=version)
    controller = testing.FakeCRXController(config, initial_q_deg=np.append(np.degrees(HOME), np.zeros(3))).start()
    link = StreamMotionRobot(robot, "127.0.0.1", port=controller.sm_port, rmi_port=controller.rmi_port, **options)
    link.clocked = False
    ended = threading.Event()

    def ticks() -> None:
        while not ended.is_set():
            answered_cycle(controller)

    thread = threading.Thread(target=ticks, daemon=True)
    thread.start()
    try:
        with link:
            link.connect(10.0)
            yield link, controller
    finally:
        ended.set()
        thread.join(5.0)
        controller.close()


def way(k: int, span: int = 60) -> Array:
    u = min(k / span, 1.0)
    return np.asarray(HOME + 0.1 * u**3 * (10 - 15 * u + 6 * u**2))


def until(link: StreamMotionRobot, rows: int, between: Callable[[int], None] = lambda k: None) -> list[Any]:
    states = []
    for k in range(rows):
        between(k)
        states.append(link.cycle(way(k)))
    return states


def test_the_controller_finds_nothing_wrong_with_our_packets_and_time_is_its_tick(robot: Robot) -> None:
    with lockstep(robot) as (link, controller):
        states = until(link, 120)
    assert controller.sm.violations == []
    np.testing.assert_allclose(np.diff([state.t for state in states]), T, atol=1e-12)
    assert link.counts.lost == link.counts.repeated == link.counts.outdated == link.counts.refused == 0
    # The emulated arm lags by 125 ms: it has come to within exp(-0.48 / 0.125) of the way.
    np.testing.assert_allclose(states[-1].q, way(120), atol=0.1 * 2.5 * np.exp(-0.48 / 0.125))
    assert np.isnan(states[-1].tau).all()


def test_lost_status_packets_delay_the_arm_and_are_made_good(robot: Robot) -> None:
    with lockstep(robot) as (link, controller):
        states = until(link, 140, lambda k: controller.sm.inject_seq_gap(3) if k in (30, 50) else None)
    assert link.counts.lost == 6
    np.testing.assert_allclose(np.sort(np.diff([state.t for state in states]))[-3:], [T, 4 * T, 4 * T], atol=1e-9)
    np.testing.assert_allclose(link.commanded, way(140), atol=1e-9)
    assert controller.sm.violations == []


class Wire:
    """A controller whose clock is the test's: a status every cycle, but for those that are lost or late.

    Args:
        lost: numbers of status that do not come.
        late: by how much others are late [s].
    """

    def __init__(self, lost: set[int], late: dict[int, float]) -> None:
        self.now, self.sent, self.at = 0.0, dict[int, Array](), dict[int, float]()
        self._due = sorted((T * n + late.get(n, 1e-4), n) for n in range(1, 400) if n not in lost)

    def read(self, link: Any, deadline: Deadline, taken: Callable[[Any, Any], bool], size: int) -> bool:
        """``read_waiting``."""
        due, number = self._due[0]
        if due > max(deadline.end, self.now):
            self.now = deadline.end
            return False
        self.now = max(self.now, due)
        del self._due[0]
        stands = self.sent[max(self.sent)] if self.sent else HOME
        return taken({"sequence_no": number, "status": 1, "robot_status": 0, "contact_stop_status": 0,
                      "packet_type": 202, "safety_scale": 1.0, "current": np.zeros(9),
                      "joint_angle": np.degrees([*stands, 0.0, 0.0, 0.0])}, None)

    def encode_command_packet(self, number: int, last: bool, kind: int, angles: list[float]) -> bytes:
        """Notes a command of the number; of none twice."""
        assert number not in self.sent
        self.sent[number], self.at[number] = np.radians(angles[:6]), self.now
        return bytes(100)

    def send(self, packet: bytes) -> None:
        return


def led_over(wire: Wire, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> StreamMotionRobot:
    """A link that is led over a wire, by the wire's clock, its arm at rest."""
    monkeypatch.setattr("ideal_robot.stream_motion.robot.read_waiting", wire.read)
    monkeypatch.setattr("time.perf_counter", lambda: wire.now)
    link = StreamMotionRobot(robot, "here")
    link._socket, link._core, link._decoded = wire, wire, lambda packet: packet  # type: ignore[assignment]
    link._number = link._begun = 0
    link._at_rest(HOME, HOME)
    return link


@pytest.mark.parametrize("late", [{}, {100: 0.7 * T}, {100: 1.6 * T, 101: 1.1 * T},
                                  dict.fromkeys(range(100, 400), 0.8 * T)])
def test_a_status_that_does_not_come_in_time_is_answered_by_the_command_expected_for_it(
        robot: Robot, monkeypatch: pytest.MonkeyPatch, late: dict[int, float]) -> None:
    wire = Wire({70, 85, 86}, late)
    link = led_over(wire, robot, monkeypatch)
    k = 0
    while k < 160:
        link.cycle(way(max(k - 50, 0), 100))
        k += 1
        for _ in range(link.gone_on):
            link.skip(way(max(k - 50, 0), 100))
            k += 1
    # Where a clock was held up it is waited for from then on.
    assert link.counts.late <= 2
    # One that another has overtaken is of no use.
    assert link.counts.lost == 3 + link.counts.outdated
    assert sorted(wire.sent) == list(range(max(wire.sent) + 1))
    # In time: before the cycle of the number is over.
    assert max(wire.at[number] - T * number - min(late.get(number, 0.0), T) for number in wire.sent) < T
    commands = np.array([wire.sent[number] for number in sorted(wire.sent)])
    assert np.abs(np.diff(commands, 2, axis=0)).max() / T**2 < 1.5 * robot.a_max.min()
    np.testing.assert_allclose(link.commanded, way(160), atol=1e-9)


def test_a_controller_that_waits_for_its_answers_is_not_answered_before_it_asks(
        robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    wire = Wire(set(), {n: 0.3 * T * (n % 7) for n in range(1, 400)})
    link = led_over(wire, robot, monkeypatch)
    for k in range(100):
        link.cycle(way(k))
        assert link.gone_on == 0


def test_no_number_is_answered_twice_when_a_path_or_the_stream_ends_behind_a_command(robot: Robot) -> None:
    with lockstep(robot) as (link, controller):
        until(link, 20)
        link.send(way(20))
        # Another path begins with a command as well.
        until(link, 20)
        link.send(way(20))
    assert controller.sm.violations == []
    assert link.counts.repeated == 0


def test_doubled_status_packets_are_answered_once(robot: Robot) -> None:
    with lockstep(robot) as (link, controller):
        until(link, 60, lambda k: controller.sm.duplicate_next_status() if k % 5 == 0 else None)
    assert [text for text in controller.sm.violations if "increasing" in text] == []


def trip(controller: Any) -> None:
    with controller.state.lock:
        controller.state.trip_deviation_fault(2, 6.0)


def emergency(controller: Any) -> None:
    with controller.state.lock:
        controller.state.e_stopped = True


def touched(controller: Any) -> None:
    with controller.state.lock:
        controller.state.contact_stop = 1


def taken(controller: Any) -> None:
    with controller.state.lock:
        controller.state.motion_possible_forced_off = True


@pytest.mark.parametrize(("fault", "says"), [
    (trip, "an alarm: .*Stop error excess"), (emergency, "emergency stop"), (touched, "contact stop"),
    (taken, "ended motion control"), (lambda controller: controller.sm.drop_status(10_000), "silent"),
    (lambda controller: controller.sm.inject_seq_gap(40), "40 packets in a row")])
def test_a_stop_of_the_controller_is_said(robot: Robot, fault: Callable[[Any], None], says: str) -> None:
    with lockstep(robot, timeout=0.7) as (link, controller), pytest.raises(StreamMotionError, match=says):
        until(link, 60, lambda k: fault(controller) if k == 20 else None)


def test_a_controller_with_a_force_sensor_tells_its_wrench(robot: Robot) -> None:
    with lockstep(robot, version=4) as (link, controller):
        controller.state.force, controller.state.moment = (1.0, -2.0, 30.0), (0.1, 0.2, 0.3)
        state = until(link, 10)[-1]
    assert [state.columns[name] for name in ("fx", "fy", "fz", "mz")] == pytest.approx([1.0, -2.0, 30.0, 0.3])
    assert controller.sm.violations == []


def test_joint_three_is_told_against_the_ground_where_the_wire_says_so(robot: Robot) -> None:
    with lockstep(robot, j23=1.0) as (link, controller):
        np.testing.assert_allclose(link.commanded, HOME + np.eye(6)[2] * HOME[1], atol=1e-7)
        until_at = link.commanded.copy()
        for k in range(20):
            link.cycle(until_at + (way(k) - HOME))
        wire = np.radians(controller.plant._prev_cmd[:6])
    step = way(19) - HOME
    np.testing.assert_allclose(wire - HOME, step - np.eye(6)[2] * step[1], atol=1e-6)


def test_nobody_there_another_cycle_and_another_arm(robot: Robot) -> None:
    nobody = StreamMotionRobot(robot, "127.0.0.1", port=1, rmi_port=1)
    with pytest.raises(StreamMotionError, match="no controller answers RMI"):
        nobody.connect(0.3)
    with pytest.raises(StreamMotionError, match="cycle is 8 ms"), lockstep(replace(robot, t_ipo=0.004)):
        pass
    fewer = pin.buildReducedModel(robot.pinocchio, [6], pin.neutral(robot.pinocchio))
    with pytest.raises(InputError, match="6 joints"):
        StreamMotionRobot(replace(robot, pinocchio=fewer), "127.0.0.1")
