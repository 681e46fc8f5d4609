"""What goes wrong on makers' interfaces while a path is played: what is noticed, how late, and where the arm ends."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import asdict, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import typer

from ideal_robot.arrays import Array
from ideal_robot.egm import EgmRobot
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.fci import FciRobot
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
from studies.other_arms import (
    ANSWER_WITHIN,
    CRX_DATA,
    CRX_HOME,
    FR3_GAINS,
    FR3_HOME,
    answered_cycle,
    answered_milliseconds,
    crx_urdf,
    timed_cycle,
    write_fr3,
)
from studies.report import head, row
from studies.slow_clock import slower

BEGINS = 60
"""Cycle of the path in which a fault begins."""
_SHARE = 0.02
"""Of messages, where some are lost or come twice."""
LATE = "2 % of the states 30 ms late"
STANDS_IN = "2 % of the states lost, ?waits=0"
TIMED = {("ros2", LATE), ("ros2", STANDS_IN), ("fanuc", "2 % of the status lost"), ("fanuc", LATE),
         ("egm", "2 % of the messages lost"), ("egm", LATE)}
"""Faults that a clock decides."""
_SLOWED = 10.0
"""How many times as long every second takes there."""
_LATE = 0.03
"""By how much messages are late [s]."""
_RESTART = 0.3
"""Time that a node is away which restarts [s]."""
_MESSAGE = 0.02
"""Longer than one takes to be published [s]."""
_PATIENCE = 10.0
"""How long a controller is waited for [s]."""
_LATER = 1.0
"""When it is looked where the arm has ended [s]."""
Where = Callable[[Any], Array]
"""Where the arm of a controller is in truth ``(n,)`` [rad]."""
Fault = Callable[[LinkedRobot, Any, int, np.random.Generator], None]
"""What is done to link or controller before a cycle of the path, from ``BEGINS`` on counted from 0."""


def link_faults(interfaces: Annotated[str, typer.Option(help="With commas between.")] = "fci,fanuc,egm,ros2",
                seed: int = 1) -> None:
    """Faults of FCI, FANUC, EGM and ROS 2 before and while a path is played, one each: noticed, how late, the end.

    A controller begins a cycle when the one before was answered: times are the controller's, of silence those of this
    computer; where the program itself brings the arm to rest, the way to rest is in them. The largest acceleration is
    that of the references that the controller has in force, over the arm's limit, with the hold of a controller that
    misses one; of FCI that of the commands, cycle by cycle. Where the arm ends a second later is its distance from the
    path. What is wrong from the beginning is noticed before anything moves. What is noticed by a clock is played by one
    that is slower than this computer's.

    Args:
        interfaces: which ones.
        seed: of what is lost.
    """
    unknown = [name for name in interfaces.split(",") if name not in FAULTS]
    if unknown:
        raise InputError(f"expected of {', '.join(FAULTS)}", field="--interfaces", value=unknown[0])
    head("interface", "fault", "said", "after [ms]", "acceleration", "from the path [mrad]", "at rest")
    for name in interfaces.split(","):
        for fault in (*FAULTS[name][2], *FROM_THE_BEGINNING.get(name, ())):
            row(name, fault, *play_link(name, fault, seed))


def play_link(name: str, fault: str, seed: int = 1) -> list[str]:
    """Cells of a row of ``link_faults``: what was said, how late, acceleration, distance from the path, at rest."""
    # Nobody else on this computer shall be heard.
    os.environ["ROS_DOMAIN_ID"] = str(_domain())
    arms, where, faults = FAULTS[name]
    if (wrong := FROM_THE_BEGINNING.get(name, {}).get(fault)) is not None:
        with arms(**wrong) as (link, controller):
            return _refused(link, controller, where)
    timed = (name, fault) in TIMED
    with slower(_SLOWED) if timed else nullcontext(), arms(**{"timed": True} if timed else {}) as (link, controller):
        link.clocked = timed and (name, fault) != ("ros2", LATE)
        link.connect(_PATIENCE)
        return _played(link, controller, faults[fault], np.random.default_rng(seed), where)


def _domain() -> int:
    """``ROS_DOMAIN_ID`` of this process's own."""
    return 1 + os.getpid() % 100


def _refused(link: LinkedRobot, controller: Any, where: Where) -> list[str]:
    """Cells of a row of what is refused before anything moves."""
    begun, said = where(controller), "nothing"
    try:
        link.connect(_PATIENCE)
    except IdealRobotError as error:
        said = str(error)
    time.sleep(_LATER)
    away = float(np.max(np.abs(where(controller) - begun)))
    return [" ".join(said.split()), "before", "0.00", f"{1e3 * away:.1f}", "yes" if away < 1e-4 else "no"]


def _played(link: LinkedRobot, controller: Any, begin: Fault, rng: np.random.Generator, where: Where) -> list[str]:
    """Cells of a row: what was said, how late, acceleration, distance from the path, whether at rest."""
    T, home = link.t_ipo, link.commanded.copy()
    u = np.clip(np.arange(round(2.4 / T)) * T / 2.2, 0.0, 1.0)
    q_d = home + 0.25 * np.sin(np.pi * u**3 * (10 - 15 * u + 6 * u**2))[:, None] ** 2
    received, heard, before, arrived, last = link.receive, list[RobotState](), dict[str, int](), link.arrived, 0

    def receive() -> RobotState:
        nonlocal arrived, last
        if len(heard) >= BEGINS:
            if len(heard) == BEGINS:
                before.update(asdict(link.counts), references=len(controller.references or ()))
            begin(link, controller, len(heard) - BEGINS, rng)
        heard.append(received())
        arrived, last = link.arrived, len(controller.references or ())
        return heard[-1]

    link.receive = receive  # type: ignore[method-assign]
    run = PathPlayer(link, PassThrough(T), q_d, 0).played([])
    said, after = run.failure or "nothing", ""
    if run.failure is not None:
        # By the controller's clock as far as it was heard, by this computer's from then on.
        after = f"{1e3 * (heard[-1].t - heard[BEGINS - 1].t + time.perf_counter() - arrived):.0f}"
    elif counts := {name: more for name, value in run.counts.items()
                    if (more := value - before.get(name, 0)) and name not in ("cycles", "partial")}:
        said = "counted: " + ", ".join(f"{value} {name}" for name, value in counts.items())
    # Nobody answers any more: its cycles need not be waited for.
    controller.timeout = link.t_ipo
    time.sleep(_LATER)
    ends = where(controller)
    time.sleep(0.1)
    moves = np.max(np.abs(where(controller) - ends))
    largest = run.details["guard"]["acceleration_share"]
    if controller.references is not None:
        # What a controller does that has stopped the arm, or that nobody answers any more, is its own.
        references = np.array(controller.references)[max(before["references"] - 2, 0) : last + 1]
        largest = float(np.max(np.abs(np.diff(references, 2, axis=0)) / T**2 / link.robot.a_max, initial=0.0))
    away = float(np.min(np.max(np.abs(q_d - ends), axis=1)))
    return [" ".join(said.split()), after, f"{largest:.2f}", f"{1e3 * away:.1f}",
            "yes" if moves < 1e-4 else "no"]


# FANUC's emulated controller.

class _Sent:
    """The emulated controller's socket, of which status packets can be lost or late.

    Args:
        own: the socket.

    Attributes:
        lose, delay: status packets to come that are lost, and that are late.
    """

    def __init__(self, own: Any) -> None:
        self._own, self.lose, self.delay = own, 0, 0

    def sendto(self, packet: bytes, peer: Any) -> None:
        """Sends, later or not at all."""
        if self.lose:
            self.lose -= 1
        elif self.delay:
            self.delay -= 1
            threading.Timer(_LATE * _SLOWED, self._own.sendto, (packet, peer)).start()
        else:
            self._own.sendto(packet, peer)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._own, name)


@contextmanager
def _fanuc(timed: bool = False) -> Iterator[tuple[LinkedRobot, Any]]:
    from airo_fanuc.testing import FakeCRXConfig, FakeCRXController

    with TemporaryDirectory() as folder:
        (Path(folder) / "crx10ial.urdf").write_text(crx_urdf(), encoding="utf-8")
        (Path(folder) / "crx10ial.toml").write_text(CRX_DATA, encoding="utf-8")
        robot = Robot.load(Path(folder) / "crx10ial.urdf")
        controller: Any = FakeCRXController(
            FakeCRXConfig(), initial_q_deg=np.append(np.degrees(CRX_HOME), np.zeros(3))).start()
        ended, references = threading.Event(), list[Array]()
        controller.sm._sock = _Sent(controller.sm._sock)
        plant, stands = controller.plant, np.degrees(CRX_HOME)
        commanded, silent = plant.command_step, plant.silence_step

        def command(q: Array, *more: Any) -> None:
            nonlocal stands
            stands = np.array(q[: len(stands)])
            references.append(np.radians(stands))
            commanded(q, *more)

        def silence(*given: Any, **more: Any) -> None:
            references.append(np.radians(stands))
            silent(*given, **more)

        plant.command_step, plant.silence_step = command, silence

        def ticks() -> None:
            while not ended.is_set():
                (timed_cycle if timed else answered_cycle)(controller)

        thread = threading.Thread(target=ticks, daemon=True)
        thread.start()
        try:
            with StreamMotionRobot(robot, "127.0.0.1", port=controller.sm_port, rmi_port=controller.rmi_port) as link:
                controller.references = references
                yield link, controller
        finally:
            ended.set()
            thread.join(5.0)
            controller.close()


def _once(act: Callable[[Any], None]) -> Fault:
    """A fault that begins and stays."""
    return lambda link, controller, k, rng: act(controller) if k == 0 else None


def _often(act: Callable[[Any], None]) -> Fault:
    """A fault of some cycles."""
    return lambda link, controller, k, rng: act(controller) if rng.random() < _SHARE else None


def _commands_lost(link: LinkedRobot, controller: Any, k: int, rng: np.random.Generator) -> None:
    """Some commands do not arrive, which no state shows; with FCI those of some milliseconds."""
    if k == 0:
        owner: Any = link._arm._motion if isinstance(link, FciRobot) else link  # type: ignore[union-attr]
        name = "write" if isinstance(link, FciRobot) else "_handed_over"
        hand_over = getattr(owner, name)
        setattr(owner, name, lambda q: None if rng.random() < _SHARE else hand_over(q))


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


def _references(controller: Any) -> None:
    """Notes what a controller around a simulated arm has in force, as its ``references``."""
    controller.references = list[Array]()
    cycle = controller.arm.cycle

    def noting(reference: Array) -> RobotState:
        controller.references.append(np.array(reference))
        state: RobotState = cycle(reference)
        return state

    controller.arm.cycle = noting


@contextmanager
def _egm(timed: bool = False) -> Iterator[tuple[LinkedRobot, Any]]:
    with _kr6() as arm, EgmRobot(arm.robot, port=0) as link:
        controller = EgmController(arm, link.address, timeout=None if timed else ANSWER_WITHIN)
        delayed, cycles = list[tuple[int, Any]](), round(_LATE / arm.t_ipo)

        def disturbance(cycle: int, message: Any) -> list[Any]:
            sent = [message for due, message in delayed if due == cycle]
            for delay in _Wire.next():
                if delay:
                    delayed.append((cycle + cycles, message))
                else:
                    sent.append(message)
            return sent

        controller.disturbance = disturbance
        _references(controller)
        _Wire.delays.clear()
        thread = threading.Thread(target=controller.run, daemon=True)
        thread.start()
        try:
            yield link, controller
        finally:
            controller.stop()
            thread.join(5.0)


class _Wire:
    """When each of the coming messages goes out, how late each time [s]."""

    delays: list[list[float]] = []  # noqa: RUF012

    @classmethod
    def next(cls) -> list[float]:
        return cls.delays.pop(0) if cls.delays else [0.0]


@contextmanager
def _ros2(timed: bool = False, **wrong: Any) -> Iterator[tuple[LinkedRobot, Any]]:
    """Where ``timed``, cycles have a length, and do not end with an answer; ``wrong`` as of ``Ros2Arm``."""
    with _kr6() as arm:
        controllers = Ros2Arm(arm, delivered=lambda cycle: _Wire.next(), **wrong)
        _references(controllers)
        _Wire.delays.clear()
        thread = threading.Thread(target=controllers.play, kwargs={"slowed": float(timed)}, daemon=True)
        thread.start()
        try:
            with opened(Address.parse("ros2://"), arm.robot, LinkSettings()) as link:
                yield link, controllers
        finally:
            controllers.stop()
            thread.join(5.0)
            controllers.close()


def _dies(controllers: Any) -> None:
    """The publisher of joint states leaves the graph; the controllers' cycles go on without answers."""
    controllers.silent, controllers.timeout = True, controllers.arm.t_ipo
    time.sleep(_MESSAGE)
    controllers.node.destroy_publisher(controllers.states)


def _restarts(controllers: Any) -> None:
    _dies(controllers)

    def anew() -> None:
        controllers.publish_states()
        controllers.silent = False

    threading.Timer(_RESTART, anew).start()


def _second_publisher(controllers: Any) -> None:
    from std_msgs.msg import Float64MultiArray

    controllers.node.create_publisher(Float64MultiArray, "forward_position_controller/commands", 1)


def _sends(copies: int, times: int = 1) -> Callable[[Any], None]:
    return lambda controller: _Wire.delays.extend([[0.0] * copies] * times)


def _late(controllers: Any) -> None:
    """A message that those behind it overtake."""
    _Wire.delays.append([_LATE])


def _add(name: str, count: int = 1) -> Callable[[Any], None]:
    """So many further status packets are lost or late."""
    return lambda controller: setattr(controller.sm._sock, name, getattr(controller.sm._sock, name) + count)


# The FR3 of ``franky-sim``, whose controller has no reflexes: what a client is told of one is sent.

_HOST, _CYCLE = "127.0.0.79", 0.008
_JOINT_REFLEX = 6
"""Place of a collision among libfranka's errors."""


class _Franka:
    """What is done to the simulated controller between two milliseconds.

    Args:
        server: of ``franky-sim``, with one robot.

    Attributes:
        heard: whether the last state was not lost.
    """

    def __init__(self, server: Any) -> None:
        (self._robot,) = server.robot_servers
        self.heard, self._lost, self._send = True, 0, self._robot.send_state
        self._robot.send_state = self._send_state

    def lose(self, states: int) -> None:
        """So many of the coming states are lost."""
        self._lost = states

    def _send_state(self) -> None:
        self.heard = not self._lost
        if self.heard:
            self._send()
            return
        self._lost -= 1
        # The number of a state is its millisecond, whether it arrives or not.
        self._robot._FrankaServer__message_id += 1

    def stop(self, why: str) -> None:
        """The motion is aborted as libfranka's protocol says it: the mode, the errors, a response to the Move command.

        The simulator answers the client's StopMove with another response, for which libfranka waits.
        """
        from franky_sim.franka_robot_protocol import BaseCommand, MoveStatus, RobotCommand, RobotMode

        robot, state_of = self._robot, type(self._robot).robot_state.fget
        errors = tuple(why == "kReflexAborted" and i == _JOINT_REFLEX for i in range(41))
        mode = RobotMode.kReflex if any(errors) else RobotMode.kUserStopped
        robot._get_state_bytes = lambda: state_of(robot).replace(
            robot_mode=mode, errors=errors, reflex_reason=errors).pack_state()
        robot.stop_motion(send_preemption_signal=False)
        self._send()
        BaseCommand.send_response(robot._tcp_socket, RobotCommand.kMove, robot.current_motion_id, MoveStatus[why])

    def q(self) -> list[float]:
        """Where the arm is in truth [rad]."""
        return list(self._robot.robot.inner_state.q)


def _serve_franka(pipe: Connection) -> None:
    """Serves the FR3; words that come through the pipe are what is to be done, and are answered."""
    from franky_sim import SimulationServer
    from franky_sim.mujoco_simulator import MujocoSimulator

    with MujocoSimulator() as sim:
        sim.add_robot(initial_q=FR3_HOME, kv=FR3_GAINS)
        with SimulationServer(sim, [_HOST]) as server:
            controller = _Franka(server)

            def told() -> bool:
                while pipe.poll():
                    word, *values = pipe.recv()
                    if word == "end":
                        return True
                    pipe.send(getattr(controller, word)(*values))
                return False

            pipe.send("ready")
            answered_milliseconds(server, ended=told, heard=lambda: controller.heard)


class _Remote:
    """The FR3's controller in a process of its own: libfranka waits for it without letting other threads run.

    Args:
        pipe: to that process.

    Attributes:
        timeout: is its own.
        references: are those of the link, which it sends in every millisecond.
    """

    timeout, references = ANSWER_WITHIN, None

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe

    def asked(self, *words: Any) -> Any:
        """What the controller answers."""
        self._pipe.send(words)
        return self._pipe.recv()


@contextmanager
def _fci() -> Iterator[tuple[LinkedRobot, Any]]:
    context = get_context("spawn")
    pipe, other = context.Pipe()
    process = context.Process(target=_serve_franka, args=(other,), daemon=True)
    process.start()
    try:
        pipe.recv()
        with TemporaryDirectory() as folder:
            robot = replace(Robot.load(write_fr3(Path(folder))), t_ipo=_CYCLE)
            with FciRobot(robot, _HOST, queue=0.0, waits=True) as link:
                yield link, _Remote(pipe)
    finally:
        pipe.send(("end",))
        process.join(5.0)
        process.terminate()


def _aborted(why: str) -> Callable[[Any], None]:
    return lambda controller: controller.asked("stop", why)


FAULTS: dict[str, tuple[Callable[..., Any], Where, dict[str, Fault]]] = {
    "fci": (_fci, lambda c: np.array(c.asked("q")), {
        "nothing": _once(lambda c: None),
        "2 % of the states lost": _often(lambda c: c.asked("lose", 1)),
        "10 states lost in a row": _once(lambda c: c.asked("lose", 10)),
        "2 % of the commands lost": _commands_lost,
        "reflex: collision": _once(_aborted("kReflexAborted")),
        "user stop": _once(_aborted("kEmergencyAborted")),
        "silence": _once(lambda c: c.asked("lose", 10**9)),
    }),
    "fanuc": (_fanuc, lambda c: np.radians(c.plant.snapshot_deg()[0][:6]), {
        "nothing": _once(lambda c: None),
        "2 % of the status lost": _often(_add("lose")),
        LATE: _often(_add("delay")),
        "2 % of the commands lost": _commands_lost,
        "2 % doubled": _often(lambda c: c.sm.duplicate_next_status()),
        "watchdog: stop error excess": _once(_trip),
        "emergency stop": _once(_stop),
        "motion taken from the stream": _once(_taken),
        "silence": _once(lambda c: c.sm.drop_status(10_000)),
    }),
    "egm": (_egm, lambda c: c.arm.truth.q_m.copy(), {
        "nothing": _once(lambda c: None),
        "2 % of the messages lost": _often(_sends(0)),
        LATE: _often(_late),
        "2 % of the commands lost": _commands_lost,
        "2 % doubled": _often(_sends(2)),
        "EGM reports an error": _once(lambda c: setattr(c, "mci", MCI_ERROR)),
        "the program stops": _once(lambda c: setattr(c, "rapid", RAPID_STOPPED)),
        "silence": _once(_sends(0, 10_000)),
    }),
    "ros2": (_ros2, lambda c: c.arm.truth.q_m.copy(), {
        "nothing": _once(lambda c: None),
        "2 % of the states lost": _often(_sends(0)),
        STANDS_IN: _often(_sends(0)),
        "2 % of the commands lost": _commands_lost,
        "2 % doubled": _often(_sends(2)),
        "a second publisher of commands": _once(_second_publisher),
        "time stands (/clock)": _once(lambda c: setattr(c, "frozen", True)),
        LATE: _often(_late),
        "the publisher falls silent": _once(lambda c: setattr(c, "silent", True)),
        "the publisher dies": _once(_dies),
        "its node restarts within 0.3 s": _once(_restarts),
    }),
}
"""Faults by interface."""
FROM_THE_BEGINNING: dict[str, dict[str, dict[str, Any]]] = {
    "ros2": {
        "quality of service: controllers want what was sent before": {"durable": True},
        "another ROS_DOMAIN_ID": {"domain": _domain() + 1},
        "joints of other names": {"prefix": "left_"},
        "angles in degrees": {"degrees": True},
    },
}
"""What is otherwise from the beginning, by interface: arguments of its arm."""
