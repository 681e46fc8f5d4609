"""A million mutated, replayed and foreign packets on the RSI server's port while it leads an arm.

    python benchmarks/rsi_hostile.py [PACKETS]

Prints what was counted, whether one command differs from those of the path, and how the process's memory grew.
"""

from __future__ import annotations

import argparse
import resource
import socket
import sys
import time

import numpy as np

from ideal_robot.feedforward.base import PassThrough
from ideal_robot.robots.robot import Robot
from ideal_robot.rsi import RsiRobot
from scenes.rsi.server import RsiServer
from tests.sim.devices.controllers import LaggingController, mutated, playing

_BURST = 60
"""Packets between two cycles: what fits into a socket's buffer beside the controller's own."""


def main(packets: int) -> int:
    """Returns the exit code: 1 if a command changed."""
    robot, rng = Robot.load("kr6"), np.random.default_rng(0)
    cycles = packets // _BURST + 1
    t = robot.t_ipo * np.arange(cycles)
    path = robot.home + 0.1 * (1 - np.cos(t))[:, None] * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
    with (RsiRobot(robot, port=0, timeout=20.0) as link, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger):
        grown = []

        def beside(k: int, packet: bytes) -> list[bytes]:
            if k in (cycles // 10, cycles - 2):
                grown.append(_resident())
            if k:
                for _ in range(_BURST - 2):
                    stranger.sendto(mutated(packet, rng), link.address)
            again, old[0] = old[0], packet
            return [packet[: int(rng.integers(1, 300))], again] if k else []

        old = [b""]
        controller = LaggingController(link.axes.angles(robot.home), beside=beside)
        server, begun = RsiServer(link, PassThrough(robot.t_ipo), path, 1), time.perf_counter()
        with playing(controller, link.address):
            run = server.play(patience=20.0)
    q_c = run.recording.joints("q_c")
    off = float(np.abs(q_c - path[: len(q_c)]).max())
    print(f"{run.counts['foreign']} foreign, {run.counts['refused']} refused, {run.counts['outdated']} outdated in "
          f"{len(q_c)} of {cycles} cycles and {time.perf_counter() - begun:.0f} s")
    print(f"largest change of a command: {off:.1e} rad; ended: {run.failure or 'path complete'}; memory after a "
          f"tenth and at the end: {', '.join(f'{kib / 1024:.1f}' for kib in grown)} MiB (peak "
          f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.1f})")
    return int(run.failure is not None or off > 1e-9)


def _resident() -> int:
    """Memory of this process now [KiB]."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * resource.getpagesize() // 1024


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("packets", type=int, nargs="?", default=1_000_000)
    sys.exit(main(parser.parse_args().packets))
