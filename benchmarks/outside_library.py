"""Causes outside the effect library: closed by learned curves, against an oracle that is told the true formula.

``python -m benchmarks.outside_library`` closes three arms (KR 15, a circle) and prints path errors before, after and
with the oracle, as Markdown:

- drag in joint 2 that grows with the angle of joint 3,
- a hose that pulls joint 3 back behind a bend,
- friction of joint 1 that differs by place.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Callable

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects import FittedEffect, Signals
from ideal_robot.feedforward.ideal import IdealRobot
from scenes import load_scene
from scenes.closing.result import Closing
from scenes.methods import IDEAL
from scenes.path.cell import PathCell, set_up
from scenes.path.close_loop import closed
from scenes.scene_files.path_scene import PathScene

Formula = Callable[[Array, Array, Array], Array]
"""``(q, qd, direction) -> torque (N,)`` [N m] that the motor has to give besides; ``q``, ``qd`` are ``(N, n)``."""


@dataclasses.dataclass(frozen=True)
class Outside:
    """One cause.

    Attributes:
        name: of it.
        joint: on whose motor it acts, from 1.
        formula: what the motor has to give.
    """

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


def crossed_drag(joint: int, other: int, size: float, middle: float, span: float) -> Outside:
    """Dry drag that grows with the angle of another joint, from nothing to ``size`` [N m].

    Args:
        joint: that is braked, from 1.
        other: whose angle counts, from 1.
        size: largest drag [N m].
        middle: angle at which it is half [rad].
        span: from none to all [rad].
    """
    def formula(q: Array, qd: Array, direction: Array) -> Array:
        return np.asarray(size * np.clip(0.5 + (q[:, other - 1] - middle) / span, 0.0, 1.0) * direction)
    return Outside(f"drag of joint {joint} by the angle of joint {other}", joint, formula)


def hose(joint: int, stiffness: float, bend: float, side: float) -> Outside:
    """A hose that pulls back once it is taut.

    Args:
        joint: that is pulled, from 1.
        stiffness: of the taut hose [N m/rad].
        bend: angle from which it is taut [rad].
        side: 1 where it is taut above, -1 below.
    """
    return Outside(f"hose at joint {joint}", joint,
                   lambda q, qd, direction: side * stiffness * np.maximum(side * (q[:, joint - 1] - bend), 0.0))


def slack_at_first(cell: PathCell, joint: int, stiffness: float) -> Outside:
    """A hose that is slack where the path begins and taut on half of the way to its far end.

    Args:
        cell: with the path.
        joint: that is pulled, from 1.
        stiffness: of the taut hose [N m/rad].
    """
    q = cell.path.q_d[:, joint - 1]
    far = q[np.argmax(np.abs(q - q[0]))]
    return hose(joint, stiffness, float(0.5 * (q[0] + far)), float(np.sign(far - q[0])))


def place_friction(joint: int, size: float, place: float, width: float) -> Outside:
    """Dry friction that is larger about a place.

    Args:
        joint: that is braked, from 1.
        size: surplus there [N m].
        place: its middle [rad].
        width: standard width [rad].
    """
    return Outside(f"friction of joint {joint} by place", joint, lambda q, qd, direction: size * np.exp(
        -0.5 * ((q[:, joint - 1] - place) / width) ** 2) * direction)


def with_cause(cell: PathCell, cause: Outside) -> PathCell:
    """The cell with an arm that has the cause; its direction of sliding turns within 0.3 mrad."""
    bent = np.zeros(1)
    last = np.zeros(1)

    def extra(t: float, q: Array, qd: Array, q_a: Array) -> Array:
        j = cause.joint - 1
        if t == 0.0:
            bent[0], last[0] = 0.0, q[j]
        side = np.sign(q[j] - last[0])
        bent[0] = side + (bent[0] - side) * np.exp(-abs(q[j] - last[0]) / 3e-4)
        last[0] = q[j]
        result = np.zeros(len(q))
        result[j] = -cause.formula(q[None], qd[None], bent)[0]
        return result
    return dataclasses.replace(cell, world=cell.world.replace(extra_torque=extra))


def oracle_of(cell: PathCell, cause: Outside) -> IdealRobot:
    """The ideal robot that knows the cause by its formula."""
    told = Told("told", cause.joint, "tau", (), cause=cause)
    return IdealRobot(cell.loop().replace(terms=(*cell.loop().terms, told)))


def close_outside(scene: PathScene, cell: PathCell, cause: Outside, *, measured: str = "tcp",
                  rounds: int = 3) -> Closing:
    """Closes a cell whose arm has the cause.

    Args:
        scene: whose path it is.
        cell: with the arm as the model knows it.
        cause: outside the library.
        measured: what the arm measures.
        rounds: at most.
    """
    arm = with_cause(cell, cause)
    return closed(scene, arm, ((cause.name, cause.joint),), measured=measured, oracle=oracle_of(cell, cause),
                  rounds_at_most=rounds)


def main() -> None:
    """Closes the three."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size-mm", type=float, default=250.0, help="diameter of the circle")
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--measured", default="tcp", choices=("motor", "arm", "tcp"))
    parser.add_argument("--steps", action="store_true", help="every change that was tried")
    parser.add_argument("--only", type=int, help="0, 1 or 2: this cause alone")
    parser.add_argument("--floor", action="store_true", help="no closing: the path before, and with the oracle")
    given = parser.parse_args()
    scene = load_scene("close_stribeck").changed(path={"size_mm": given.size_mm}, speed=0.5)
    assert isinstance(scene, PathScene)
    scene = scene.model_copy(update={"world": {}})
    cell = set_up(scene, delay=False)
    low, high = np.min(cell.path.q_d, axis=0), np.max(cell.path.q_d, axis=0)
    causes = [crossed_drag(2, 3, 120.0, float(0.5 * (low + high)[2]), float((high - low)[2])),
              slack_at_first(cell, 3, 600.0),
              place_friction(1, 120.0, float(high[0]), float(0.35 * (high - low)[0]))]
    if given.floor:
        print("| cause | E_car before mm | oracle mm |\n| --- | --- | --- |")
        for cause in causes:
            arm = with_cause(cell, cause)
            plays = [arm.play(law) for law in (arm.feedforward(IDEAL), oracle_of(cell, cause))]
            errors = [1e3 * played.errors.aligned.E_car for played in plays]
            print(f"| {cause.name} | {errors[0]:.3f} | {errors[1]:.3f} |", flush=True)
        return
    print("| cause | E_car before mm | after mm | oracle mm | taken | CPU s |\n| --- | --- | --- | --- | --- | --- |")
    for i, cause in enumerate(causes):
        if given.only not in (None, i):
            continue
        begun = time.process_time()
        result = close_outside(scene, cell, cause, measured=given.measured, rounds=given.rounds)
        errors = [1e3 * e.aligned.E_car for e in result.errors.values()]
        taken = "; ".join(step.tried for step in result.steps if step.taken) or "nothing"
        print(f"| {cause.name} | {errors[0]:.3f} | {errors[1]:.3f} | {errors[2]:.3f} | {taken} | "
              f"{time.process_time() - begun:.0f} |", flush=True)
        for step in result.steps if given.steps else ():
            print(f"    round {step.round}, {step.tried}: {'taken' if step.taken else step.refused}", flush=True)


if __name__ == "__main__":
    main()
