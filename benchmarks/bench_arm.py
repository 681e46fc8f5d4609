"""How fast the simulated arm runs, without camera: seconds of arm time per second.

Wall time is what a user waits, processor time what the arm costs where other processes share the cores.

    python benchmarks/bench_arm.py
"""

from __future__ import annotations

import time

import numpy as np

from ideal_robot.robots.robot import Robot
from sim.arm.arm import SimulatedArm
from sim.arm.kernel import drive_step
from sim.arm.world import STEP, World
from sim.bullet import pybullet

SECONDS = 6.0
REPEATS = 5


def real_time_factor(robot: Robot, world: World) -> tuple[float, float]:
    """Of wall and of processor time, medians over some repetitions of a motion of all joints."""
    with SimulatedArm(robot, world, np.random.default_rng(0)) as arm:
        arm.cycle(robot.home)
        factors = []
        for _ in range(REPEATS):
            arm.reset(robot.home)
            cycles = round(SECONDS / arm.t_ipo)
            wall, processor = time.perf_counter(), time.process_time()
            for k in range(cycles):
                arm.cycle(robot.home + 0.2 * np.sin(2 * np.pi * 0.5 * k * arm.t_ipo) ** 2)
            factors.append((SECONDS / (time.perf_counter() - wall), SECONDS / (time.process_time() - processor)))
    return float(np.median([f[0] for f in factors])), float(np.median([f[1] for f in factors]))


def parts(robot: Robot, calls: int = 4000) -> dict[str, float]:
    """Median time of what one 0.5 ms step consists of [µs]."""
    with SimulatedArm(robot, World.default(robot.name), np.random.default_rng(0)) as arm:
        arm.cycle(robot.home)
        client, body, joints, zero = arm.client, arm.body, list(range(robot.n)), np.zeros(robot.n)
        torque = [0.0] * robot.n
        jobs = {
            "torques to PyBullet": lambda: pybullet.setJointMotorControlArray(
                body, joints, pybullet.TORQUE_CONTROL, forces=torque, physicsClientId=client),
            "PyBullet's step": lambda: pybullet.stepSimulation(physicsClientId=client),
            "joint states from PyBullet": lambda: pybullet.getJointStates(body, joints, physicsClientId=client),
            "controller, motors, gears, friction": lambda: drive_step(
                1, arm._p, arm._shared, arm._counts, arm._x, arm._links, zero, arm._history.next_row),
        }
        result = {}
        for name, job in jobs.items():
            times = []
            for _ in range(7):
                started = time.perf_counter()
                for _ in range(calls // 7):
                    job()
                times.append((time.perf_counter() - started) / (calls // 7))
            result[name] = 1e6 * float(np.median(times))
    return result


def main() -> None:
    print(f"{'robot':14s} {'world':9s} {'× wall':>8s} {'× processor':>12s}")
    for name in ("kr6", "kr15", "manutec_r15"):
        robot = Robot.load(name)
        for label, world in (("default", World.default(name)), ("ideal", World.ideal(name))):
            wall, processor = real_time_factor(robot, world)
            note = "   rigid gears: Pinocchio's forward dynamics in every step" if label == "ideal" else ""
            print(f"{name:14s} {label:9s} {wall:8.1f} {processor:12.1f}{note}")
    print(f"\none step of {STEP * 1e3} ms, µs")
    for part, microseconds in parts(Robot.load("kr6")).items():
        print(f"  {part:38s} {microseconds:6.2f}")


if __name__ == "__main__":
    main()
