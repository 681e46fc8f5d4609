"""The controller's side of KUKA RSI around a simulated arm: for tests, and to try a server without a robot.

    python -m sim.devices.rsi_controller path.csv --robot kr6

simulates a controller whose arm stands at the first point of the path. Written from the protocol alone, without the
code that parses and formats on the other side.
"""

from __future__ import annotations

import argparse
import re
import socket
import sys
import threading
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi.link import received, stamp_arrivals
from ideal_robot.signals.recording import Recording
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from sim.devices.datagrams import sent_when_open
from sim.devices.rsi_pose import PoseMotion, numbers

_ANSWER = re.compile(r'<Sen Type="ImFree">.*<(AK|RKorr)((?: \w{1,2}="[-+.\d]+")+)/>.*<IPOC>(\d{1,18})</IPOC></Sen>',
                     re.ASCII)
_NUMBER = re.compile(r' (\w{1,2})="([-+]?\d{1,9}(?:\.\d{0,18})?)"', re.ASCII)
_POSE = ("X", "Y", "Z", "A", "B", "C")

Disturbance = Callable[[int, bytes], list[bytes]]
"""What is sent in place of the packet of a cycle: called with its number and the packet."""


@dataclass(frozen=True)
class ControllerRun:
    """What a simulated controller measured and received in a run.

    Attributes:
        commands: commanded axis angles of every cycle ``(N, n)`` [deg].
        answered: whether an answer came in time ``(N,)``.
        ended: why it ended.
    """

    commands: Array
    answered: Array
    ended: str


IPOC = 4208163634
"""Time stamp of the first cycle [ms]."""


class RsiController:
    """Sends ``<Rob>`` every cycle and moves the arm by the axis corrections of the answers.

    Without an answer the arm stays at its last command (``HOLDON``).

    Args:
        arm: the arm; its posture now is where RSI begins.
        address: where the server listens.
        relative: whether corrections add up.
        sign: direction of the controller's axes against the URDF's, 1 or -1 ``(n,)``.
        timeout: how long an answer is waited for [s], the simulated time standing still meanwhile; None for as long as
            a cycle takes, as a real controller does.
        patience: cycles in a row without an answer after which it ends; fifty times as many before the first answer, as
            a server that compiles its code takes half a minute for it.
        disturbance: see ``Disturbance``; None sends every packet as it is.
        pose: how corrections of the pose move it; None where corrections are those of the axes.
        external: positions of its external axes [deg or mm], which do not move.
    """

    def __init__(self, arm: SimulatedArm, address: tuple[str, int], *, relative: bool = False,
                 sign: Collection[float] = (-1.0, 1.0, 1.0, -1.0, 1.0, -1.0), timeout: float | None = 0.3,
                 patience: int = 10, disturbance: Disturbance | None = None,
                 pose: PoseMotion | None = None, external: tuple[float, ...] = ()) -> None:
        self.pose, self.external = pose, external
        self.arm, self.address, self.relative, self.sign = arm, address, relative, np.array(list(sign))
        self.timeout, self.patience, self.disturbance = timeout, patience, disturbance
        self._stopped = threading.Event()

    def stop(self) -> None:
        """Ends ``run`` from another thread."""
        self._stopped.set()

    def run(self, cycles: int = 1_000_000) -> ControllerRun:
        """Simulates up to ``cycles`` cycles, fewer if answers stop coming."""
        start = self.sign * np.degrees(self.arm.truth.q_m)
        command, state = start.copy(), RobotState(self.arm.t, self.arm.truth.q_m, np.zeros(self.arm.robot.n))
        commands, answered = [], []
        silent, late, ended = 0, 0, "all cycles played"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            stamp_arrivals(link)
            link.connect(self.address)
            begin = time.perf_counter()
            for k in range(cycles):
                stamp = (IPOC + k * round(1e3 * self.arm.t_ipo)) % 2**32
                packet = self.packet(state, start, late, stamp)
                sent = [packet] if self.disturbance is None else self.disturbance(k, packet)
                end = time.perf_counter() + (self.arm.t_ipo if self.timeout is None else self.timeout)
                sent_when_open(link, sent, end, self._stopped.is_set)
                correction = self.answer(link, stamp, end) if sent else None
                if self._stopped.is_set():
                    ended = "stopped"
                    break
                answered.append(correction is not None)
                if correction is None:
                    silent, late = silent + 1, late + 1
                    if silent >= self.patience * (1 if any(answered) else 50):
                        ended = f"no answer in {silent} cycles"
                        break
                else:
                    silent = 0
                    try:
                        command = self.corrected(command, start, correction)
                    except ValueError as error:
                        ended = f"the controller refuses: {error}"
                        break
                commands.append(command)
                state = self.arm.cycle(self.sign * np.radians(command))
                if self.timeout is None:
                    time.sleep(max(begin + (k + 1) * self.arm.t_ipo - time.perf_counter(), 0.0))
        return ControllerRun(np.array(commands), np.array(answered), ended)

    def corrected(self, command: Array, start: Array, correction: Array) -> Array:
        """Commanded axis angles ``(n,)`` [deg] with a correction; ValueError where a pose cannot be reached.

        Args:
            command, start: in force ``(n,)`` [deg], and when RSI began.
            correction: of the axes ``(n,)`` [deg], or of the pose ``(6,)`` [mm, deg].
        """
        begin = command if self.relative else start
        if self.pose is None:
            return np.asarray(begin + correction)
        wanted = self.pose.corrected(self.pose.pose(self.sign * np.radians(begin)), correction)
        return np.asarray(self.sign * np.degrees(self.pose.joints(wanted, self.sign * np.radians(command))))

    def packet(self, state: RobotState, start: Array, late: int, stamp: int) -> bytes:
        """The packet of a cycle.

        Args:
            state: of the arm; motor angles and torques.
            start: commanded axis angles when RSI began ``(n,)`` [deg].
            late: answers that came too late so far.
            stamp: IPOC.
        """
        def axes(tag: str, values: Array) -> str:
            return f"<{tag} " + " ".join(f'A{i + 1}="{value:.6f}"' for i, value in enumerate(values)) + "/>"

        current = axes("MACur", self.sign * state.tau / self.arm.robot.drive_gain)
        place = np.zeros(6) if self.pose is None else numbers(self.pose.pose(state.q))
        pose = "<RIst " + " ".join(f'{name}="{value:.6f}"' for name, value in zip(_POSE, place, strict=True)) + "/>"
        external = ""
        if self.external:
            external = "<EIPos " + " ".join(f'E{i + 1}="{at:.4f}"' for i, at in enumerate(self.external)) + "/>"
        return (f'<Rob Type="KUKA">{pose}'
                + axes("AIPos", self.sign * np.degrees(state.q)) + axes("ASPos", start) + external + current
                + f'<Delay D="{late}"/><IPOC>{stamp}</IPOC></Rob>').encode("ascii")

    def answer(self, link: socket.socket, stamp: int, end: float) -> Array | None:
        """The corrections of the answer to a cycle [deg], or None if none comes in time.

        Args:
            link: socket that the packet went through.
            stamp: IPOC of the cycle.
            end: until when it has to come, by ``time.perf_counter`` [s]; one that arrived by then is used, even if this
                program read it later.
        """
        while not self._stopped.is_set():
            remaining = end - time.perf_counter()
            link.settimeout(min(max(remaining, 0.0), 0.05))
            try:
                packet, _, arrived = received(link)
            except (TimeoutError, BlockingIOError):
                if remaining <= 0:
                    return None
                continue
            except ConnectionError:
                continue
            if arrived > end:
                return None
            correction = self._correction(packet.decode("ascii", "replace"), stamp)
            if correction is not None:
                return correction
        return None

    def _correction(self, answer: str, stamp: int) -> Array | None:
        """The corrections of a sound answer to the cycle [deg]; None for any other."""
        match = _ANSWER.fullmatch(answer)
        if match is None or int(match[3]) != stamp:
            return None
        told = _NUMBER.findall(match[2])
        tag, names = ("AK", tuple(f"A{i + 1}" for i in range(self.arm.robot.n))) if self.pose is None else (
            "RKorr", _POSE)
        if match[1] != tag or tuple(name for name, _ in told) != names:
            return None
        return np.array([float(value) for _, value in told])


def main(words: Sequence[str] | None = None) -> int:
    """Simulates a controller on this computer in real time, until the server stops answering.

    Returns the exit code: 1 where not one cycle was answered.
    """
    parser = argparse.ArgumentParser(description="KUKA RSI controller around a simulated arm, on 127.0.0.1.")
    parser.add_argument("path", help="the path the server has: the arm starts at its first point")
    parser.add_argument("--robot", default="kr6", help="shipped robot, or path of a URDF")
    parser.add_argument("--port", type=int, default=49152)
    parser.add_argument("--relative", action="store_true")
    parser.add_argument("--patience", type=int, default=100, help="cycles without an answer after which it ends")
    arguments = parser.parse_args(words)
    robot = Robot.load(arguments.robot)
    columns = Recording.read(arguments.path).columns
    prefix = "q_d" if "q_d_1" in columns else "q"
    start = np.array([columns[f"{prefix}_{i + 1}"][0] for i in range(robot.n)])
    with SimulatedArm(robot, World.default(robot), np.random.default_rng(0), q0=start) as arm:
        run = RsiController(arm, ("127.0.0.1", arguments.port), relative=arguments.relative, timeout=None,
                            patience=arguments.patience).run()
    print(f"{run.ended}; {int(np.sum(run.answered))} of {len(run.answered)} cycles answered")
    return 0 if run.answered.any() else 1


if __name__ == "__main__":
    sys.exit(main())
