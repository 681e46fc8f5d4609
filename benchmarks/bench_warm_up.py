"""Sixty minutes of warm-up of the KR 15 in compressed time: temperatures and friction, as [G] Fig. 12 shows them.

    python benchmarks/bench_warm_up.py
"""

from __future__ import annotations

import time

import numpy as np

from ideal_robot.robots.robot import Robot
from sim.arm.arm import SimulatedArm
from sim.arm.drive import steady_friction
from sim.arm.world import World

COMPRESSION = 60.0
"""Thermal time runs so many times faster than the arm: an hour takes a minute of arm time."""


def main() -> None:
    robot = Robot.load("kr15")
    world = World.default("kr15").replace(start_temperature=22.0, time_compression=COMPRESSION, log_cycle=0.012)
    amplitude, period = np.array([0.8, 0.4, 0.5, 1.0, 0.8, 1.5]), 3.0
    started = time.perf_counter()
    with SimulatedArm(robot, world, np.random.default_rng(0)) as arm:
        while arm.t < 3600.0 / COMPRESSION:
            arm.cycle(robot.home + amplitude * 0.5 * (1 - np.cos(2 * np.pi * arm.t / period)))
        log = arm.history()
    print(f"60 min at {COMPRESSION:g} × thermal time: {log['t'][-1]:.0f} s of arm time in "
          f"{time.perf_counter() - started:.1f} s\n")
    print("minutes   " + "".join(f"   T_{j + 1} °C" for j in range(6)) + "   friction at half speed, joints 1, 4, N m")
    half = 0.5 * robot.v_max[None]
    for minute in (0, 10, 20, 30, 45, 60):
        k = min(int(np.searchsorted(log["t"], minute * 60.0 / COMPRESSION)), len(log["t"]) - 1)
        temperature = log["temperature"][k]
        friction = [steady_friction(world, 6, half, temperature=float(temperature[j]))[0, j] for j in (0, 3)]
        print(f"{minute:7d}   " + "".join(f"{value:9.1f}" for value in temperature)
              + f"   {friction[0]:8.1f} {friction[1]:8.2f}")


if __name__ == "__main__":
    main()
