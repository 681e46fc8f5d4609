"""What the default worlds are like: gear resonances, friction, sag, path errors that nobody corrects, warming."""

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
from studies.report import head, row

CIRCLES = {"kr6": (0.7, 0.32, np.pi / 4), "kr15": (0.63, 0.32, np.pi / 4), "manutec_r15": (0.6, 0.40, np.pi / 2)}
"""Speed [m/s], diameter [m] and inclination [rad] of each arm's circle."""
COMPRESSION = 60.0
"""Thermal time runs so many times faster than the arm: an hour takes a minute of arm time."""


def world() -> None:
    """Each shipped arm at home: modes, friction, sag; and the RMS error of a circle without any correction."""
    columns = {name: _at_home(Robot.load(name)) | _circle_errors(Robot.load(name)) for name in CIRCLES}
    head("", *columns)
    for title in next(iter(columns.values())):
        row(title, *(column[title] for column in columns.values()))


def _at_home(robot: Robot) -> dict[str, str]:
    """The coupled modes [Hz], friction over the torque limit [%], and sag [mm]."""
    world = World.default(robot.name)
    model, q = draw_specimen(robot, world).model, robot.home
    mass = pin.crba(model, model.createData(), q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    stiffness = world.per_joint("stiffness", robot.n)
    modes = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, np.diag(stiffness))).real) / 2 / np.pi
    fast = 100 * steady_friction(world, robot.n, robot.v_max[None])[0] / robot.tau_max
    twist = pin.computeGeneralizedGravity(model, model.createData(), q) / stiffness
    sag = np.linalg.norm(robot.fk()(q - twist).translation - robot.fk()(q).translation)
    return {"lowest modes of the arm with motors held": ", ".join(f"{one:.0f}" for one in np.sort(modes)[:3]) + " Hz",
            "friction at full speed, % of torque limit": f"{fast.min():.0f} to {fast.max():.0f}",
            "sag of the TCP under gravity": f"{1e3 * sag:.1f} mm"}


def _circle_errors(robot: Robot) -> dict[str, str]:
    """RMS of the circle's error from motor angles and of the arm itself [mm], without and with the planner's delay."""
    speed, diameter, _ = CIRCLES[robot.name]
    own = World.default(robot.name)
    plain, delayed = (_path_error(robot, own.replace(correction_delay=delay)) for delay in (False, True))
    (matched, aligned, late), (_, arm, _) = plain["q_m"], plain["q_a"]
    other, again, later = delayed["q_m"]
    return {"circle": f"{1e3 * diameter:.0f} mm, {1e3 * speed:.0f} mm/s",
            "time-matched error, motor side": f"{matched:.1f} mm",
            "aligned (delay removed)": f"{aligned:.1f} mm ({late:.1f} ms)",
            "the same with the planner's delay": f"{other:.1f}, {again:.1f} mm ({later:.1f} ms)",
            "aligned error of the arm itself (sag included)": f"{arm:.1f} mm"}


def _circle(robot: Robot) -> tuple[Array, Array]:
    """A circle with smooth start and stop: TCP positions ``(N, 3)`` and joint angles ``(N, n)`` per cycle."""
    speed, diameter, inclination = CIRCLES[robot.name]
    start, radius, ramp = robot.fk()(robot.home), 0.5 * diameter, 0.4
    total = 2 * np.pi * diameter / speed + ramp
    t = np.arange(0.0, total + 0.3, robot.t_ipo)
    angle = np.cumsum(speed * np.clip(np.minimum(t, total - t) / ramp, 0.0, 1.0)) * robot.t_ipo / radius
    up = np.array([np.cos(inclination), 0.0, np.sin(inclination)])
    positions = start.translation + radius * ((np.cos(angle)[:, None] - 1) * up
                                              + np.sin(angle)[:, None] * np.array([0.0, 1.0, 0.0]))
    targets = [pin.SE3(start.rotation, position) for position in positions]
    return positions, InverseKinematics(robot).path(targets, robot.home)


def _path_error(robot: Robot, world: World) -> dict[str, tuple[float, float, float]]:
    """Of motor and of arm angles: error time-matched and aligned [mm], and the delay that was removed [ms]."""
    positions, q_d = _circle(robot)
    with SimulatedArm(robot, world, np.random.default_rng(1), q0=q_d[0]) as arm:
        for q in q_d:
            arm.cycle(q)
        log = arm.history()
    fk, due = robot.fk(), robot.t_ipo * (1 + np.arange(len(q_d)))
    inside = (log["t"] > due[0] + 0.05) & (log["t"] < due[-1])
    found = {}
    for side in ("q_m", "q_a"):
        actual = np.array([fk(q).translation for q in log[side][inside]])

        def rms(delay: float, actual: Array = actual) -> float:
            wanted = np.column_stack([np.interp(log["t"][inside] - delay, due, axis) for axis in positions.T])
            return 1e3 * float(np.sqrt(np.mean(np.sum((wanted - actual) ** 2, axis=1))))

        best = min(np.arange(0.0, 0.03, 0.00025), key=rms)
        found[side] = rms(0.0), rms(best), 1e3 * float(best)
    return found


def heating() -> None:
    """An hour of warm-up of the KR 15 in compressed time: temperatures and friction, as [G] Fig. 12 shows them."""
    robot = Robot.load("kr15")
    world = World.default("kr15").replace(start_temperature=22.0, time_compression=COMPRESSION, log_cycle=0.012)
    amplitude, period = np.array([0.8, 0.4, 0.5, 1.0, 0.8, 1.5]), 3.0
    with SimulatedArm(robot, world, np.random.default_rng(0)) as arm:
        while arm.t < 3600.0 / COMPRESSION:
            arm.cycle(robot.home + amplitude * 0.5 * (1 - np.cos(2 * np.pi * arm.t / period)))
        log = arm.history()
    head("minute", *(f"T_{j + 1} °C" for j in range(6)), "friction at half speed, joint 1 N m", "joint 4 N m")
    half = 0.5 * robot.v_max[None]
    for minute in (0, 10, 20, 30, 45, 60):
        k = min(int(np.searchsorted(log["t"], minute * 60.0 / COMPRESSION)), len(log["t"]) - 1)
        warm = log["temperature"][k]
        friction = [steady_friction(world, 6, half, temperature=float(warm[j]))[0, j] for j in (0, 3)]
        row(minute, *(f"{value:.1f}" for value in warm), f"{friction[0]:.1f}", f"{friction[1]:.2f}")
