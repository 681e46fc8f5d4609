"""A cell behind any controller: who leads the arm moves it, who falls silent lets it go back for the next one."""

from __future__ import annotations

import os
import threading
import time
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from ideal_robot.arrays import Array
from ideal_robot.interfaces import LinkSettings, connected_arm
from ideal_robot.robots.robot import Robot
from scenes.serve.cell import CONTROLLERS
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.served_arm import Session
from sim.devices.stream_server import Unkindness
from tests.sources import free_port

ROBOT = Robot.load("kr6")
AWAY = np.array([0.05, -0.04, 0.03, 0.06, -0.05, 0.04])
PACKAGES = {"egm": "abb_robot_client", "ros2": "rclpy"}


@contextmanager
def served(scheme: str) -> Iterator[tuple[str, list[Session]]]:
    """A cell in a thread, not in real time: both sides share one interpreter; its address and sessions."""
    at = ("", 0) if scheme == "ros2" else ("127.0.0.1", free_port())
    sessions: list[Session] = []
    with SimulatedArm(ROBOT, World.ideal("kr6"), np.random.default_rng(1)) as arm:
        arm.cycle(arm.truth.q_m)
        arm.reset(ROBOT.home)
        cell = CONTROLLERS[scheme](arm, at, relative=False, unkind=Unkindness(drift=0.0), rng=np.random.default_rng(2),
                                   carried=(), sign=np.ones(6))
        thread = threading.Thread(target=cell.sessions, args=(0, sessions.append))
        thread.start()
        try:
            yield f"{scheme}://" + ("" if scheme == "ros2" else "{}:{}".format(*at)), sessions
        finally:
            cell.stop()
            thread.join(20.0)


def way(share: float) -> Array:
    u = min(share, 1.0)
    return np.asarray(ROBOT.home + AWAY * u**3 * (10 - 15 * u + 6 * u**2))


@pytest.mark.parametrize("scheme", ["egm", pytest.param("ros2", marks=[pytest.mark.slow, pytest.mark.real_time])])
def test_an_arm_is_led_and_goes_back_for_the_next_one(scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip(PACKAGES[scheme])
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    with served(scheme) as (address, sessions):
        for session in (1, 2):
            with connected_arm(address, ROBOT, LinkSettings(bridge=1.0), 20.0) as link:
                np.testing.assert_allclose(link.commanded, ROBOT.home, atol=1e-4)
                for k in range(70):
                    state = link.cycle(way(k / 50))
                np.testing.assert_allclose(state.q, ROBOT.home + AWAY, atol=2e-3)
            due = time.monotonic() + 20.0
            while len(sessions) < session and time.monotonic() < due:
                time.sleep(0.05)
            # Until it is back at the start.
            time.sleep(3.0)
    assert len(sessions) == 2
    for played in sessions:
        np.testing.assert_allclose(played.commands[-1], ROBOT.home + AWAY, atol=1e-6)
        assert "100 ms" in played.ended


def test_a_long_session_holds_the_last_commands_alone_in_memory() -> None:
    """Five minutes at 4 ms; as a list of arrays they took 13 MB, and as much again every five minutes."""
    session, cycles = Session(), 75_000
    tracemalloc.start()
    try:
        for k in range(cycles):
            session.commands.append(np.full(6, float(k)))
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < 3e6
    assert np.array_equal(np.array(session.commands)[:, 0], np.arange(float(cycles)))
    assert session.commands[-2][0] == cycles - 2
