"""Arms that are simulated behind their makers' interfaces: for tests, and for the chains of the evidence page.

``python -m studies.other_arms fr3 127.0.0.9 1.0`` serves one until it is ended; the context managers do it in a process
of its own, and write the URDF and drive data that go with it. FR3 and CRX are simulators of others; the KR 6 is ours,
behind controllers that were written from the makers' documents.
"""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.robots.robot import Robot
from scenes.online.processes import undisturbed
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.egm_controller import EgmController
from sim.devices.ros2_arm import Ros2Arm
from sim.devices.rsi_controller import RsiController
from sim.devices.rtde_controller import RtdeController

ANSWER_WITHIN = 0.5
"""How long a controller that waits for answers waits for one [s]; then it goes on without, as a real one does."""

FR3_HOME = (0.0, -0.7854, 0.0, -2.3562, 0.0, 1.5708, 0.7854)
"""Where the arm stands first [rad]."""
FR3_GAINS = (450.0, 450.0, 350.0, 350.0, 60.0, 60.0, 40.0)
"""Damping of the simulated joint controller [N m s/rad]: with its own wrist damping of 200 joints 5 to 7 chatter at
their torque limits."""
FR3_DATA = f"""name = "fr3"

[joints]
home = {list(FR3_HOME)}
a_max = [10.0, 10.0, 10.0, 10.0, 10.0, 10.0, 10.0]

[controller]
t_ipo = 0.001
t_position = 0.001
t_velocity = 0.001
"""
CRX_HOME = (0.0, 0.2, -0.2, 0.0, -1.2, 0.0)
CRX_DATA = f"""name = "crx10ial"

[joints]
home = {list(CRX_HOME)}
a_max = [8.0, 8.0, 8.0, 12.0, 12.0, 12.0]

[controller]
t_ipo = 0.008
t_position = 0.004
t_velocity = 0.002
"""
_CRX = (("0 0 1", "0 0 0.245", 2.09, 3.14, 12.0), ("0 1 0", "0 0 0", 2.09, 3.1, 10.0),
        ("0 -1 0", "0 0 0.71", 3.14, 4.7, 8.0), ("-1 0 0", "0.2 0 0", 3.14, 3.3, 5.0),
        ("0 -1 0", "0.34 0 0", 3.14, 3.1, 3.0), ("-1 0 0", "0.16 0.15 0", 3.92, 3.9, 1.0))
"""Of each joint axis, place in the joint before [m], speed [rad/s], range [rad] and mass [kg]: about those of a FANUC
CRX-10iA/L. The emulator knows no bodies, so that the masses are assumed and judge nothing."""


def crx_urdf() -> str:
    """The URDF of an arm such as FANUC's emulated one."""
    def link(name: str, mass: float) -> str:
        size = mass / 50
        return (f'<link name="{name}"><inertial><mass value="{mass}"/><origin xyz="0.1 0 0.05"/><inertia ixx="{size}" '
                f'iyy="{size}" izz="{size}" ixy="0" ixz="0" iyz="0"/></inertial></link>')

    parts = [link("base", 20.0)]
    for i, (axis, place, speed, reach, mass) in enumerate(_CRX, 1):
        parent = f"link_{i - 1}" if i > 1 else "base"
        parts += [link(f"link_{i}", mass),
                  f'<joint name="joint_{i}" type="revolute"><parent link="{parent}"/><child link="link_{i}"/>'
                  f'<origin xyz="{place}"/><axis xyz="{axis}"/>'
                  f'<limit lower="{-reach}" upper="{reach}" velocity="{speed}" effort="{40 * mass}"/></joint>']
    return f'<robot name="crx10ial">{"".join(parts)}</robot>\n'


def write_fr3(folder: Path) -> Path:
    """Writes the FR3's URDF and drive data to a folder; returns the path of the URDF."""
    from franky_sim import FR3_URDF

    (folder / "fr3.urdf").write_text(FR3_URDF, encoding="utf-8")
    (folder / "fr3.toml").write_text(FR3_DATA, encoding="utf-8")
    return folder / "fr3.urdf"


@contextmanager
def fr3(folder: Path, *, host: str = "127.0.0.9", slowed: float = 1.0, start: Sequence[float] = FR3_HOME,
        states: str = "") -> Iterator[tuple[str, Path]]:
    """An FR3 behind libfranka's protocol, by ``franky-sim``; yields its address and its URDF.

    Args:
        folder: where URDF and drive data are written.
        host: loopback address.
        slowed: how many times as long a millisecond of the simulation takes; 0: a millisecond begins when the one
            before was answered, so that no busy computer decides what is played.
        start: where the arm stands first ``(7,)`` [rad].
        states: namespace of ROS 2 in which joint states are published every 4 ms, as the node that leads a real arm
            does: FCI tells one client alone; empty for none.
    """
    urdf = write_fr3(folder)
    with _served("fr3", host, str(slowed), ",".join(map(repr, map(float, start))), states):
        # Who answers by itself is waited for; a process that answers meanwhile is not.
        yield f"franka://{host}" + ("" if slowed else "?queue=0&waits=1"), urdf


@contextmanager
def crx(folder: Path, *, slowed: float = 1.0, lag: tuple[float, float] | None = None, drifts: float = 120.0
        ) -> Iterator[tuple[str, Path]]:
    """A FANUC arm behind Stream Motion, by ``airo-fanuc``'s emulated controller; yields its address and its URDF.

    Args:
        folder: where URDF and drive data are written.
        slowed: how many times as long a cycle takes; 0: see ``fr3``.
        lag: of its position behind its commands, when it is led first and after ``drifts`` [s]; its usual one if None.
        drifts: time in which the lag goes from one to the other [s].
    """
    (folder / "crx10ial.urdf").write_text(crx_urdf(), encoding="utf-8")
    (folder / "crx10ial.toml").write_text(CRX_DATA, encoding="utf-8")
    with _served("crx", str(slowed), *(() if lag is None else map(str, (*lag, drifts)))) as ports:
        waits = "" if slowed else "&waits=1"
        yield "fanuc://127.0.0.1:{}?rmi={}".format(*ports.split()) + waits, folder / "crx10ial.urdf"


@contextmanager
def kr6(wire: str, *, port: int = 0) -> Iterator[str]:
    """The simulated KR 6, at home in the default world, behind the controller of a maker; yields its address.

    It serves one session, in which a cycle begins when the one before was answered.

    Args:
        wire: ``rsi``, ``rtde``, ``egm`` or ``ros2``.
        port: where the program listens for RSI or EGM; any free one if 0.
    """
    with _served("kr6", wire, str(port or free_port())) as address:
        yield address


def free_port() -> int:
    """A UDP port that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        return int(link.getsockname()[1])


@contextmanager
def _served(*words: str) -> Iterator[str]:
    """A process of this module that serves an arm; yields what it says once it does."""
    process = subprocess.Popen([sys.executable, "-m", "studies.other_arms", *words], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        said = process.stdout.readline().strip()
        if not said:
            raise RuntimeError(f"the simulated arm {words[0]} has ended before it was ready")
        yield said
    finally:
        process.terminate()
        process.wait()


def _serve_fr3(host: str, slowed: str, start: str = "", states: str = "") -> None:
    from franky_sim import SimulationServer
    from franky_sim.mujoco_simulator import MujocoSimulator

    at = [float(angle) for angle in start.split(",")] if start else FR3_HOME
    with MujocoSimulator() as sim, _broadcaster(states) as tell:
        sim.add_robot(initial_q=at, kv=FR3_GAINS)
        with SimulationServer(sim, [host]) as server:
            print("ready", flush=True)
            if float(slowed):
                _timed_milliseconds(server, float(slowed), tell)
            answered_milliseconds(server, tell)


Tell = Callable[[int, Any], None]
"""Told after every millisecond: how many there were, and the robot."""
_TOLD_EVERY = 4
"""Milliseconds between two joint states."""
_BEHIND = 0.5
"""How far the simulation may be behind its clock before that stands still with it [s]."""
_PRIORITY, _CORE = 60, 0 if (os.cpu_count() or 1) > 1 else None
"""Real-time priority of the simulation, above that of whoever answers, and the core that it keeps to: a controller has
a computer of its own. Where it shares a core with who answers, Linux takes 50 ms of a second from both."""


@contextmanager
def _broadcaster(namespace: str) -> Iterator[Tell]:
    """Publishes joint states of an FR3 in a namespace, stamped by the simulation's time; of none where it is empty."""
    if not namespace:
        yield lambda k, robot: None
        return
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    import rclpy
    from sensor_msgs.msg import JointState

    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("joint_state_broadcaster", context=context, namespace=namespace, enable_rosout=False,
                             start_parameter_services=False)
    publisher = node.create_publisher(JointState, "joint_states", 10)
    names = [f"joint{i}" for i in range(1, 8)]

    def tell(k: int, robot: Any) -> None:
        if k % _TOLD_EVERY == 0:
            state = robot.inner_state
            message = JointState(name=names, position=list(state.q), velocity=list(state.dq), effort=list(state.tau_j))
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(k * 10**6, 10**9)
            publisher.publish(message)

    try:
        yield tell
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def _timed_milliseconds(server: Any, slowed: float, tell: Tell) -> None:
    """Milliseconds of ``franky-sim`` by this computer's clock; its own loop sleeps each time, and so falls behind."""
    (robot,) = server.robot_servers
    due = time.perf_counter()
    with undisturbed(core=_CORE, priority=_PRIORITY):
        for k in count(1):
            server.run_once(realtime=False)
            tell(k, robot.robot)
            due += slowed * 1e-3
            remaining = due - time.perf_counter()
            if remaining > 0:
                time.sleep(remaining)
            elif remaining < -_BEHIND:
                due = time.perf_counter()


def answered_milliseconds(server: Any, tell: Tell = lambda k, robot: None,
                          ended: Callable[[], bool] = lambda: False,
                          heard: Callable[[], bool] = lambda: True) -> None:
    """Milliseconds of ``franky-sim``, each of which begins when the one before was answered.

    Args:
        server: its ``SimulationServer`` with one robot.
        tell: see ``Tell``.
        ended: whether that was the last one.
        heard: whether the last state can be answered, because it was not lost.
    """
    (robot,) = server.robot_servers
    handled, answers = robot._handle_udp_command, []

    def handle(data: bytes) -> None:
        answers.append(data)
        handled(data)

    robot._handle_udp_command = handle
    for k in count(1):
        answers.clear()
        begun = time.perf_counter()
        # Without a motion nobody answers, and states go out as by the clock.
        within = ANSWER_WITHIN if robot.current_motion_id and heard() else 1e-3
        # At least once, however long this process was kept from running: it says what the joints are controlled by.
        robot.process_commands()
        while not answers and time.perf_counter() - begun < within:
            time.sleep(5e-5)
            robot.process_commands()
        server.sim.step()
        robot.send_state()
        tell(k, robot.robot)
        if ended():
            return


def _serve_crx(slowed: str, *lag: str) -> None:
    from airo_fanuc.testing import FakeCRXConfig, FakeCRXController

    start = np.append(np.degrees(CRX_HOME), np.zeros(3))
    led, drifting = 0, [float(value) for value in lag]
    with FakeCRXController(FakeCRXConfig(), initial_q_deg=start) as controller:
        if float(slowed):
            controller.start_realtime(speed=1.0 / float(slowed))
        print(controller.sm_port, controller.rmi_port, flush=True)
        told = 0
        while True:
            if float(slowed):
                time.sleep(0.05)
            else:
                answered_cycle(controller)
            if drifting:
                low, high, over = drifting
                led += controller.state.motion_possible()
                controller.plant.tau_s = low + min(led * controller.sm.itp_s / over, 1.0) * (high - low)
            for violation in controller.sm.violations[told:]:
                print(violation, file=sys.stderr, flush=True)
            told = len(controller.sm.violations)


def answered_cycle(controller: Any) -> None:
    """A cycle of ``airo-fanuc``'s emulated controller, which ends when its status was answered.

    Args:
        controller: a ``FakeCRXController`` that was started without a clock.
    """
    begun = time.monotonic()
    controller.sm.tick(raise_on_violation=False)
    controller.clock.advance(controller.sm.itp_s)
    # Before the arm can be moved nobody answers.
    while time.monotonic() - begun < (ANSWER_WITHIN if controller.state.motion_possible() else 5e-3):
        if select.select([controller.sm._sock], [], [], 1e-3)[0]:
            return


def timed_cycle(controller: Any) -> None:
    """A cycle of ``airo-fanuc``'s emulated controller by this process's clock.

    Args:
        controller: see ``answered_cycle``.
    """
    due = time.perf_counter() + controller.sm.itp_s
    controller.sm.tick(raise_on_violation=False)
    controller.clock.advance(controller.sm.itp_s)
    while (left := due - time.perf_counter()) > 0.0:
        time.sleep(left)


def _serve_kr6(wire: str, port: str) -> None:
    robot = Robot.load("kr6")
    with SimulatedArm(robot, World.default("kr6"), np.random.default_rng(1)) as arm:
        # Compiled code is loaded before anybody waits for it.
        arm.cycle(arm.truth.q_m)
        _KR6[wire](arm, int(port))


def _rsi(arm: Any, port: int) -> None:
    print(f"rsi://127.0.0.1:{port}", flush=True)
    RsiController(arm, ("127.0.0.1", port), timeout=ANSWER_WITHIN).run()


def _rtde(arm: Any, port: int) -> None:
    controller = RtdeController(arm)
    print("rtde://{}:{}".format(*controller.address), flush=True)
    controller.run()


def _egm(arm: Any, port: int) -> None:
    print(f"egm://127.0.0.1:{port}?waits=1", flush=True)
    EgmController(arm, ("127.0.0.1", port), timeout=ANSWER_WITHIN).run()


def _ros2(arm: Any, port: int) -> None:
    controllers = Ros2Arm(arm)
    print("ros2://?waits=1", flush=True)
    controllers.play(slowed=0.0)


_KR6: dict[str, Callable[[Any, int], None]] = {"rsi": _rsi, "rtde": _rtde, "egm": _egm, "ros2": _ros2}
SERVERS: dict[str, Callable[..., None]] = {"fr3": _serve_fr3, "crx": _serve_crx, "kr6": _serve_kr6}
"""Arms that are served."""

if __name__ == "__main__":
    SERVERS[sys.argv[1]](*sys.argv[2:])
