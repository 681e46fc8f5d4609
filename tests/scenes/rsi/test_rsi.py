"""``ideal-robot rsi``: the ideal robot behind RSI, on loopback, against a controller around the simulated arm."""

from __future__ import annotations

import gc
import json
import socket
import sys
from concurrent.futures import Future
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ideal_robot.arrays import Array
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.feedforward.method import Needs
from ideal_robot.feedforward.registry import register, unregister
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.online.live_arm import answers_within, response_of
from scenes.online.processes import undisturbed
from scenes.rsi.self_test import held_cycles
from scenes.rsi.server import RsiRun, RsiServer, _require_better, prepared, rsi_server
from scenes.scene_files.scene import SceneError
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.rsi_controller import ControllerRun
from studies.rsi import SIMULATORS, home_of
from studies.rsi import played as played_on
from tests.sim.devices.controllers import ENDLESS, PATIENCE, controlled
from tests.sources import ROOT, free_port

ROBOT = Robot.load("kr6")
T = ROBOT.t_ipo
REST = 50


def motion(cycles: int = 100) -> Array:
    """Every joint once out and back."""
    phase = np.pi * np.arange(cycles) / (cycles - 1)
    return np.asarray(ROBOT.home + np.sin(phase)[:, None] ** 4 * np.array([0.3, -0.2, 0.25, 0.4, -0.3, 0.5]))


def written(folder: Path, q: Array) -> Path:
    path = folder / "path.csv"
    pd.DataFrame({"t": T * np.arange(len(q)), **{f"q_d_{i + 1}": q[:, i] for i in range(6)}}).to_csv(path, index=False)
    return path


def played(path: Path, *, start: Array = ROBOT.home, cycles: int | None = None, relative: bool = False,
           method: str = "ideal", server_change=lambda server: None, **options) -> tuple[RsiRun, ControllerRun]:
    with ExitStack() as stack:
        server = stack.enter_context(rsi_server(path, robot="kr6", method=method, port=0, relative=relative,
                                                rest=REST * T))
        server.link.timeout = PATIENCE
        server_change(server)
        arm = stack.enter_context(SimulatedArm(ROBOT, World.default("kr6"), np.random.default_rng(1), q0=start))
        future: Future[ControllerRun]
        cycles = cycles or len(server.q_d) + 1
        with controlled(arm, server.link.address[1], cycles, relative=relative, **options) as future:
            run = server.play(patience=PATIENCE)
        return run, future.result(PATIENCE)


@pytest.mark.parametrize("relative", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_arm_behind_rsi_follows_better_than_without(tmp_path: Path, relative: bool) -> None:
    path = written(tmp_path, motion())
    run, controller = played(path, relative=relative)
    plain, _ = played(path, relative=relative, method="none")
    assert run.failure is None
    assert plain.failure is None
    assert controller.answered.all()
    assert run.counts == {**run.counts, "lost": 0, "repeated": 0, "refused": 0, "late": 0, "foreign": 0, "outdated": 0}
    assert len(run.recording.t) == run.rows == len(controller.commands) - 1
    # The model is of the motor and the gear; what the controller tells are motor angles.
    assert np.all(run.errors_mrad() < 0.5 * plain.errors_mrad())
    q_c = run.recording.joints("q_c") * [-1, 1, 1, -1, 1, -1]
    np.testing.assert_allclose(np.radians(controller.commands[1:]), q_c, atol=1e-8)
    back = Recording.read(run.recording.write(tmp_path / "moved.parquet"))
    assert back.has("tau")
    assert back.has("current")
    assert back.meta["corrections"] == ("relative" if relative else "absolute")
    np.testing.assert_allclose(np.diff(back.t), T, atol=1e-9)


def test_an_arm_beside_the_start_is_led_onto_the_path(tmp_path: Path) -> None:
    beside = ROBOT.home + np.radians(0.3)
    run, _ = played(written(tmp_path, motion()), start=beside, method="none")
    assert run.failure is None
    q_d = run.recording.joints("q_d")
    np.testing.assert_allclose(q_d[0], beside, atol=1e-6)
    np.testing.assert_allclose(q_d[REST:REST + 100], motion(), atol=1e-9)
    assert np.max(np.abs(np.diff(q_d, axis=0))) < np.max(np.abs(np.diff(motion(), axis=0))) + 1e-9


def test_an_arm_that_stands_elsewhere_is_not_moved(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"joint 1 stands at 2\.\d+°.*starts at 0\.00°"):
        played(written(tmp_path, motion()), start=ROBOT.home + 0.04 * np.eye(6)[0], cycles=ENDLESS)


def test_lost_and_repeated_packets_delay_the_path_and_skip_nothing(tmp_path: Path) -> None:
    def disturbance(cycle: int, packet: bytes) -> list[bytes]:
        return [] if cycle in (60, 70, 71) else [packet, packet] if cycle % 40 == 7 else [b"<Rob/>", packet]

    path = written(tmp_path, motion())
    run, controller = played(path, cycles=REST + 100 + 25 + 4, method="none", disturbance=disturbance)
    assert run.failure is None
    assert run.counts["lost"] == controller.answered.size - controller.answered.sum() == 3
    assert run.counts["repeated"] > 0
    assert run.counts["refused"] > 100
    np.testing.assert_allclose(run.recording.joints("q_d")[REST:REST + 100], motion(), atol=1e-9)
    np.testing.assert_allclose(np.sort(np.diff(run.recording.t))[-3:], [T, 2 * T, 3 * T], atol=1e-9)
    assert run.recording.t[-1] == pytest.approx((run.rows + 3) * T)


class Jump(PassThrough):
    """Commands a jump in mid-path, as a broken model would."""

    def init(self, q0: Array) -> int:
        return 0

    def step(self, state: int, q_d: Array, tau_ext_d: Array | None = None) -> tuple[Array, int]:
        return q_d[0] + (0.1 if state == 80 else 0.0), state + 1


def rest_reached(run: RsiRun) -> None:
    """The arm is at rest on the path at the end, and nothing commanded before left the limits."""
    q_c, q_d = run.recording.joints("q_c"), run.recording.joints("q_d")
    speed = np.diff(q_c, axis=0) / T
    assert np.all(np.abs(speed) <= ROBOT.v_max + 1e-9)
    assert np.all(np.abs(np.diff(speed, axis=0)) / T <= 2 * ROBOT.a_max + 1e-6)
    np.testing.assert_allclose(q_d[-20:], q_d[-1:].repeat(20, axis=0), atol=1e-9)
    # A feedforward may still fade, at less than a hundredth of the speed on the path.
    assert np.max(np.abs(speed[-10:])) < 0.01 * np.max(np.abs(np.diff(motion(), axis=0))) / T
    # Every desired position lies on the path: at some share between two of its points.
    ends = np.vstack([motion(), motion()[-1:]])
    for row in q_d[REST::5]:
        nearest = int(np.argmin(np.linalg.norm(ends - row, axis=1)))
        assert np.max(np.abs(ends[nearest] - row)) <= np.max(np.abs(np.diff(motion(), axis=0)))


def test_a_command_outside_the_limits_stops_the_arm_on_the_path_and_says_why(tmp_path: Path) -> None:
    run, controller = played(written(tmp_path, motion()), cycles=ENDLESS,
                             server_change=lambda server: setattr(server, "feedforward", Jump(T)))
    assert run.failure is not None
    assert "stopped on the path at 0.960 s: joint" in run.failure
    assert "velocity" in run.failure
    assert 80 < len(run.recording.t) < run.rows
    assert controller.answered[:-1].all()
    rest_reached(run)


def test_stop_brings_the_arm_to_rest_on_the_path(tmp_path: Path) -> None:
    def stopping(server: RsiServer) -> None:
        receive = server.link.receive

        def counted():
            if server.link.counts.cycles == 75:
                server.stop("stopped by the user")
            return receive()

        server.link.receive = counted  # type: ignore[method-assign]

    run, _ = played(written(tmp_path, motion()), cycles=ENDLESS, server_change=stopping)
    assert run.failure == "stopped by the user"
    rest_reached(run)


def test_a_controller_that_falls_silent_ends_the_run_and_keeps_the_recording(tmp_path: Path) -> None:
    run, _ = played(written(tmp_path, motion()), cycles=70,
                    server_change=lambda server: setattr(server.link, "timeout", 1.0))
    assert run.failure is not None
    assert "no packet from the controller within 1 s" in run.failure
    assert len(run.recording.t) == 69


def test_the_command_line_plays_a_path_and_writes_what_json_names(program, tmp_path: Path) -> None:
    written(tmp_path, motion())
    port = free_port(socket.SOCK_DGRAM)
    with (SimulatedArm(ROBOT, World.default("kr6"), np.random.default_rng(1)) as arm,
          controlled(arm, port, timeout=0.5, patience=100)):
        done = program("rsi", "path.csv", "--robot", "kr6", "--port", str(port), "--record", "moved.parquet", "--json",
                       "figures.json")
    assert done.code == 0, done.err
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert figures["failure"] is None
    assert figures["robot"] == "kr6"
    assert figures["method"] == "ideal"
    assert figures["cycles"] == figures["path_cycles"] == len(Recording.read(figures["files"]["recording"]).t)
    assert set(figures["answer_time_ms"]) == {"median", "p99", "max"}
    assert len(figures["motor_rms_error_mrad"]) == 6


@pytest.mark.parametrize(("options", "says"), [
    ({"method": "magic"}, "expected one of"),
    ({"rest": -1.0}, "0 to 60"),
    ({"cycle": 0.0125}, "whole milliseconds"),
    ({"robot": "kr500"}, "no model is shipped"),
    ({"robot": None}, "--robot"),
    ({"model": Path("missing.json")}, "no such model"),
    ({"host": "no address"}, "cannot listen"),
])
def test_what_cannot_be_used_is_named_before_anyone_is_waited_for(tmp_path: Path, options, says: str) -> None:
    path = written(tmp_path, motion())
    with (pytest.raises(InputError, match=says), rsi_server(path, **{"robot": "kr6", "port": 0, **options})):
        pass


def test_a_path_outside_the_limits_is_refused(tmp_path: Path) -> None:
    with (pytest.raises(IdealRobotError, match="velocity"),
          rsi_server(written(tmp_path, motion()[::5]), robot="kr6", port=0)):
        pass


def test_missing_samples_are_told_before_the_controller_is_waited_for(program, tmp_path: Path) -> None:
    path, q = tmp_path / "path.csv", motion(400)
    pd.DataFrame({"t": T * np.arange(400.0), **{f"q_d_{i + 1}": q[:, i] for i in range(6)}}).drop(
        index=range(100, 103)).to_csv(path, index=False)
    done = program("rsi", "path.csv", "--robot", "kr6", "--method", "none", "--port", "0", "--wait", "0.1", "--record",
                   "r.csv")
    assert done.code == 1
    assert done.err.index("warning: bridged: 1 times") < done.err.index("waiting for the controller")


@pytest.mark.parametrize("seconds", ["1e20", "nan", "-1"])
def test_a_wait_that_never_ends_is_refused(program, seconds: str) -> None:
    done = program("rsi", "p.csv", "--robot", "kr6", "--wait", seconds)
    assert done.code == 2
    assert "--wait" in done.err


# Another cycle than the robot's: the identified loop is brought to it, or it is said why not.

@pytest.mark.parametrize("cycle_ms", [1, 4, 40, *(pytest.param(ms, marks=pytest.mark.slow) for ms in (5, 8, 12))])
def test_the_ideal_robot_is_one_at_every_cycle(cycle_ms: int) -> None:
    arm, law, model, _ = prepared(robot="kr6", cycle=1e-3 * cycle_ms)
    assert model is not None
    loop = loop_model(model, arm)
    assert law.t_ipo == arm.t_ipo == loop.t_ipo == pytest.approx(1e-3 * cycle_ms)
    t = np.arange(0.0, 2.4, arm.t_ipo)
    shape = np.sin(np.pi * np.clip((t - 0.6) / 1.2, 0.0, 1.0))[:, None] ** 4
    q_d = arm.home + shape * np.array([0.3, -0.2, 0.25, 0.4, -0.3, 0.5])
    off = [np.sqrt(np.mean((q_d - simulate(loop, q_c).q_a[:-1])[t > 0.6] ** 2)) for q_c in (law.along(q_d), q_d)]
    assert off[0] < 0.1 * off[1]
    assert 0.02 < answers_within(response_of(model, arm), arm.t_ipo) < 0.6


def test_a_correction_that_makes_it_worse_is_refused_with_what_to_do() -> None:
    arm, law, model, file = prepared(robot="kr6", cycle=0.004)
    assert model is not None
    loop = loop_model(model, arm)
    q_d = arm.home + 0.01 * np.sin(np.linspace(0.0, np.pi, 300))[:, None] ** 4

    class Wrong(PassThrough):
        def step(self, state, q_d, tau_ext_d=None):
            return q_d[0] + 0.05, None

    with pytest.raises(InputError, match=r"identify the arm at it.*--method none"):
        _require_better(Wrong(arm.t_ipo), loop, q_d, file)
    _require_better(law, loop, q_d, file)


def test_the_self_test_hears_of_every_packet() -> None:
    held = held_cycles(method="none", seconds=0.4, cycles_ms=(12,))
    (test,) = held.tests
    assert test.failure is None
    assert len(test.delays_ms) == 33
    assert np.isfinite(test.delays_ms).sum() > 0
    assert {"shortest_cycle_ms", "granted", "cycles"} <= held.json().keys()
    assert len(held.reasons()) >= 2
    assert len(held.table()[1]) == 1


def test_what_was_granted_is_given_back() -> None:
    gc.unfreeze()
    before = gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval()
    with undisturbed() as granted:
        assert not gc.isenabled()
        assert granted
        # Of two blocks one within the other what is put aside stays so until the outer one ends.
        with undisturbed():
            pass
        assert gc.get_freeze_count() > 0
    assert (gc.isenabled(), gc.get_freeze_count(), sys.getswitchinterval()) == before
    gc.freeze()


def test_a_method_of_another_package_is_served() -> None:
    register("mine", lambda setting: PassThrough(setting.robot.t_ipo), description="mine", needs=Needs.NOTHING)
    try:
        arm, law, model, _ = prepared(robot="kr6", method="mine")
    finally:
        unregister("mine")
    assert isinstance(law, PassThrough)
    assert law.t_ipo == arm.t_ipo
    assert model is None


@pytest.mark.parametrize("method", ["trained", "learned-1", "learned-model", "precorrected_1", "unheard_of"])
def test_methods_that_need_more_than_a_model_are_refused(method: str) -> None:
    with pytest.raises(InputError, match=r"expected one of none, precorrected, ideal|is a setting of a method today"):
        prepared(robot="kr6", method=method)


def test_the_kr6_keeps_its_own_cycle_where_none_is_given() -> None:
    assert prepared(robot="kr6", method="none")[0].t_ipo == Robot.load("kr6").t_ipo


# Our server against the controller's side as others wrote it, where their simulators lie beside the repository.

FOLDER = ROOT.parent / "shared" / "rsi-simulators"


@pytest.mark.parametrize("name", [pytest.param(name, marks=() if k < 2 else pytest.mark.slow)
                                  for k, name in enumerate(SIMULATORS)])
def test_a_public_simulator_is_led_along_the_path(name: str) -> None:
    if home_of(FOLDER, name) is None:
        pytest.skip(f"{SIMULATORS[name].file} is neither in ../shared/rsi-simulators nor installed")
    run = played_on(FOLDER, name, method="none", seconds=0.8)
    assert run.failure is None
    assert len(run.recording.t) == run.rows
    # They are where they were told to be a cycle before; RSIPI tells two decimals of a degree.
    q, q_c = run.recording.joints("q"), run.recording.joints("q_c")
    assert run.counts["lost"] + run.counts["late"] > 0 or np.abs(q[1:] - q_c[:-1]).max() < 1e-4
    np.testing.assert_allclose(q[-1], q_c[-1], atol=1e-4)
    assert np.ptp(q, axis=0).min() > np.radians(4.0)
