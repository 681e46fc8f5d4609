"""EGM against a controller written from ABB's manual, which is judged in turn by two clients of others."""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.egm import EgmError, EgmRobot
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from scenes.online.live_arm import at_cycle
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices import egm_controller
from sim.devices.egm_controller import EgmController, EgmRun, packed, robot_message, sensor_joints, unpacked
from tests.sim.devices.controllers import PATIENCE
from tests.sources import free_port

pytest.importorskip("abb_robot_client", reason="pip install 'ideal-robot[egm]'")
ROBOT = at_cycle(Robot.load("kr6"), 0.004)
T = ROBOT.t_ipo


@contextmanager
def simulated() -> Iterator[SimulatedArm]:
    """An arm whose compiled code is loaded: no answer waits for it."""
    with SimulatedArm(ROBOT, World.ideal("kr6").replace(t_ipo=T), np.random.default_rng(1)) as arm:
        arm.cycle(arm.truth.q_m)
        yield arm


@contextmanager
def led(cycles: int = 1_000_000, change: Callable[[EgmController], None] = lambda controller: None,
        robot: Robot = ROBOT, **options: Any) -> Iterator[tuple[EgmRobot, EgmController, Future[EgmRun]]]:
    """A link that is connected to a controller in a thread."""
    with simulated() as arm, EgmRobot(robot, port=0, timeout=PATIENCE) as link:
        controller = EgmController(arm, link.address, **{"timeout": PATIENCE, **options})
        link.clocked = controller.timeout is None
        change(controller)
        with ThreadPoolExecutor(1) as pool:
            future = pool.submit(controller.run, cycles)
            try:
                link.connect(PATIENCE)
                yield link, controller, future
            finally:
                controller.stop()
                wait([future], PATIENCE)


def way(k: int, span: int = 100) -> Array:
    u = min(k / span, 1.0)
    return np.asarray(ROBOT.home + 0.1 * u**3 * (10 - 15 * u + 6 * u**2))


def follow(link: EgmRobot, cycles: int, between: Callable[[int], None] = lambda k: None) -> list[Any]:
    states = []
    for k in range(cycles):
        between(k)
        states.append(link.cycle(way(k)))
    return states


def test_what_is_loaded_before_the_first_command_costs_nothing() -> None:
    """In true time: the controller holds the arm meanwhile, longer than messages may be lost later."""
    with led(timeout=None) as (link, _, _):
        time.sleep((link.max_lost + 30) * T)
        link.cycle(ROBOT.home)
        assert link.counts.lost == 0
        assert link.settled


def test_an_arm_that_was_moved_before_the_first_command_is_not_torn_back() -> None:
    """In true time: messages come whether they are answered or not."""
    with led(timeout=None) as (link, controller, _):
        moved = controller.message
        controller.message = lambda k, state, planned: moved(  # type: ignore[method-assign]
            k, replace(state, q=state.q + 0.02), planned)
        time.sleep(10 * T)
        with pytest.raises(EgmError, match=r"joint \d has moved by 1\.15° since the controller was reached"):
            link.cycle(ROBOT.home)


def test_commands_arrive_as_they_were_sent_and_time_is_the_controllers() -> None:
    with led() as (link, controller, future):
        states = follow(link, 150)
        controller.stop()
        run = future.result(PATIENCE)
    np.testing.assert_allclose(np.array(run.commands)[:150], [way(k) for k in range(150)], atol=1e-12)
    np.testing.assert_allclose(np.diff([state.t for state in states]), T, atol=1e-12)
    np.testing.assert_allclose(states[-1].q, way(150), atol=1e-3)
    np.testing.assert_allclose(states[50].columns["q_set"], way(50), atol=1e-12)
    assert np.isnan(states[-1].tau).all()
    assert np.isnan(states[-1].columns["fx"])


def test_a_wrench_that_the_controller_measures_is_told() -> None:
    force = np.array([1.0, -2.0, 30.0, 0.1, 0.2, 0.3])
    with led(change=lambda controller: setattr(controller, "force", force)) as (link, *_):
        state = follow(link, 3)[-1]
    assert [state.columns[name] for name in ("fx", "fy", "fz", "mx", "my", "mz")] == force.tolist()


def test_lost_doubled_and_broken_messages_delay_the_path_and_skip_nothing() -> None:
    def disturbance(cycle: int, message: bytes) -> list[bytes]:
        if cycle in (40, 41, 60):
            return []
        return [message, message] if cycle % 7 == 0 else [b"\xff", message[:9], message]

    with led(change=lambda controller: setattr(controller, "disturbance", disturbance)) as (link, controller, future):
        # Until what was missed is made good.
        follow(link, 600)
        controller.stop()
        run = future.result(PATIENCE)
    assert link.counts.lost == 3
    assert link.counts.refused > 100
    acceleration = np.diff(np.array(run.commands), 2, axis=0) / T**2
    assert np.abs(acceleration).max() < 2.0 * np.max(ROBOT.a_max)
    np.testing.assert_allclose(run.commands[-1], way(600), atol=1e-9)


def test_another_sender_is_not_listened_to() -> None:
    import socket

    with led() as (link, *_), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        follow(link, 10, lambda k: other.sendto(robot_message(k, 0, np.zeros(6), np.zeros(6)), link.address) and None)
    assert link.counts.foreign == 10


@pytest.mark.parametrize(("change", "says"), [
    (lambda c: setattr(c, "motors", egm_controller.OFF), "motors are off"),
    (lambda c: setattr(c, "rapid", egm_controller.RAPID_STOPPED), "program does not run"),
    (lambda c: setattr(c, "mci", egm_controller.MCI_ERROR), "reports an error"),
    (lambda c: setattr(c, "mci", egm_controller.MCI_STOPPED), "EGMRunJoint")])
def test_a_stop_of_the_controller_is_said(change: Callable, says: str) -> None:
    with led() as (link, controller, _), pytest.raises(EgmError, match=says):
        follow(link, 60, lambda k: change(controller) if k == 20 else None)


def test_an_arm_that_is_not_given_to_us_is_not_led() -> None:
    with simulated() as arm, EgmRobot(ROBOT, port=0) as link:
        controller = EgmController(arm, link.address, timeout=0.01)
        controller.mci = egm_controller.MCI_STOPPED
        with ThreadPoolExecutor(1) as pool:
            pool.submit(controller.run)
            with pytest.raises(EgmError, match="EGMRunJoint"):
                link.connect(1.0)
            controller.stop()


def test_silence_and_another_cycle_are_said() -> None:
    with EgmRobot(ROBOT, port=0) as nobody, pytest.raises(EgmError, match="UDPUC"):
        nobody.connect(0.1)
    with led(change=lambda controller: None, robot=at_cycle(ROBOT, 0.008)) as (link, *_), pytest.raises(
            EgmError, match="every 4 ms, 8 ms are expected"):
        follow(link, 60)


def test_an_address_in_use_and_an_arm_that_does_not_fit() -> None:
    with EgmRobot(ROBOT, port=0) as first, pytest.raises(InputError, match="cannot listen"):
        EgmRobot(ROBOT, port=first.address[1])
    slides = replace(ROBOT, pinocchio=_sliding())
    with pytest.raises(InputError, match="that turn"):
        EgmRobot(slides, port=0)


def _sliding() -> Any:
    import pinocchio as pin

    model = pin.Model()
    for i in range(6):
        model.addJoint(i, pin.JointModelPZ(), pin.SE3.Identity(), f"j{i}")
    return model


@pytest.mark.parametrize("seed", range(5))
def test_messages_survive_their_wire(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-360, 360, 6 + seed % 2)
    joints = [(1, float(angle)) for angle in angles[:6]]
    external = [(3, packed([(1, float(angle)) for angle in angles[6:]]))] if len(angles) > 6 else []
    message = packed([(1, packed([(1, 5), (2, 77), (3, 3)])), (2, packed([(1, packed(joints)), *external]))])
    np.testing.assert_array_equal(sensor_joints(message), angles)
    # Repeated numbers may also come packed, and other kinds of messages are none of ours.
    together = packed([(1, packed([(3, 3)])), (2, packed([(1, packed([(1, angles[:6].astype("<f8").tobytes())]))]))])
    np.testing.assert_array_equal(sensor_joints(together), angles[:6])
    for cut in rng.integers(1, len(message), 20):
        broken = sensor_joints(message[:cut])
        assert broken is None or len(broken) <= len(angles)
    assert sensor_joints(packed([(1, packed([(3, 2)]))])) is None
    assert list(unpacked(packed([(1, 2**31), (2, -1.5)]))) == [(1, 2**31), (2, -1.5)]


CLIENT = """
import sys
import numpy as np
from {module} import EGM
egm, sent = EGM({port}), None
print("listens", flush=True)
begin = None
for k in range(60):
    ok, state = egm.receive_from_robot(5.0)
    assert ok and state.motors_on and state.rapid_running, state
    angles = np.array(state.joint_angles)
    begin = angles if begin is None else begin
    assert angles.shape == (6,)
    assert np.abs(np.array(state.joint_angles_planned) - (begin if sent is None else sent)).max() < 1e-9
    sent = begin + 0.05 * k
    assert egm.send_to_robot(sent)
print("moved", np.array(state.joint_angles) - begin, flush=True)
"""


@pytest.mark.parametrize("module", ["abb_robot_client.egm", "ABBRobotEGM"])
def test_clients_of_others_lead_our_controller(module: str) -> None:
    if importlib.util.find_spec(module.split(".")[0]) is None:
        pytest.skip(f"{module} is not installed")
    port = free_port(socket.SOCK_DGRAM)
    client = subprocess.Popen([sys.executable, "-c", CLIENT.format(module=module, port=port)], stdout=subprocess.PIPE,
                              stderr=subprocess.PIPE, text=True)
    assert client.stdout is not None
    client.stdout.readline()
    with simulated() as arm:
        run = EgmController(arm, ("127.0.0.1", port), timeout=PATIENCE).run(60)
    out, err = client.communicate(timeout=PATIENCE)
    assert client.returncode == 0, err
    assert "moved" in out
    np.testing.assert_allclose(np.degrees(run.commands[-1] - run.commands[0]), 0.05 * 59, atol=1e-9)
