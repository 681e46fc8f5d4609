"""FCI against a controller of the test's own, tick by tick, and against the one that others simulate."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.fci import FciError, FciRobot
from ideal_robot.fci.milliseconds import Answering, FciMotion, Wanted, said
from ideal_robot.interfaces import LinkSettings, connected_arm
from ideal_robot.robots.robot import Robot
from studies.other_arms import FR3_HOME, fr3

HOME = np.array(FR3_HOME)


def arm(folder: Path, cycle: float = 1e-3) -> Robot:
    """Seven joints in a row, each with its own turn of the axis."""
    links = "".join(
        f'<link name="l{i}"><inertial><mass value="2"/><inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" '
        f'iyz="0"/></inertial></link><joint name="j{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/>'
        f'<origin xyz="0 0 0.2"/><axis xyz="{"0 0 1" if i % 2 else "0 1 0"}"/><limit lower="-2.9" upper="2.9" '
        'velocity="2.5" effort="80"/></joint>' for i in range(1, 8))
    (folder / "seven.urdf").write_text(f'<robot name="seven"><link name="l0"/>{links}</robot>', encoding="utf-8")
    return replace(Robot.load(folder / "seven.urdf"), t_ipo=cycle, a_max=np.full(7, 10.0))


class Controller:
    """What ``pylibfranka`` shows of an arm that is where it was commanded a tick before; ``misses``: ticks of which no
    state arrives in time, in which it goes on as before."""

    class FrankaException(Exception):  # noqa: N818
        """The library's own."""

    def __init__(self, misses: set[int] = frozenset(), stops: tuple[int, str] | None = None) -> None:
        self.misses, self.stops, self.mode, self.errors = set(misses), stops, "Idle", ""
        self.tick, self.finished = 5000, False
        self.q_d, self.speed = HOME.copy(), np.zeros(7)
        self.commands: list[tuple[int, Array]] = []
        self.RealtimeConfig = SimpleNamespace(kIgnore=0)
        self.ControllerMode = SimpleNamespace(JointImpedance=0, CartesianImpedance=1)

    def Robot(self, host: str, realtime: int) -> Controller:
        if host == "nobody":
            raise self.FrankaException("libfranka: Connection to FCI refused")
        return self

    def JointPositions(self, q: list[float]) -> SimpleNamespace:
        return SimpleNamespace(q=np.array(q), motion_finished=False)

    def start_joint_position_control(self, mode: int) -> Controller:
        self.mode = "Move"
        return self

    def read_once(self) -> Any:
        return SimpleNamespace(
            q=self.q_d, q_d=self.q_d, dq_d=1e3 * self.speed, tau_J=np.ones(7), tau_ext_hat_filtered=np.zeros(7),
            K_F_ext_hat_K=np.zeros(6), control_command_success_rate=1.0, current_errors=self.errors,
            robot_mode=SimpleNamespace(name=self.mode, value=2),
            time=SimpleNamespace(to_sec=lambda at=self.tick: at / 1e3))

    def readOnce(self) -> tuple[Any, None]:
        self.tick += 1
        while self.tick - 5000 in self.misses:
            self.q_d = self.q_d + self.speed
            self.tick += 1
        if self.stops is not None and self.tick - 5000 >= self.stops[0]:
            raise RuntimeError(f"libfranka: Move command aborted: motion aborted by reflex! [\"{self.stops[1]}\"]")
        return self.read_once(), None

    def writeOnce(self, command: Any) -> None:
        self.finished = command.motion_finished
        self.speed, self.q_d = command.q - self.q_d, command.q
        self.commands.append((self.tick + 1, command.q))


@pytest.fixture
def led(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    def leads(controller: Controller, cycle: float = 1e-3) -> FciRobot:
        monkeypatch.setitem(sys.modules, "pylibfranka", controller)
        link = FciRobot(arm(tmp_path, cycle), "here", queue=0.0, waits=True)
        link.connect(0.1)
        return link
    return leads


def way(t: float) -> Array:
    """From rest to rest within a second."""
    u = min(max(t, 0.0), 1.0)
    return np.asarray(HOME + 0.3 * u**3 * (10 - 15 * u + 6 * u**2))


def follow(link: FciRobot, cycles: int) -> None:
    for k in range(cycles):
        link.cycle(way(1e-3 * k))


@pytest.mark.parametrize("cycle", [1e-3, 2e-3, 4e-3, 8e-3])
def test_commands_between_cycles_have_the_acceleration_of_the_path(led, cycle: float) -> None:
    controller = Controller()
    link = led(controller, cycle)
    with link:
        for k in range(round(1.2 / cycle)):
            state = link.cycle(way(cycle * k))
    assert controller.finished
    ticks, sent = [tick for tick, _ in controller.commands[:-1]], np.array([q for _, q in controller.commands[:-1]])
    assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))
    acceleration = np.diff(sent, 2, axis=0) / 1e-6
    # Largest acceleration of the quintic: 10/√3 of its way, in a second.
    assert np.abs(acceleration).max() < 1.02 * 0.3 * 10 / np.sqrt(3)
    np.testing.assert_allclose(sent[-1], way(1.0), atol=1e-9)
    assert state.t == pytest.approx(1.2, abs=2 * cycle)


def test_the_path_goes_on_where_the_controller_did(led) -> None:
    controller = Controller(misses=set(range(300, 305)) | {500})
    link = led(controller)
    k, times = 0, []
    while k < 1200:
        times.append(link.cycle(way(1e-3 * k)).t)
        k += 1
        for _ in range(link.gone_on):
            link.skip(way(1e-3 * k))
            k += 1
    assert link.counts.lost == link.counts.late == 6
    np.testing.assert_allclose(np.unique(np.round(np.diff(times), 9)), [1e-3, 2e-3, 6e-3])
    acceleration = np.diff([q for _, q in controller.commands], axis=0)
    assert np.abs(acceleration).max() < 2.5 * 6e-3
    # Led back onto the path, not behind it.
    np.testing.assert_allclose(controller.q_d, way(1.0), atol=1e-9)
    sent = dict(controller.commands)
    np.testing.assert_allclose(sent[5000 + 700], way(0.697), atol=1e-3)


def answered(controller: Controller, cycle: int, given: dict[int, list[int]], milliseconds: int) -> Array:
    """What is sent in each millisecond where commands of ``cycle`` ms come 4 ms before they are played.

    Args:
        controller: the arm's.
        cycle: of the commands [ms].
        given: cycles whose command comes with that of another cycle; an empty list where it never comes.
        milliseconds: how many are answered.
    """
    sys.modules["pylibfranka"] = controller  # type: ignore[assignment]
    wanted = Wanted("here", False, 0.1, cycle, 4, np.full(7, 10.0), np.full(7, 2.5))
    answering = Answering(FciMotion("here", False, 0.1), wanted)

    def rows(k: int) -> Array:
        return np.array([way(1e-3 * cycle * i) for i in range(k, k + 100 // cycle + 1)])

    answering.begin(rows(0))
    for _ in range(milliseconds):
        answering.write()
        if (report := answering.read()) is not None:
            for k in given.get(report.cycle, [report.cycle]):
                answering.knots.give(k, rows(k))
    if report is not None and not controller.misses:
        assert report.late == sum(k <= (at * cycle - 5) // cycle for at, of in given.items() for k in of)
    return np.array([q for _, q in controller.commands])


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pylibfranka", None)


@pytest.mark.parametrize("cycle", [1, 2, 4, 8])
def test_a_command_that_comes_too_late_was_expected(library: None, cycle: int) -> None:
    kept = answered(Controller(), cycle, {}, 1200)
    begin = 400 // cycle
    # Eighty milliseconds in which none comes, then all of them at once.
    count = 80 // cycle
    silent: dict[int, list[int]] = {begin + i: [] for i in range(count)}
    late = answered(Controller(), cycle, silent | {begin + count: list(range(begin, begin + count + 1))}, 1200)
    np.testing.assert_allclose(late, kept, atol=1e-12)
    assert np.abs(np.diff(kept, 2, axis=0)).max() / 1e-6 < 1.02 * 0.3 * 10 / np.sqrt(3) / min(cycle, 1)
    np.testing.assert_allclose(kept[-1], way(1.0), atol=1e-9)


@pytest.mark.parametrize("cycle", [2, 4, 8])
def test_an_arm_of_which_no_command_is_known_is_braked(library: None, cycle: int) -> None:
    sent = answered(Controller(), cycle, {k: [] for k in range(400 // cycle, 1200 // cycle + 1)}, 1200)
    assert np.abs(np.diff(sent, 2, axis=0)).max() / 1e-6 < 10.0
    assert np.abs(np.diff(sent[-100:], axis=0)).max() < 1e-12


@pytest.mark.parametrize("count", [1, 3, 12])
@pytest.mark.parametrize("cycle", [1, 4, 8])
def test_milliseconds_that_were_missed_are_led_back_from(library: None, cycle: int, count: int) -> None:
    controller = Controller(misses=set(range(450, 450 + count)))
    sent = answered(controller, cycle, {}, 1300)
    ticks = np.array([tick for tick, _ in controller.commands])
    # The controller goes on at its speed meanwhile.
    every = np.array([np.interp(np.arange(ticks[0], ticks[-1] + 1), ticks, column) for column in sent.T]).T
    assert np.abs(np.diff(every, 2, axis=0)).max() / 1e-6 < 1.5 * 10.0
    np.testing.assert_allclose(sent[-1], way(1.0), atol=1e-9)


def test_too_many_lost_end_it(led) -> None:
    link = led(Controller(misses=set(range(300, 450))))
    with pytest.raises(FciError, match="150 states in a row"):
        follow(link, 1000)


@pytest.mark.parametrize(("name", "says"), [
    ("joint_reflex", "a collision was detected"), ("joint_motion_generator_velocity_discontinuity", "speed leaps"),
    ("communication_constraints_violation", "answers came too late"), ("something_new", "something_new")])
def test_a_reflex_is_said_in_words(led, name: str, says: str) -> None:
    controller = Controller(stops=(50, name))
    link = led(controller)
    with pytest.raises(FciError, match=says):
        follow(link, 100)
    assert name in said(name)
    # It has ended the motion by itself: a last command would wait for an answer that does not come.
    sent = len(controller.commands)
    link.close()
    assert len(controller.commands) == sent


def test_an_arm_that_was_moved_before_the_first_command_is_not_torn_back(led) -> None:
    controller = Controller()
    link = led(controller)
    controller.q_d = HOME + np.array([0.0, 0.0, -0.05, 0.0, 0.0, 0.0, 0.0])
    for _ in range(2):
        with pytest.raises(FciError, match=r"joint 3 has moved by 2\.86° since the controller was reached"):
            link.cycle(HOME)
    assert controller.mode == "Idle"
    assert not controller.commands


def test_silence_is_not_called_a_stop_of_the_arm(led) -> None:
    controller = Controller()
    link = led(controller)
    follow(link, 5)

    def silent() -> None:
        raise RuntimeError("libfranka: UDP receive: Timeout")

    controller.readOnce = silent  # type: ignore[method-assign, assignment]
    with pytest.raises(FciError, match="controller is silent") as told:
        follow(link, 5)
    assert "stopped" not in str(told.value)


@pytest.mark.parametrize(("mode", "says"), [("UserStopped", "user stop"), ("Guiding", "by hand"),
                                            ("Reflex", "recover it"), ("Other", "brakes")])
def test_an_arm_that_cannot_be_led_now(led, mode: str, says: str) -> None:
    controller = Controller()
    controller.mode = mode
    with pytest.raises(FciError, match=says):
        led(controller)


def test_nobody_there_and_an_arm_that_does_not_fit(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "pylibfranka", Controller())
    led_by_nobody = FciRobot(arm(tmp_path), "nobody", waits=True)
    with pytest.raises(FciError, match="activated in Desk"):
        led_by_nobody.connect(0.1)
    with pytest.raises(InputError, match="7 joints"):
        FciRobot(Robot.load("kr6"), "here")
    with pytest.raises(InputError, match="whole milliseconds"):
        FciRobot(arm(tmp_path, 0.0025), "here")


def test_without_its_library_one_line_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "pylibfranka", None)
    with pytest.raises(InputError, match=r"pip install 'ideal-robot\[franka\]'"), connected_arm(
            "franka://127.0.0.9", arm(tmp_path), LinkSettings(), 0.1):
        pass


@pytest.fixture(scope="module")
def simulated(tmp_path_factory) -> Iterator[tuple[str, Path]]:
    pytest.importorskip("pylibfranka", reason="pip install 'ideal-robot[franka,simulators]'")
    pytest.importorskip("franky_sim", reason="pip install 'ideal-robot[franka,simulators]'")
    with fr3(tmp_path_factory.mktemp("fr3"), host="127.0.0.73", slowed=2.0) as served:
        yield served


@pytest.mark.slow
def test_an_fr3_that_others_simulate_follows_within_its_controllers_lag(simulated: tuple[str, Path]) -> None:
    address, urdf = simulated
    robot = Robot.load(urdf)
    with connected_arm(address, robot, LinkSettings(), 20.0) as link:
        begin, t, q, sent, late = link.commanded.copy(), [], [], [], 0
        for k in range(800):
            sent.append(begin + way(1e-3 * k) - HOME)
            state = link.cycle(sent[-1])
            t.append(state.t)
            q.append(state.q)
            late += link.gone_on
    assert link.fault is None
    assert np.allclose(np.diff(t), 1e-3) or late
    # Its damping is on speed: lag of kv/kp, 0.1 s in the first joints.
    lag = np.array(sent)[:-100, 0] - np.array(q)[100:, 0]
    assert np.abs(lag).max() < 0.02
    assert state.columns["mode"] == 2.0
    np.testing.assert_allclose(state.columns["q_set"], sent[-1], atol=2e-3)
