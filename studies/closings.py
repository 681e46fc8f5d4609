"""Closings of an arm with a cause outside the effect library, beside an oracle; floors of friction scenes."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects import FittedEffect, Signals
from ideal_robot.feedforward.inverse import Inverse
from ideal_robot.loop.loop import Loop
from ideal_robot.robots.robot import Robot
from scenes import load_scene
from scenes.closing.result import Closing, checked_measured
from scenes.path.cell import PathCell, set_up
from scenes.path.close_loop import ArmOnPath, closed
from scenes.scene_files.path_scene import PathScene
from sim.arm.drive import steady_friction
from sim.arm.specimen import draw_specimen
from sim.arm.world import World
from studies.report import head, row

# Causes outside the effect library closed by learned curves, and floors: paths whose robot is told the truth.

Formula = Callable[[Array, Array, Array], Array]
"""``(q, qd, direction) -> torque (N,)`` [N m] that the motor has to give besides; ``q``, ``qd`` are ``(N, n)``."""
TURNING = 3e-4
"""Way over which a cause's direction of sliding turns [rad]."""


@dataclasses.dataclass(frozen=True)
class Outside:
    """One cause: its name, the joint on whose motor it acts (from 1), and what the motor has to give."""

    name: str
    joint: int
    formula: Formula


@dataclasses.dataclass(frozen=True)
class Told(FittedEffect):
    """The true cause as an oracle knows it."""

    cause: Outside | None = None

    def contribution(self, signals: Signals) -> Array:
        """See ``FittedEffect.contribution``."""
        assert self.cause is not None
        direction = signals.sliding_direction(self.joint)
        return signals.on_joint(self.joint, self.cause.formula(signals.q, signals.qd, direction))[:, :, 0]


def causes_along(cell: PathCell, drag: float, pull: float, surplus: float) -> tuple[Outside, Outside, Outside]:
    """Drag of joint 2 by the angle of joint 3 up to ``drag``, a hose at joint 3, friction of joint 1 by place.

    Args:
        cell: whose path they change along: the hose is slack where it begins and taut on half of the way.
        drag: largest drag [N m].
        pull: stiffness of the taut hose [N m/rad].
        surplus: of friction at its place [N m].
    """
    q = cell.path.q_d
    low, high = np.min(q, axis=0), np.max(q, axis=0)
    span, middle = high - low, 0.5 * (low + high)
    far = q[np.argmax(np.abs(q[:, 2] - q[0, 2])), 2]
    side, bend = float(np.sign(far - q[0, 2])), float(0.5 * (q[0, 2] + far))

    def dragged(q: Array, qd: Array, direction: Array) -> Array:
        return np.asarray(drag * np.clip(0.5 + (q[:, 2] - middle[2]) / span[2], 0.0, 1.0) * direction)

    def pulled(q: Array, qd: Array, direction: Array) -> Array:
        return side * pull * np.maximum(side * (q[:, 2] - bend), 0.0)

    def rubbed(q: Array, qd: Array, direction: Array) -> Array:
        return surplus * np.exp(-0.5 * ((q[:, 0] - high[0]) / (0.35 * span[0])) ** 2) * direction

    return (Outside("drag of joint 2 by the angle of joint 3", 2, dragged), Outside("hose at joint 3", 3, pulled),
            Outside("friction of joint 1 by place", 1, rubbed))


def _with_cause(cell: PathCell, cause: Outside) -> PathCell:
    """The cell with an arm that has the cause."""
    bent, last, j = np.zeros(1), np.zeros(1), cause.joint - 1

    def extra(t: float, q: Array, qd: Array, q_a: Array) -> Array:
        if t == 0.0:
            bent[0], last[0] = 0.0, q[j]
        side = np.sign(q[j] - last[0])
        bent[0] = side + (bent[0] - side) * np.exp(-abs(q[j] - last[0]) / TURNING)
        last[0] = q[j]
        result = np.zeros(len(q))
        result[j] = -cause.formula(q[None], qd[None], bent)[0]
        return result

    return dataclasses.replace(cell, world=cell.world.replace(extra_torque=extra))


def close_outside(scene: PathScene, cell: PathCell, cause: Outside, *, measured: str, rounds: int) -> Closing:
    """Closes a cell whose arm has the cause, beside an oracle that is told its formula.

    Args:
        scene: whose path it is.
        cell: with the arm as the model knows it.
        cause: outside the library.
        measured: what the arm measures.
        rounds: at most.
    """
    loop = cell.loop()
    oracle = Inverse(loop.changed(terms=(*loop.terms, Told("told", cause.joint, "tau", (), cause=cause))))
    subject = ArmOnPath(_with_cause(cell, cause), checked_measured(measured))
    return closed(scene, subject, ((cause.name, cause.joint),), oracle=oracle, rounds_at_most=rounds)


def outside(size_mm: float = 250.0, rounds: int = 2, measured: str = "tcp") -> None:
    """Three causes outside the library, each closed on a KR 15 along a circle of --size-mm, beside an oracle.

    Drag in joint 2 that grows with the angle of joint 3, a hose that pulls joint 3 back behind a bend, friction of
    joint 1 that differs by place. --measured is what the arm measures: motor, arm or tcp.
    """
    scene = load_scene("close_stribeck").changed(path={"size_mm": size_mm}, speed=0.5)
    assert isinstance(scene, PathScene)
    scene = scene.model_copy(update={"world": {}})
    cell = set_up(scene, delay=False)
    head("cause", "E_car before", "after", "oracle", "taken", "CPU s")
    for cause in causes_along(cell, 120.0, 600.0, 120.0):
        begun = time.process_time()
        result = close_outside(scene, cell, cause, measured=measured, rounds=rounds)
        row(cause.name, *(f"{1e3 * e.aligned.E_car:.3f} mm" for e in result.errors.values()),
            "; ".join(step.tried for step in result.steps if step.taken) or "nothing",
            f"{time.process_time() - begun:.0f}")


def with_true_friction(loop: Loop, robot: Robot, world: World, joints: list[int],
                       temperature: Array | None = None) -> Loop:
    """The identified loop with the true friction of some joints (from 1), in the units of the measured torque.

    Args:
        loop: identified.
        robot: the arm.
        world: the arm as it is.
        joints: from 1.
        temperature: of the gears ``(n,)`` [°C]; as the arm starts if None.
    """
    gain, n = draw_specimen(robot, world).drive_gain, robot.n
    speeds = np.maximum(loop.friction.speeds, 1e-9).T
    warm = world.per_joint("start_temperature", n) if temperature is None else temperature
    whole = np.stack([sign * steady_friction(world, n, sign * speeds, temperature=warm).T / gain[:, None]
                      for sign in (1.0, -1.0)], axis=1)
    # What falls with speed is dry (Stribeck), what rises is the lubricant's.
    falling = np.minimum.accumulate(whole, axis=2)
    sizes, per_load = loop.friction.sizes.copy(), loop.friction.per_load.copy()
    load = (np.exp(-world.dry_temperature * (warm - world.reference_temperature)) * world.per_joint("coulomb", n)
            * world.per_joint("load_friction", n) / robot.tau_max)
    mask = np.isin(np.arange(n) + 1, joints)
    sizes[mask] = np.stack([falling, whole - falling], axis=3)[mask]
    per_load[mask, 0] = load[mask]
    # Bristles have the stiffness that Coulomb friction gives them.
    further = 1.0 + world.per_joint("stribeck", n) / np.maximum(world.per_joint("coulomb", n), 1e-9)
    distance = np.where(mask, further * world.per_joint("presliding", n), loop.friction.distance)
    return loop.changed(sizes=sizes, per_load=per_load, distance=distance)
