"""What the default worlds are like: gear resonances, friction, sag, and the path error that nobody corrects.

    python benchmarks/bench_world.py
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.robots.robot import Robot
from planning.path.kinematics import InverseKinematics
from sim.arm.arm import SimulatedArm
from sim.arm.drive import steady_friction
from sim.arm.specimen import draw_specimen
from sim.arm.world import World

ROBOTS = ("kr6", "kr15", "manutec_r15")


def gears(robot: Robot, world: World) -> None:
    """Resonance with motors held [Hz], friction against the torque limit [%], sag under gravity [mm]."""
    individual = draw_specimen(robot, world)
    model, data, q = individual.model, individual.model.createData(), robot.home
    mass = pin.crba(model, data, q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    stiffness = world.per_joint("stiffness", robot.n)
    held = np.sqrt(stiffness / np.diag(mass)) / 2 / np.pi
    modes = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, np.diag(stiffness))).real) / 2 / np.pi
    fast, slow = (steady_friction(world, robot.n, v[None])[0] for v in (robot.v_max, np.full(robot.n, 1e-3)))
    twist = pin.computeGeneralizedGravity(model, data, q) / stiffness
    sag = np.linalg.norm(robot.fk()(q - twist).translation - robot.fk()(q).translation)
    print(f"\n{robot.name}, home posture")
    for text, values, digits in (
            ("gear resonance, motor held, Hz", held, 1), ("coupled modes of the arm, Hz", np.sort(modes), 1),
            ("breakaway friction, % of torque limit", 100 * slow / robot.tau_max, 1),
            ("friction at speed limit, %", 100 * fast / robot.tau_max, 1),
            ("twist under gravity, mrad", 1e3 * twist, 2)):
        print(f"  {text:40s}" + "".join(f"{value:8.{digits}f}" for value in values))
    print(f"  sag of the TCP under gravity{1e3 * sag:20.2f} mm")


def circle(robot: Robot, speed: float, diameter: float, inclination: float) -> tuple[Array, Array]:
    """A circle with smooth start and stop: TCP positions ``(N, 3)`` and joint angles ``(N, n)`` per cycle."""
    start, radius, ramp = robot.fk()(robot.home), 0.5 * diameter, 0.4
    total = 2 * np.pi * diameter / speed + ramp
    t = np.arange(0.0, total + 0.3, robot.t_ipo)
    v = speed * np.clip(np.minimum(t, total - t) / ramp, 0.0, 1.0)
    angle = np.cumsum(v) * robot.t_ipo / radius
    up = np.array([np.cos(inclination), 0.0, np.sin(inclination)])
    positions = start.translation + radius * ((np.cos(angle)[:, None] - 1) * up
                                              + np.sin(angle)[:, None] * np.array([0.0, 1.0, 0.0]))
    targets = [pin.SE3(start.rotation, position) for position in positions]
    return positions, InverseKinematics(robot).path(targets, robot.home)


def path_error(robot: Robot, world: World, speed: float, diameter: float, inclination: float) -> None:
    """RMS position errors without any correction, from motor angles and of the arm itself [mm]."""
    positions, q_d = circle(robot, speed, diameter, inclination)
    with SimulatedArm(robot, world, np.random.default_rng(1), q0=q_d[0]) as arm:
        for q in q_d:
            arm.cycle(q)
        log = arm.history()
    fk, due = robot.fk(), robot.t_ipo * (1 + np.arange(len(q_d)))
    inside = (log["t"] > due[0] + 0.05) & (log["t"] < due[-1])
    delayed = "on " if world.correction_delay else "off"
    row = f"  {1e3 * diameter:.0f} mm circle at {1e3 * speed:.0f} mm/s, delay {delayed}"
    for side in ("q_m", "q_a"):
        actual = np.array([fk(q).translation for q in log[side][inside]])

        def rms(delay: float, actual: Array = actual) -> float:
            wanted = np.column_stack([np.interp(log["t"][inside] - delay, due, axis) for axis in positions.T])
            return 1e3 * float(np.sqrt(np.mean(np.sum((wanted - actual) ** 2, axis=1))))

        delays = np.arange(0.0, 0.03, 0.00025)
        best = min(delays, key=rms)
        where = "motor side" if side == "q_m" else "arm"
        row += f"   {where}: {rms(0.0):.2f}, aligned {rms(best):.2f} ({1e3 * best:.1f} ms)"
    print(row)


def main() -> None:
    for name in ROBOTS:
        gears(Robot.load(name), World.default(name))
    print("\npath error without correction, RMS mm: time-matched, aligned (the delay that was removed)")
    for name, speed, diameter, inclination in (("kr6", 0.7, 0.32, np.pi / 4), ("kr15", 0.63, 0.32, np.pi / 4),
                                               ("manutec_r15", 0.6, 0.40, np.pi / 2)):
        robot = Robot.load(name)
        print(name)
        for delay in (False, True):
            path_error(robot, World.default(name).replace(correction_delay=delay), speed, diameter, inclination)


if __name__ == "__main__":
    main()
