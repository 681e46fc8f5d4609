"""What a real controller may do to the server: each ends on the path, within limits, with the cause named."""

from __future__ import annotations

import gc
import os
import re
import signal
import socket
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import typer

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import PacketError
from ideal_robot.rsi.message import RsiFormat, parse_rob
from scenes.online.processes import stopping_on_signals
from scenes.rsi.server import RsiRun, RsiServer, rsi_server
from studies.rsi import rsi_hour
from tests.ideal_robot.rsi.test_message import PACKET
from tests.scenes.rsi.test_rsi import motion, written
from tests.sim.devices.controllers import PATIENCE, LaggingController, mutated, playing

ROBOT = Robot.load("kr6")
SIGN = np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0])
HOME = SIGN * np.degrees(ROBOT.home)


def played(folder: Path, controller: LaggingController, server_change=lambda server: None, **options) -> RsiRun:
    path = written(folder, motion())
    with rsi_server(path, **{"robot": "kr6", "method": "none", "port": 0, "cycle": controller.cycle, "rest": 0.4,
                             **options}) as server:
        server.link.timeout = PATIENCE
        server_change(server)
        with playing(controller, server.link.address):
            return server.play(patience=PATIENCE)


def largest_acceleration(controller: LaggingController) -> Array:
    """What the controller had to command, as a share of the arm's limit ``(n,)``."""
    commanded = np.radians(controller.commanded)
    return np.asarray(np.abs(np.diff(commanded, 2, axis=0)).max(axis=0) / controller.cycle**2 / ROBOT.a_max)


def jump(cycle: int, measured: Array) -> Array:
    return measured + (40.0 * np.eye(6)[1] if cycle > 70 else 0.0)


@pytest.mark.parametrize(("fault", "relative", "says"), [
    ({"gain": np.array([1, 1, 1, -1, 1, 1.0])}, False, r"joint 4 .*turns against.*axis_sign"),
    pytest.param({"gain": np.array([1, 1, 1, -1, 1, 1.0]), "adds_up": True}, True,
                 r"joint 4 .*turns against.*axis_sign", marks=pytest.mark.slow),
    ({"tag": "AKorr"}, False, r"the arm does not move; check the tag"),
    ({"gain": np.array([1, 1, 1, 1, 1, 0.0])}, False, r"joint 6 does not move"),
    ({"adds_up": True}, False, r"adds up absolute corrections"),
    ({"adds_up": False}, True, r"takes increments as absolute"),
    ({"measured": jump}, False, r"measured position of joint 2 jumped by (39|40)°"),
    ({"gain": np.full(6, 1.6)}, False, r"does not follow it"),
])
def test_an_arm_that_does_something_else_is_stopped_and_the_cause_named(tmp_path: Path, fault, relative, says) -> None:
    controller = LaggingController(HOME, **fault)
    run = played(tmp_path, controller, relative=relative)
    assert run.failure is not None
    assert re.search(says, run.failure), run.failure
    assert "stopped on the path at" in run.failure
    assert 40 < len(run.recording.t) < run.rows
    assert np.all(largest_acceleration(controller) <= 1.0), largest_acceleration(controller)
    # At rest in the end, also where the controller adds up.
    assert np.max(np.abs(np.diff(controller.commanded[-5:], axis=0))) < 1e-3


def test_an_arm_measured_elsewhere_than_commanded_is_not_moved(tmp_path: Path) -> None:
    controller = LaggingController(HOME, measured=lambda _, angles: angles + 30.0 * np.eye(6)[2])
    with pytest.raises(IdealRobotError, match=r"axis 3 is measured at .* before anything was sent"):
        played(tmp_path, controller)
    assert all(np.array_equal(row, HOME) for row in controller.commanded)


def test_one_reading_that_cannot_be_is_missing_and_said(tmp_path: Path) -> None:
    run = played(tmp_path, LaggingController(HOME, measured=lambda k, angles: angles + (40.0 * (k == 70))))
    assert run.failure is None
    assert run.counts["implausible"] == 1


def test_a_loop_that_answers_slowly_is_no_fault(tmp_path: Path) -> None:
    assert played(tmp_path, LaggingController(HOME, lag=0.09)).failure is None


@pytest.mark.parametrize(("rise", "says"), [
    (1, "rise by 1 a packet"), (0, "do not rise"), pytest.param(None, "rise by 12 ms", marks=pytest.mark.slow)])
def test_how_time_stamps_rise_is_found(tmp_path: Path, rise: int | None, says: str) -> None:
    # In lockstep packets come as fast as they are answered, which on a real arm would be another cycle.
    run = played(tmp_path, LaggingController(HOME, rise=rise),
                 lambda server: setattr(server.link, "too_fast", np.inf))
    assert run.failure is None
    assert says in run.stamps
    np.testing.assert_allclose(np.diff(run.recording.t), ROBOT.t_ipo, atol=1e-9)


def test_a_much_faster_pace_than_expected_is_refused_where_stamps_do_not_tell(tmp_path: Path) -> None:
    run = played(tmp_path, LaggingController(HOME, rise=1))
    assert run.failure is not None
    assert "12 ms are expected" in run.failure
    assert "--cycle" in run.failure


LOSSES = {"one late answer": {"late": lambda k: k == 150},
          "5 % lost": {"lost": lambda k: k > 20 and (k * 2654435761) % 2**32 < 0.05 * 2**32},
          "5 % late": {"late": lambda k: k > 20 and (k * 2654435761) % 2**32 < 0.05 * 2**32}}


@pytest.mark.parametrize(("mode", "cycle", "loss"), [
    pytest.param(mode, cycle, loss, marks=() if cycle > 0.01 and loss in losses else pytest.mark.slow)
    for mode, losses in (("absolute", ("50 ms stalls",)), ("increments", ("5 % lost",)),
                         ("increments held on", ("one late answer", "5 % late", "50 ms stalls")))
    for cycle in (0.012, 0.004) for loss in (*LOSSES, "50 ms stalls")])
def test_what_is_missed_is_made_good_within_the_limits(tmp_path: Path, mode: str, cycle: float, loss: str) -> None:
    stall = {"held_back": lambda k: k % round(0.4 / cycle) < round(0.048 / cycle) and k > 20}
    controller = LaggingController(HOME, cycle=cycle, adds_up=mode != "absolute",
                                   goes_on=mode == "increments held on", **LOSSES.get(loss, stall))
    run = played(tmp_path, controller, relative=mode != "absolute", method="ideal",
                 form=RsiFormat(hold_on=mode != "increments"))
    assert run.failure is None
    assert run.counts["late"] + run.counts["lost"] > 0
    commanded = np.radians(controller.commanded)
    # The arm gets where it was to go, however many answers were missed.
    np.testing.assert_allclose(commanded[-1] * SIGN, run.recording.joints("q_c")[-1], atol=1e-5)
    speed = np.diff(commanded, axis=0) / cycle
    bend = np.diff(speed, axis=0) / cycle
    if mode == "increments held on":
        assert np.all(np.abs(bend).max(axis=0) <= ROBOT.a_max), np.abs(bend).max(axis=0) / ROBOT.a_max
    else:
        # A controller that holds stops the arm at once by itself; what is ours is everything else.
        own = np.abs(speed[1:]) > 1e-12
        assert np.all((np.abs(bend) * own).max(axis=0) <= ROBOT.a_max), (np.abs(bend) * own).max(axis=0) / ROBOT.a_max
    assert np.all(np.abs(speed) <= 1.6 * np.abs(np.diff(motion(), axis=0)).max(axis=0) / ROBOT.t_ipo + 0.1)


def test_absolute_corrections_that_the_controller_gives_up_are_refused(tmp_path: Path) -> None:
    with pytest.raises(IdealRobotError, match="return to the start"):
        played(tmp_path, LaggingController(HOME), form=RsiFormat(hold_on=False))


def test_increments_whose_loss_no_one_tells_are_found_at_rest(tmp_path: Path) -> None:
    """Without ``Delay`` a late increment is lost unnoticed; the measured arm at rest tells where it led."""
    controller = LaggingController(HOME, adds_up=True, tells_delay=False, late=lambda k: k in (75, 90),
                                   lost=lambda k: k == 80)
    run = played(tmp_path, controller, relative=True)
    assert run.failure is None
    assert run.counts["resynchronised"] == 1
    np.testing.assert_allclose(np.radians(controller.commanded[-1]) * SIGN, ROBOT.home, atol=1e-3)
    assert np.all(largest_acceleration(controller)[:3] < 20.0)


def test_the_port_that_fails_ends_the_run_and_keeps_the_recording(tmp_path: Path) -> None:
    class Failing:
        def __init__(self, wrapped: socket.socket) -> None:
            self.wrapped, self.reads, self.sent = wrapped, 0, 0

        def __getattr__(self, name: str):
            return getattr(self.wrapped, name)

        def recvfrom(self, *sizes: int):
            return self._read(self.wrapped.recvfrom, sizes)

        def recvmsg(self, *sizes: int):
            return self._read(self.wrapped.recvmsg, sizes)

        def _read(self, read, sizes: tuple[int, ...]):
            self.reads += 1
            if self.reads > 150:
                raise OSError(100, "Network is down")
            return read(*sizes)

        def send(self, data: bytes) -> None:
            self.wrapped.send(data)
            self.sent += 1
            if self.sent % 10 == 0:
                raise OSError(105, "No buffer space available")

    def failing(server: RsiServer) -> None:
        link, begin = server.link._link, server.link._link._begin_with

        def begin_failing(peer: tuple[str, int]) -> None:
            begin(peer)
            link._socket = Failing(link._socket)  # type: ignore[assignment]

        link._begin_with = begin_failing  # type: ignore[method-assign]

    run = played(tmp_path, LaggingController(HOME), failing)
    assert run.failure is not None
    assert "Network is down" in run.failure
    assert run.counts["unsent"] > 0
    assert len(run.recording.t) > 30


def test_sigterm_brakes_like_ctrl_c(tmp_path: Path) -> None:
    def terminate(k: int, at: Array) -> Array:
        if k == 75:
            os.kill(os.getpid(), signal.SIGTERM)
        return at

    controller = LaggingController(HOME, measured=terminate)
    with rsi_server(written(tmp_path, motion()), robot="kr6", method="none", port=0, rest=0.4) as server:
        server.link.timeout = PATIENCE
        with playing(controller, server.link.address), stopping_on_signals(
                server.stop, lambda: server.link.counts.cycles > 0):
            run = server.play(patience=PATIENCE)
    assert run.failure == "stopped by the system (SIGTERM)"
    assert 70 < len(run.recording.t) < run.rows
    assert np.all(largest_acceleration(controller) <= 1.0)
    assert np.max(np.abs(np.diff(controller.commanded[-5:], axis=0))) < 1e-6


def test_nothing_is_collected_while_an_arm_waits_and_nothing_is_left_to_collect(tmp_path: Path) -> None:
    before = gc.isenabled()
    states = []
    with rsi_server(written(tmp_path, motion()), robot="kr6", method="ideal", port=0, rest=0.4) as server:
        server.link.timeout = PATIENCE
        receive = server.link.receive

        def counted():
            if server.link.counts.cycles in (60, 120):
                states.append((gc.isenabled(), gc.collect()))
            return receive()

        server.link.receive = counted  # type: ignore[method-assign]
        with playing(LaggingController(HOME), server.link.address):
            assert server.play(patience=PATIENCE).failure is None
    assert [enabled for enabled, _ in states] == [False, False]
    # Sixty cycles leave no more circles than one could: garbage by the cycle would need the collection.
    assert states[1][1] < 20
    assert gc.isenabled() == before


def test_a_controller_that_no_one_answers_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from sim.devices import rsi_controller

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        path = written(tmp_path, motion())
        port = str(silent.getsockname()[1])
        assert rsi_controller.main([str(path), "--port", port, "--patience", "2"]) == 1
    assert "0 of" in capsys.readouterr().out


@pytest.mark.slow
def test_an_hour_at_four_milliseconds_has_no_end_of_our_own_making() -> None:
    with pytest.raises(typer.Exit) as ended:
        rsi_hour(60.0, virtual=True)
    assert ended.value.exit_code == 0


# A network that is not friendly: whatever comes from elsewhere, the commands are those of an undisturbed run.

def test_thousands_of_mutated_packets_are_refused_or_wholly_sound() -> None:
    rng = np.random.default_rng(16)
    sound, messages = 0, set()
    for _ in range(6000):
        try:
            message = parse_rob(mutated(PACKET, rng), 6)
        except PacketError as error:
            messages.add(str(error))
            continue
        sound += 1
        assert 0 <= message.ipoc < 10**18
        assert all(v is None or (v.shape == (6,) and np.isfinite(v).all())
                   for v in (message.actual, message.setpoint, message.current))
    # What a terminal will show has to be short and without control characters.
    assert all(len(text) < 300 and text.isprintable() for text in messages)
    # The mutator must leave some sound, or nothing beyond the first check was tried.
    assert 6 < sound < 5400


def run_of(folder: Path, controller: LaggingController, attacked: bool) -> RsiRun:
    rng = np.random.default_rng(5)
    with (rsi_server(written(folder, motion()), robot="kr6", method="none", port=0, rest=0.4) as server,
          socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger):
        server.link.timeout = PATIENCE
        address, last = server.link.address, [b""] * 8

        def beside(k: int, packet: bytes) -> list[bytes]:
            if not attacked or k == 0:
                return []
            last[k % 8] = packet
            for _ in range(40):
                stranger.sendto(mutated(packet, rng), address)
            stranger.sendto(packet, address)
            # From the controller's own address: what is broken, and what is old, in any order.
            return [packet[:200], b"<Rob>" + b"<a>" * 500, *(last[i] for i in rng.permutation(8) if last[i] != packet)]

        controller.beside = beside
        with playing(controller, address):
            return server.play(patience=PATIENCE)


@pytest.mark.parametrize("relative", [pytest.param(False, marks=pytest.mark.slow), True])
def test_no_command_changes_by_strangers_replays_and_rubbish(tmp_path: Path, relative: bool) -> None:
    quiet, attacked = LaggingController(HOME), LaggingController(HOME)
    quiet_run, run = run_of(tmp_path, quiet, False), run_of(tmp_path, attacked, True)
    assert run.failure is None
    assert quiet_run.failure is None
    assert run.counts["foreign"] > 100 * 41
    assert run.counts["refused"] > 200
    assert run.counts["outdated"] > 500
    N = min(len(quiet.commanded), len(attacked.commanded)) - 1
    np.testing.assert_array_equal(attacked.commanded[:N], quiet.commanded[:N])


def test_memory_does_not_grow_with_what_is_refused() -> None:
    rng = np.random.default_rng(6)
    packets = [mutated(PACKET, rng) for _ in range(500)]

    def all_of_them() -> None:
        for packet in packets:
            try:
                parse_rob(packet, 6)
            except PacketError:
                continue

    all_of_them()
    gc.collect()
    gc.disable()
    tracemalloc.start()
    try:
        all_of_them()
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(5):
            all_of_them()
        assert tracemalloc.get_traced_memory()[0] - before < 2_000
    finally:
        tracemalloc.stop()
        gc.enable()


def test_only_the_controller_that_was_named_is_listened_to(tmp_path: Path) -> None:
    with (rsi_server(written(tmp_path, motion()), robot="kr6", method="none", port=0, controller="10.0.0.7") as server,
          socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger):
        stranger.sendto(PACKET, server.link.address)
        with pytest.raises(Exception, match="no packet from the controller"):
            server.play(patience=0.2)
        assert server.link.counts.foreign == 1


def test_a_server_listens_on_loopback_unless_told_otherwise(tmp_path: Path) -> None:
    with rsi_server(written(tmp_path, motion()), robot="kr6", method="none", port=0) as server:
        assert server.link.address[0] == "127.0.0.1"
