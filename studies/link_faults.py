"""What goes wrong on makers' interfaces while a path is played: what is noticed, how late, and where the arm ends."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer

from ideal_robot.arrays import Array
from ideal_robot.egm import EgmRobot
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.interfaces import LinkSettings
from ideal_robot.robots.address import Address
from ideal_robot.robots.interface import LinkedRobot, RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.ros2.robot import opened
from ideal_robot.stream_motion import StreamMotionRobot
from scenes.online.path_player import PathPlayer
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.egm_controller import MCI_ERROR, RAPID_STOPPED, EgmController
from sim.devices.ros2_arm import Ros2Arm
from studies.other_arms import ANSWER_WITHIN, CRX_DATA, CRX_HOME, answered_cycle, crx_urdf
from studies.report import head, row

BEGINS = 60
"""Cycle of the path in which a fault begins."""
_SHARE = 0.02
"""Of messages, where some are lost or come twice."""
_LATER = 1.0
"""When it is looked where the arm has ended [s]."""
Where = Callable[[Any], Array]
"""Where the arm of a controller is in truth ``(n,)`` [rad]."""
Fault = Callable[[Any, int, np.random.Generator], None]
"""What is done to a controller before a cycle of the path, from ``BEGINS`` on counted from 0."""


def link_faults(interfaces: Annotated[str, typer.Option(help="With commas between.")] = "fanuc,egm,ros2",
                seed: int = 1) -> None:
    """Faults of FANUC's emulator, of EGM and of ROS 2 while a path is played, one each: noticed, how late, the end.

    A controller begins a cycle when the one before was answered: times are the controller's, of silence those of this
    computer; where the program itself brings the arm to rest, the way to rest is in them. The largest acceleration is
    that of the commands in force at the controller, over the arm's limit, with the hold of a controller that misses
    one. Where the arm ends a second later is its distance from the path.

    Args:
        interfaces: which ones.
        seed: of what is lost.
    """
    unknown = [name for name in interfaces.split(",") if name not in FAULTS]
    if unknown:
        raise InputError(f"expected of {', '.join(FAULTS)}", field="--interfaces", value=unknown[0])
    head("interface", "fault", "said", "after [ms]", "acceleration", "from the path [mrad]", "at rest")
    for name in interfaces.split(","):
        for fault in FAULTS[name][2]:
            row(name, fault, *play_link(name, fault, seed))


def play_link(name: str, fault: str, seed: int = 1) -> list[str]:
    """Cells of a row of ``link_faults``: what was said, how late, acceleration, distance from the path, at rest."""
    # Nobody else on this computer shall be heard.
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    arms, where, faults = FAULTS[name]
    with arms() as (link, controller):
        return _played(link, controller, faults[fault], np.random.default_rng(seed), where)


def _played(link: LinkedRobot, controller: Any, begin: Fault, rng: np.random.Generator, where: Where) -> list[str]:
    """Cells of a row: what was said, how late, acceleration, distance from the path, whether at rest."""
    T, home = link.t_ipo, link.commanded.copy()
    u = np.clip(np.arange(round(2.4 / T)) * T / 2.2, 0.0, 1.0)
    q_d = home + 0.25 * np.sin(np.pi * u**3 * (10 - 15 * u + 6 * u**2))[:, None] ** 2
    received, heard, before = link.receive, list[RobotState](), dict[str, int]()

    def receive() -> RobotState:
        if len(heard) >= BEGINS:
            before.update(asdict(link.counts) if len(heard) == BEGINS else {})
            begin(controller, len(heard) - BEGINS, rng)
        heard.append(received())
        return heard[-1]

    link.receive = receive  # type: ignore[method-assign]
    run = PathPlayer(link, PassThrough(T), q_d, 0).played([])
    said, after = run.failure or "nothing", ""
    if run.failure is not None:
        # By the controller's clock as far as it was heard, by this computer's from then on.
        after = f"{1e3 * (heard[-1].t - heard[BEGINS - 1].t + time.perf_counter() - link.arrived):.0f}"
    elif counts := {name: more for name, value in run.counts.items()
                    if (more := value - before.get(name, 0)) and name not in ("cycles", "partial")}:
        said = "counted: " + ", ".join(f"{value} {name}" for name, value in counts.items())
    # Nobody answers any more: its cycles need not be waited for.
    controller.timeout = link.t_ipo
    time.sleep(_LATER)
    ends = where(controller)
    time.sleep(0.1)
    moves = np.max(np.abs(where(controller) - ends))
    away = float(np.min(np.max(np.abs(q_d - ends), axis=1)))
    return [" ".join(said.split()), after, f"{run.details['guard']['acceleration_share']:.2f}", f"{1e3 * away:.1f}",
            "yes" if moves < 1e-4 else "no"]


# FANUC's emulated controller.

@contextmanager
def _fanuc() -> Iterator[tuple[LinkedRobot, Any]]:
    from airo_fanuc.testing import FakeCRXConfig, FakeCRXController

    with TemporaryDirectory() as folder:
        (Path(folder) / "crx10ial.urdf").write_text(crx_urdf(), encoding="utf-8")
        (Path(folder) / "crx10ial.toml").write_text(CRX_DATA, encoding="utf-8")
        robot = Robot.load(Path(folder) / "crx10ial.urdf")
        controller = FakeCRXController(FakeCRXConfig(), initial_q_deg=np.append(np.degrees(CRX_HOME), np.zeros(3))
                                       ).start()
        ended = threading.Event()

        def ticks() -> None:
            while not ended.is_set():
                answered_cycle(controller)

        thread = threading.Thread(target=ticks, daemon=True)
        thread.start()
        try:
            with StreamMotionRobot(robot, "127.0.0.1", port=controller.sm_port, rmi_port=controller.rmi_port) as link:
                link.connect(20.0)
                yield link, controller
        finally:
            ended.set()
            thread.join(5.0)
            controller.close()


def _once(act: Callable[[Any], None]) -> Fault:
    """A fault that begins and stays."""
    return lambda controller, k, rng: act(controller) if k == 0 else None


def _often(act: Callable[[Any], None]) -> Fault:
    """A fault of some cycles."""
    return lambda controller, k, rng: act(controller) if rng.random() < _SHARE else None


def _trip(controller: Any) -> None:
    with controller.state.lock:
        controller.state.trip_deviation_fault(2, 6.0)


def _stop(controller: Any) -> None:
    with controller.state.lock:
        controller.state.e_stopped = True


def _taken(controller: Any) -> None:
    with controller.state.lock:
        controller.state.motion_possible_forced_off = True


# EGM and ROS 2 around the simulated KR 6.

@contextmanager
def _kr6() -> Iterator[SimulatedArm]:
    robot = Robot.load("kr6")
    with SimulatedArm(robot, World.default("kr6"), np.random.default_rng(1)) as arm:
        arm.cycle(arm.truth.q_m)
        yield arm


@contextmanager
def _egm() -> Iterator[tuple[LinkedRobot, Any]]:
    with _kr6() as arm, EgmRobot(arm.robot, port=0) as link:
        controller = EgmController(arm, link.address, timeout=ANSWER_WITHIN)
        controller.disturbance = lambda cycle, message: [message] * _Wire.copies.pop(0) if _Wire.copies else [message]
        _Wire.copies.clear()
        thread = threading.Thread(target=controller.run, daemon=True)
        thread.start()
        try:
            link.connect(20.0)
            yield link, controller
        finally:
            controller.stop()
            thread.join(5.0)


class _Wire:
    """How often the coming messages go out."""

    copies: list[int] = []  # noqa: RUF012


@contextmanager
def _ros2() -> Iterator[tuple[LinkedRobot, Any]]:
    with _kr6() as arm:
        controllers = Ros2Arm(arm, delivered=lambda cycle: [0.0] * _Wire.copies.pop(0) if _Wire.copies else [0.0])
        _Wire.copies.clear()
        thread = threading.Thread(target=controllers.play, kwargs={"slowed": 0.0}, daemon=True)
        thread.start()
        try:
            with opened(Address.parse("ros2://"), arm.robot, LinkSettings()) as link:
                link.connect(20.0)
                yield link, controllers
        finally:
            controllers.stop()
            thread.join(5.0)
            controllers.close()


def _second_publisher(controllers: Any) -> None:
    from std_msgs.msg import Float64MultiArray

    controllers.node.create_publisher(Float64MultiArray, "forward_position_controller/commands", 1)


def _sends(copies: int, times: int = 1) -> Callable[[Any], None]:
    return lambda controller: _Wire.copies.extend([copies] * times)


FAULTS: dict[str, tuple[Callable[[], Any], Where, dict[str, Fault]]] = {
    "fanuc": (_fanuc, lambda c: np.radians(c.plant.snapshot_deg()[0][:6]), {
        "nothing": _once(lambda c: None),
        "2 % of the status lost": _often(lambda c: c.sm.inject_seq_gap(1)),
        "2 % doubled": _often(lambda c: c.sm.duplicate_next_status()),
        "watchdog: stop error excess": _once(_trip),
        "emergency stop": _once(_stop),
        "motion taken from the stream": _once(_taken),
        "silence": _once(lambda c: c.sm.drop_status(10_000)),
    }),
    "egm": (_egm, lambda c: c.arm.truth.q_m.copy(), {
        "nothing": _once(lambda c: None),
        "2 % of the messages lost": _often(_sends(0)),
        "2 % doubled": _often(_sends(2)),
        "EGM reports an error": _once(lambda c: setattr(c, "mci", MCI_ERROR)),
        "the program stops": _once(lambda c: setattr(c, "rapid", RAPID_STOPPED)),
        "silence": _once(_sends(0, 10_000)),
    }),
    "ros2": (_ros2, lambda c: c.arm.truth.q_m.copy(), {
        "nothing": _once(lambda c: None),
        "2 % of the states lost": _often(_sends(0)),
        "2 % doubled": _often(_sends(2)),
        "a second publisher of commands": _once(_second_publisher),
        "time stands": _once(lambda c: setattr(c, "frozen", True)),
        "the publisher falls silent": _once(lambda c: setattr(c, "silent", True)),
    }),
}
"""Faults by interface."""
