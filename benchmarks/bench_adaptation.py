"""An hour of warm-up in compressed time: the ideal robot with a fixed model, with adaptation, with perfect knowledge.

    python benchmarks/bench_adaptation.py [--minutes 60] [--compression 20] [--figure docs/pictures/adaptation.png]
    python benchmarks/bench_adaptation.py --individuals 1-3      # each arm with the model of its own motions

The arm starts cold (22 °C) and draws the circle of scene ``iso9283_3`` again and again; the model was identified at
35 °C. Adapted is what the method `adapted` plays in scenes of kind path: it learns friction and mass from one motion
about the path beforehand, and on the circles. The oracle reads the true friction at the true gear temperatures from the
simulator, which no model may, and uses the identified rest. Thermal time runs ``compression`` times faster than the
arm.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ideal_robot.arrays import Array
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.robots.robot import Robot
from scenes import load_scene
from scenes.commands.common import whole_numbers
from scenes.methods import ADAPTED
from scenes.models import model_for
from scenes.path.cell import PathCell
from scenes.scene_files.path_scene import PathScene, joint_path
from scenes.scene_files.scene import chosen
from sim.arm.arm import SimulatedArm
from sim.arm.drive import steady_friction
from sim.arm.specimen import draw_specimen
from sim.arm.world import World

REST = 0.3
"""Rest between two circles [s]."""


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--compression", type=float, default=20.0)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--individuals", default="", help="a list 1,2,5 or a range 1-3; the shipped model if none")
    options = parser.parse_args()
    for individual in whole_numbers(options.individuals, "--individuals") or [None]:
        if individual is not None:
            print(f"\nindividual {individual}")
        warm_up(chosen(load_scene("iso9283_3"), individual=individual), options)


def warm_up(scene: PathScene, options: argparse.Namespace) -> None:
    """One arm's hour with each method.

    Args:
        scene: the circle, the arm and its model.
        options: minutes, compression, figure.
    """
    robot = Robot.load(scene.robot)
    world = World.from_table(robot.name, scene.arm_world).replace(
        correction_delay=False, start_temperature=22.0, time_compression=options.compression)
    path = joint_path(scene, robot, world.t_ipo)
    place = PathCell(robot, world, model_for(scene, robot), path, "tcp", scene.seed)
    loop = place.loop()
    circle = path.q_d[path.counts]
    # Back to the start without a jump: the circle ends where it began.
    once = np.concatenate([circle, np.tile(circle[0], (round(REST / world.t_ipo), 1))])
    count = max(2, round(60.0 * options.minutes / options.compression / (len(once) * world.t_ipo)))
    x_d = np.array([robot.fk()(q).translation for q in once])[: len(circle)]
    results = {}
    ideal = IdealRobot(loop)
    for name, feedforward in (("fixed", ideal), ("adapted", place.feedforward(ADAPTED)), ("oracle", ideal)):
        results[name], temperature = _hour(robot, world, loop, feedforward, once, count, x_d,
                                            oracle=name == "oracle")
    minutes = (np.arange(count) + 0.5) * len(once) * world.t_ipo * options.compression / 60.0
    print(f"{options.minutes:g} min of warm-up in {count * len(once) * world.t_ipo:.0f} s of arm time "
          f"(thermal time {options.compression:g} times faster), joint 1 from 22 to {temperature[-1]:.0f} °C\n")
    print("minute    fixed  adapted   oracle   E_car [mm], time-matched")
    for k in np.unique(np.linspace(0, count - 1, 9).astype(int)):
        print(f"{minutes[k]:6.1f}  " + "  ".join(f"{1e3 * results[name][k]:7.3f}" for name in results))
    whole = {name: float(np.sqrt(np.mean(values**2))) for name, values in results.items()}
    print("\nwhole hour: " + ", ".join(f"{name} {1e3 * value:.3f} mm" for name, value in whole.items())
          + f"; adapted / oracle = {whole['adapted'] / whole['oracle']:.2f}, "
          f"fixed / oracle = {whole['fixed'] / whole['oracle']:.2f}")
    if options.figure is not None:
        options.figure.parent.mkdir(parents=True, exist_ok=True)
        _figure(minutes, results, temperature).savefig(options.figure, dpi=130, bbox_inches="tight")
        print(f"figure: {options.figure}")


def _hour(robot: Robot, world: World, loop: LoopModel, feedforward: Feedforward, once: Array, count: int, x_d: Array,
          *, oracle: bool) -> tuple[Array, Array]:
    """E_car of each circle ``(count,)`` [m] and the temperature of joint 1 at its end [°C]."""
    truth = _true_friction(robot, world, loop)
    lead = round(0.9 / world.t_ipo)
    with SimulatedArm(robot, world, np.random.default_rng(1), once[0]) as arm:
        state = feedforward.init(once[0])
        q_d = np.concatenate([np.tile(once[0], (lead, 1)), np.tile(once, (count, 1)), np.tile(once[-1], (30, 1))])
        for k in range(lead + count * len(once)):
            if oracle and k >= lead and (k - lead) % len(once) == 0:
                feedforward = IdealRobot(loop.replace(**truth(arm.history()["temperature"][-1])))
            q_c, state = feedforward.step(state, q_d[k : k + feedforward.n_d])
            state = feedforward.observe(state, arm.cycle(q_c))
        log = arm.history()
        every = round(world.t_ipo / 0.002)
        q_a, temperature = log["q_a"][::every], log["temperature"][::every, 0]
        fk = robot.fk()
        errors = np.empty(count)
        for i in range(count):
            start = lead + i * len(once)
            x = np.array([fk(q).translation for q in q_a[start : start + len(x_d)]])
            errors[i] = np.sqrt(np.mean(np.sum((x - x_d) ** 2, axis=1)))
    return errors, temperature[lead + len(once) - 1 :: len(once)][:count]


def _true_friction(robot: Robot, world: World, loop: LoopModel) -> Callable[[Array], dict[str, Array]]:
    """True friction at given gear temperatures ``(n,)``, in the units of the measured torque."""
    gain = draw_specimen(robot, world).drive_gain
    speeds = np.maximum(loop.friction_velocity, 1e-9)

    def at(temperature: Array) -> dict[str, Array]:
        columns = [steady_friction(world, robot.n, speeds, temperature=float(temperature[i]))[:, i]
                   for i in range(robot.n)]
        table = np.column_stack(columns) / gain
        dry = np.exp(-world.dry_temperature * (temperature - world.reference_temperature))
        load = dry * world.per_joint("coulomb", robot.n) * world.per_joint("load_friction", robot.n) / robot.tau_max
        return {"friction_torque": np.stack([table, table]), "friction_load": load,
                "friction_bend": world.per_joint("presliding", robot.n)}

    return at


def _figure(minutes: Array, results: dict[str, Array], temperature: Array) -> Figure:
    figure = Figure(figsize=(8.0, 4.0))
    axes = figure.add_subplot()
    colours = {"fixed": "#8893a1", "adapted": "#e06a00", "oracle": "#1c2430"}
    for name, values in results.items():
        axes.plot(minutes, 1e3 * values, label=name, color=colours[name], lw=1.6, ls="--" if name == "oracle" else "-")
    axes.set_xlabel("minutes since switch-on")
    axes.set_ylabel("E_car of each circle, time-matched [mm]")
    axes.set_ylim(bottom=0.0)
    axes.legend(frameon=False, loc="lower right")
    axes.spines[["top"]].set_visible(False)
    warm = axes.twinx()
    warm.plot(minutes, temperature, color="#c2255c", lw=1, ls=":")
    warm.set_ylabel("gear temperature of joint 1 [°C]", color="#c2255c")
    warm.spines[["top"]].set_visible(False)
    return figure


if __name__ == "__main__":
    main()
