"""The floor of a friction scene: its path played by an ideal robot that is told the true friction of the joints.

``python benchmarks/true_friction.py close_stribeck --world '{"stribeck": [22.0, 24.0, 75.0, 2.6, 2.4, 1.3]}'``

Rows: the model as it was; the true steady friction (its curve over speed, its growth with load, the way over which it
turns) of the joints whose friction the scene changed, in place of the model's; and of all joints. What is then left is
what no better number of friction takes away.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.robots.robot import Robot
from scenes import load_scene
from scenes.path.cell import set_up
from scenes.scene_files.path_scene import PathScene
from scenes.undeclared import undeclared_effects
from sim.arm.drive import steady_friction
from sim.arm.specimen import draw_specimen
from sim.arm.world import World


def with_true_friction(loop: LoopModel, robot: Robot, world: World, joints: list[int]) -> LoopModel:
    """The identified loop with the true friction of some joints (from 1), in the units of the measured torque.

    Args:
        loop: identified.
        robot: the arm.
        world: the arm as it is.
        joints: from 1.
    """
    gain = draw_specimen(robot, world).drive_gain
    speeds = np.maximum(loop.friction_velocity, 1e-9)
    warm = float(world.per_joint("start_temperature", robot.n)[0])
    sides = [sign * steady_friction(world, robot.n, sign * speeds, temperature=warm) / gain for sign in (1.0, -1.0)]
    at = np.isin(np.arange(robot.n) + 1, joints)
    load = world.per_joint("coulomb", robot.n) * world.per_joint("load_friction", robot.n) / robot.tau_max
    return loop.replace(friction_torque=np.where(at, np.stack(sides), loop.friction_torque),
                        friction_load=np.where(at, load, loop.friction_load),
                        friction_bend=np.where(at, world.per_joint("presliding", robot.n), loop.friction_bend))


def main() -> None:
    """Plays the scene three times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", nargs="?", default="close_stribeck")
    parser.add_argument("--world", type=json.loads, default={}, help="keys of the world to change, as JSON")
    given = parser.parse_args()
    scene = load_scene(given.scene).changed(world=given.world)
    if not isinstance(scene, PathScene):
        parser.error("expected a scene of kind path")
    cell = set_up(scene, delay=False)
    changed = sorted({joint for _, joint in undeclared_effects(scene, cell.robot.n)})
    every = list(range(1, cell.robot.n + 1))
    print("| friction told | E_car aligned mm | E_max aligned mm |\n| --- | --- | --- |")
    for name, joints in (("none: the model as it was", []), (f"true in joint {', '.join(map(str, changed))}", changed),
                         ("true in all joints", every)):
        loop = with_true_friction(cell.loop(), cell.robot, cell.world, joints) if joints else cell.loop()
        error = cell.play(IdealRobot(loop)).errors.aligned
        print(f"| {name} | {1e3 * error.E_car:.3f} | {1e3 * error.E_max:.3f} |", flush=True)


if __name__ == "__main__":
    main()
