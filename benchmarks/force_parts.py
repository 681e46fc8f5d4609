"""What the force error in the workshop is made of, by the simulator's truth, which only the judge sees.

    python benchmarks/force_parts.py [--stiffness 10,20,50] [--seed 1] [--told]

Scene `force_wave` as in ``force_workshop.py``. Root mean squares over the travel, heights in µm:

- plan: the height that was planned against the one at which the force would have been right;
- arm: the height of the tip against the planned one;
- tip: where the program thinks, once its forces have arrived, that the tip was, against where it was;
- the force's error over the travel, and where the tip moves at full speed.

``--told`` plays twice more: with the surface known beforehand (the height at which the force would have been right in
the first play takes the forecast's place), and with the true friction of all joints told besides.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import UnivariateSpline

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.force_workshop import contact_scene
from benchmarks.true_friction import with_true_friction
from ideal_robot.arrays import Array
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.feedforward.method import Setting
from planning.force.contact import Phase
from scenes.force.cell import Cell, set_up, true_tip
from scenes.force.play import BRAKING, LONGEST, REST, calibrated, friction_shown, methods
from scenes.methods import IDEAL, method_of
from scenes.online.cycle import CycleSettings, play_cycles
from scenes.online.force_task import ForceTask
from scenes.scene_files.force_scene import ForceScene
from sim.arm.arm import SimulatedArm
from sim.contact.contact import TipContact
from sim.equipped_arm import CarriedForceSensor, EquippedArm

LATER = 10
"""Cycles after which the forces of a cycle have arrived."""
FULL = 0.95
"""Share of the speed from which on it counts as full."""
SMOOTH = 3e-6
"""Standard deviation of the surface that is told from the one that was found [m]."""


class Watched(ForceTask):
    """Writes down for each cycle of the travel what was planned, where the arm is, and later where it is thought."""

    def watch(self, arm: SimulatedArm) -> None:
        self.arm, self.rows, self.believed = arm, [], {}

    def request(self, t0: float, t1: float) -> None:
        super().request(t0, t1)
        follower = self.follower
        if follower.phase is Phase.TRAVEL:
            self.rows.append((t0, follower.s_at(t0), follower.planned()[1], self.arm.q_a.copy()))
        late = len(self.log.t) - 1 - LATER
        if late >= 0:
            self.believed[self.log.t[late]] = follower.history.q(self.log.t[late])


class KnownSurface:
    """Takes the forecast's place."""

    def __init__(self, s: Array, height: Array) -> None:
        new = np.concatenate([[True], np.diff(s) > 1e-6])
        self._end = float(s[-1])
        self._spline = UnivariateSpline(s[new], height[new], s=np.count_nonzero(new) * SMOOTH**2, k=5)

    def add(self, *_: Any) -> None:
        """Nothing is learned."""

    def height(self, s: Array) -> Array:
        return np.asarray(self._spline(np.clip(s, 0.0, self._end)))


@dataclass(frozen=True)
class Parts:
    """Heights along the travel ``(N,)`` [m] at arc lengths ``s (N,)`` [m]; RMS of the force, also at full speed [N]."""

    s: Array
    right: Array
    planned: Array
    tip: Array
    believed: Array
    rms: float
    at_speed: float

    def line(self) -> list[str]:
        differences = (self.right - self.planned, self.planned - self.tip, self.believed - self.tip)
        heights = [f"{1e6 * np.sqrt(np.mean(one**2)):.0f}" for one in differences]
        return [*heights, f"{self.rms:.2f}", f"{self.at_speed:.2f}"]


def played(scene: ForceScene, method: Any = IDEAL, surface: KnownSurface | None = None) -> Parts:
    """One play, taken apart.

    Args:
        scene: what is played.
        method: a key or a factory.
        surface: known beforehand; None for what is felt.
    """
    tool, elasticity = calibrated(scene)
    cell = set_up(scene)
    task = Watched(cell, method_of(method, methods()), None, tool, elasticity, cell.camera_streams[0],
                   friction_shown(scene))
    if surface is not None:
        task.follower._forecast = surface
    with SimulatedArm(cell.robot, cell.world, cell.noise, task.q_start) as arm:
        contact = TipContact(arm, cell.surface, true_tip(scene.tip))
        sensor = CarriedForceSensor(cell.sensor, arm, contact)
        task.connect(sensor, None)
        task.watch(arm)
        duration = cell.profile.duration
        play_cycles(EquippedArm(arm, [sensor]), cell.robot, task, task.log,
                    CycleSettings(BRAKING, REST * arm.t_ipo, duration + LONGEST, duration + 2.0, "ideal"),
                    lambda *_: None)
        history = contact.history()
    if task.log.failure:
        raise SystemExit(task.log.failure)
    return _parts(cell, task, scene, history)


def _parts(cell: Cell, task: Watched, scene: ForceScene, history: dict[str, Array]) -> Parts:
    fk, reference = cell.robot.fk(), task.follower.reference

    def height(q: Array, s: float) -> float:
        return float(reference.project(fk(q).translation[None], s, span=0.06)[2][0])

    rows = [row for row in task.rows if row[0] in task.believed]
    t, s, planned = (np.array([row[i] for row in rows]) for i in range(3))
    tip = np.array([height(q_a, at) for _, at, _, q_a in rows])
    believed = np.array([height(task.believed[at], place) for at, place, _, _ in rows])
    wrong = np.interp(t, history["t"], history["normal"]) - scene.force
    travel = (history["t"] >= t[0]) & (history["t"] <= t[-1])
    rms = float(np.sqrt(np.mean((history["normal"][travel] - scene.force) ** 2)))
    fast = np.gradient(s, t) > FULL * scene.speed
    at_speed = float(np.sqrt(np.mean(wrong[fast] ** 2)))
    return Parts(s, tip + wrong / scene.tip.stiffness, planned, tip, believed, rms, at_speed)


def knowing_friction(scene: ForceScene) -> Any:
    """A factory of the ideal robot that is told the true friction.

    Args:
        scene: whose arm it is.
    """
    cell = set_up(scene)

    def ideal_with_true_friction(setting: Setting) -> Feedforward:
        every = list(range(1, cell.robot.n + 1))
        return IdealRobot(with_true_friction(setting.loop(), cell.robot, cell.world, every), setting.horizon(30))

    return ideal_with_true_friction


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--stiffness", default="10,20,50", help="[N/mm]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--told", action="store_true", help="surface, and then friction, known beforehand besides")
    options = parser.parse_args()
    five = ["plan µm", "arm µm", "tip µm", "RMS N", "at full speed"]
    told = ["surface known: plan", *five[1:], "and friction: plan", *five[1:]]
    columns = ["contact", *five, *(told if options.told else [])]
    print(f"| {' | '.join(columns)} |\n{'| --- ' * len(columns)}|")
    for k in (float(one) for one in options.stiffness.split(",")):
        scene = contact_scene(k, options.seed)
        felt = played(scene)
        cells = felt.line()
        if options.told:
            surface = KnownSurface(felt.s, felt.right)
            cells += played(scene, surface=surface).line()
            cells += played(scene, knowing_friction(scene), surface).line()
        print(f"| {k:g} N/mm | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
