"""KR 15 on [G]'s paths: other arms, single effects of the world, and an hour from a cold start."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure

from ideal_robot.arrays import Array, interpolated
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.inverse import Inverse
from ideal_robot.robots.joints import mass_matrix
from ideal_robot.robots.robot import Robot
from planning.path.kinematics import InverseKinematics
from scenes.arms import arm_of
from scenes.commands.common import whole_numbers
from scenes.methods import ADAPTED, IDEAL, NONE
from scenes.metrics import PathErrors
from scenes.models import model_for, own_model
from scenes.path.cell import PathCell
from scenes.path.kind import run
from scenes.scene_files.path_scene import PathScene, joint_path
from scenes.scene_files.scene import chosen
from sim.arm.arm import SimulatedArm
from sim.arm.drive import steady_friction
from sim.arm.specimen import draw_specimen
from sim.arm.world import World
from studies.closings import with_true_friction
from studies.report import head, row, scene_of

SCENES = "iso9283_1,iso9283_2,iso9283_3"
OFF: dict[str, dict[str, Any]] = {
    "nothing": {},
    "all friction": {"friction": False},
    "the part of friction that falls with speed": {"stribeck": 0.0},
    "friction's growth with load": {"load_friction": 0.0},
    "warming": {"thermal": False},
    "torque ripple, encoder increments, noise": {"torque_ripple": 0.0, "quantisation": False, "current_noise": 0.0,
                                                 "external_position_noise": 0.0},
    "elastic gears": {"elasticity": False},
}
REST, LEAD = 0.3, 0.9
"""Rest between two circles, and at the start before the first one [s]."""


def paths(individuals: str = "1-10", scenes: str = SCENES) -> None:
    """Ten arms: percent of E_car taken away with the own model and a stranger's, each not adapted and adapted.

    A stranger's model is that of the next individual. Percent of E_car, the weaker of time-matched and aligned.
    """
    names, every = scenes.split(","), whole_numbers(individuals, "--individuals")
    reductions = np.empty((len(every), len(names), 4))
    head("individual", *(f"`{name}` own / adapted / stranger / adapted" for name in names))
    for i, individual in enumerate(every):
        for j, name in enumerate(names):
            scene = chosen(scene_of(PathScene, name), individual=individual)
            other = chosen(scene_of(PathScene, name), individual=individual % 10 + 1)
            stranger = scene.changed(model=own_model(other, arm_of(scene.robot)))
            before = run(scene, method=NONE).errors
            reductions[i, j] = [_reduction(before, run(variant, method=method).errors)
                                for variant in (scene, stranger) for method in (IDEAL, ADAPTED)]
        row(individual, *(" / ".join(f"{value:.1f}" for value in values) for values in reductions[i]))
    row("least", *(" / ".join(f"{value:.1f}" for value in values) for values in reductions.min(axis=0)))


def paths_causes(individual: int = 2, scene: str = "iso9283_1") -> None:
    """What is left of the aligned E_car with single effects of the world off, each with a model of that arm."""
    played = chosen(scene_of(PathScene, scene), individual=individual)
    head("off", "E_car aligned, none [mm]", "ideal [mm]", "less by %")
    for what, change in OFF.items():
        changed = played.changed(world={**played.world, **change})
        before, after = (1e3 * run(changed, method=method).errors.aligned.E_car for method in (NONE, IDEAL))
        row(what, f"{before:.3f}", f"{after:.3f}", f"{100.0 * (1.0 - after / before):.1f}")


def _reduction(before: PathErrors, after: PathErrors) -> float:
    return 100.0 * min(1.0 - after.time_matched.E_car / before.time_matched.E_car,
                       1.0 - after.aligned.E_car / before.aligned.E_car)


def warm_up(minutes: float = 60.0, compression: float = 20.0, individuals: str = "",
            figure: Path | None = None) -> None:
    """An hour from a cold start: fixed model, adapted, and an oracle that reads the true friction.

    The arm starts at 22 °C and draws the circle of `iso9283_3` again and again; the model was identified at 35 °C.
    Adapted is what the method `adapted` plays. The oracle has the true friction at the true gear temperatures and the
    identified rest. Thermal time runs --compression times faster than the arm. With --individuals each arm has the
    model of its own motions.
    """
    arms: list[int | None] = [*whole_numbers(individuals, "--individuals")]
    for individual in arms or [None]:
        if individual is not None:
            print(f"\nindividual {individual}")
        _hour(chosen(scene_of(PathScene, "iso9283_3"), individual=individual), minutes, compression, figure)


def _hour(scene: PathScene, minutes: float, compression: float, figure: Path | None) -> None:
    robot = arm_of(scene.robot)
    world = World.from_table(robot.name, scene.arm_world).replace(
        correction_delay=False, start_temperature=22.0, time_compression=compression)
    path = joint_path(scene, robot, world.t_ipo)
    place = PathCell(robot, world, model_for(scene, robot), path, "tcp", scene.seed)
    loop, circle = place.loop(), path.q_d[path.counts]
    # Back to the start without a jump: the circle ends where it began.
    once = np.concatenate([circle, np.tile(circle[0], (round(REST / world.t_ipo), 1))])
    count = max(2, round(60.0 * minutes / compression / (len(once) * world.t_ipo)))
    ideal, every = Inverse(loop), list(range(1, robot.n + 1))
    results = {}
    for name, law in (("fixed model", ideal), ("adapted", place.feedforward(ADAPTED)), ("oracle", ideal)):
        informed = (lambda warm: Inverse(with_true_friction(loop, robot, world, every, warm))
                    ) if name == "oracle" else None
        results[name], temperature = _circles(robot, world, law, once, count, len(circle), informed)
    minute = (np.arange(count, dtype=float) + 0.5) * len(once) * world.t_ipo * compression / 60.0
    head("minute", *(f"{name}, E_car [mm]" for name in results))
    for k in np.unique(np.linspace(0, count - 1, 9).astype(int)):
        row(f"{minute[k]:.1f}", *(f"{1e3 * results[name][k]:.3f}" for name in results))
    print(f"\njoint 1 from 22 to {temperature[-1]:.0f} °C")
    head("", "whole hour, E_car [mm]", "against the oracle")
    whole = {name: float(np.sqrt(np.mean(values**2))) for name, values in results.items()}
    for name, value in whole.items():
        row(f"{name}: true friction at true temperatures, read from the simulator" if name == "oracle" else name,
            f"{1e3 * value:.3f}", f"{value / whole['oracle']:.2f}")
    if figure is not None:
        figure.parent.mkdir(parents=True, exist_ok=True)
        _figure(minute, results, temperature).savefig(figure, dpi=130, bbox_inches="tight")


def _circles(robot: Robot, world: World, law: Feedforward, once: Array, count: int, drawn: int,
             told: Callable[[Array], Feedforward] | None) -> tuple[Array, Array]:
    """E_car of each circle ``(count,)`` [m] and the temperature of joint 1 at its end [°C].

    The first ``drawn`` rows of ``once`` count; ``told`` makes the law of a circle from temperatures at its begin.
    """
    lead, x_d = round(LEAD / world.t_ipo), robot.tool_places(once[:drawn])
    with SimulatedArm(robot, world, np.random.default_rng(1), once[0]) as arm:
        state = law.init(once[0])
        q_d = np.concatenate([np.tile(once[0], (lead, 1)), np.tile(once, (count, 1)), np.tile(once[-1], (30, 1))])
        for k in range(lead + count * len(once)):
            if told is not None and k >= lead and (k - lead) % len(once) == 0:
                law = told(arm.history()["temperature"][-1])
            q_c, state = law.step(state, q_d[k : k + law.n_d])
            state = law.observe(state, arm.cycle(q_c))
        log = arm.history()
    every = round(world.t_ipo / 0.002)
    q_a, temperature = log["q_a"][::every], log["temperature"][::every, 0]
    errors = np.empty(count)
    for i in range(count):
        start = lead + i * len(once)
        x = robot.tool_places(q_a[start : start + drawn])
        errors[i] = np.sqrt(np.mean(np.sum((x - x_d) ** 2, axis=1)))
    return errors, temperature[lead + len(once) - 1 :: len(once)][:count]


def _figure(minutes: Array, results: dict[str, Array], temperature: Array) -> Figure:
    figure = Figure(figsize=(8.0, 4.0))
    axes = figure.add_subplot()
    colours = {"fixed model": "#8893a1", "adapted": "#e06a00", "oracle": "#1c2430"}
    for name, values in results.items():
        axes.plot(minutes, 1e3 * values, label=name, color=colours[name], lw=1.6, ls="--" if name == "oracle" else "-")
    axes.set(xlabel="minutes since switch-on", ylabel="E_car of each circle, time-matched [mm]")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False, loc="center right")
    axes.spines[["top"]].set_visible(False)
    warm = axes.twinx()
    warm.plot(minutes, temperature, color="#c2255c", lw=1, ls=":")
    warm.set_ylabel("gear temperature of joint 1 [°C]", color="#c2255c")
    warm.spines[["top"]].set_visible(False)
    return figure


# What the default worlds are like: gear resonances, friction, sag, path errors that nobody corrects, warming.

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
    mass = mass_matrix(model, model.createData(), q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    stiffness = world.per_joint("stiffness", robot.n)
    modes = np.sqrt(np.linalg.eigvals(np.linalg.solve(mass, np.diag(stiffness))).real) / 2 / np.pi
    fast = 100 * steady_friction(world, robot.n, robot.v_max[None])[0] / robot.tau_max
    twist = pin.computeGeneralizedGravity(model, model.createData(), q) / stiffness
    sag = np.linalg.norm(robot.fk()(q - twist).translation - robot.fk()(q).translation)
    return {"lowest modes of the arm with motors held": ", ".join(f"{mode:.0f}" for mode in np.sort(modes)[:3]) + " Hz",
            "friction at full speed, % of torque limit": f"{fast.min():.0f} to {fast.max():.0f}",
            "gravity deflection of the TCP": f"{1e3 * sag:.1f} mm"}


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
            "aligned error of the arm itself (gravity deflection included)": f"{arm:.1f} mm"}


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
    due = robot.t_ipo * (1 + np.arange(len(q_d)))
    inside = (log["t"] > due[0] + 0.05) & (log["t"] < due[-1])
    errors = {}
    for side in ("q_m", "q_a"):
        actual = robot.tool_places(log[side][inside])

        def rms(delay: float, actual: Array = actual) -> float:
            wanted = interpolated(log["t"][inside] - delay, due, positions)
            return 1e3 * float(np.sqrt(np.mean(np.sum((wanted - actual) ** 2, axis=1))))

        best = min(np.arange(0.0, 0.03, 0.00025), key=rms)
        errors[side] = rms(0.0), rms(best), 1e3 * float(best)
    return errors


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
        friction = steady_friction(world, 6, half, temperature=warm)[0, [0, 3]]
        row(minute, *(f"{value:.1f}" for value in warm), f"{friction[0]:.1f}", f"{friction[1]:.2f}")
