"""Closings of arms and cameras drawn at random: never worse than before, and how close to an oracle.

Drawn, by the seed: path or line (every fifth), robot, individual, place, size and speed, what the arm measures (half:
motor angles and currents alone), and the misfit: a fifth have none, a fifth one outside the library, the others one or
two effects, two to ten times what can be seen at all: of an arm a quarter of 0.5 % of the torque limit, of 20 µrad of
arm angle or of 20 µm of the tool; of a camera one or two of time stamps (2 to 10 ms), their drift (0.6 to 3 ms/s),
focal length (1 to 4 %), height (1 to 5 mm), yaw and pitch (0.3° to 1.5°), and the lens (k1 of 0.02 to 0.08).
"""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import typer

from ideal_robot.arrays import Array, G
from ideal_robot.effects import FittedEffect, Signals
from ideal_robot.errors import IdealRobotError, InputError
from ideal_robot.feedforward.inverse import Inverse
from ideal_robot.loop.loop import Loop
from ideal_robot.results import plain
from ideal_robot.robots.robot import Robot
from scenes import load_scene
from scenes.arms import arm_of
from scenes.closing.result import Closing, checked_measured
from scenes.line import close_loop as line_closing
from scenes.models import model_for
from scenes.path.cell import PathCell, set_up
from scenes.path.close_loop import ArmOnPath, closed
from scenes.scene_files.line_scene import LineScene
from scenes.scene_files.path_scene import PathScene
from scenes.undeclared import undeclared_effects
from sim.arm.drive import steady_friction
from sim.arm.specimen import draw_specimen
from sim.arm.world import World
from studies.report import head, row

FIRST_INDIVIDUAL = 1
"""The one whose model is shipped."""
WORSE_SHARE, WORSE_LEAST = 0.05, 3e-3
"""Never worse than before by more than this share, or this many mm."""
PLACES = {"kr15": ((1.05, 0.0, 0.95), 45.0), "manutec_r15": ((0.8, 0.0, 0.75), 90.0)}
"""Centre of the circles [m] and tilt of their plane [°]."""
TORQUE = ("coulomb", "viscous", "stribeck", "degressive", "friction_asymmetry", "load_friction", "extra_rotor_inertia",
          "torque_ripple", "payload_mass")
BEHIND = ("stiffness", "transmission_error", "backlash", "kinematic_error")
SEEN, TWIST = 0.25 * 0.005, 5e-6
"""What can be seen at all: share of the torque limit, arm angle [rad]."""
SIZES = {"camera.stamp_offset": (2e-3, 10e-3), "camera.stamp_drift": (6e-4, 3e-3),
         "calibration.focal_percent": (1.0, 4.0),
         "calibration.height_mm": (1.0, 5.0), "calibration.yaw_deg": (0.3, 1.5), "calibration.pitch_deg": (0.3, 1.5),
         "calibration.k1": (0.02, 0.08)}
"""Least and most of what is wrong with a camera, by key."""
_CALIBRATION = ("roll_deg", "pitch_deg", "yaw_deg", "height_mm", "lateral_mm", "focal_percent", "principal_px", "k1")


def closings(files: list[Path], count: int = 100, first: int = 0, step: int = 1, individuals: int = 3,
             rounds: int = 3) -> None:
    """Closes arms and cameras drawn at random, and prints what the FILES then say; with --count 0 nothing is played.

    The first file gets a line a closing; what any of them holds is not played again. --step 2 is for two processes:
    --first 0 into one file, --first 1 into another. --individuals arms of each type, all but the first identified.
    """
    texts = [file.read_text(encoding="utf-8") for file in files if file.exists()]
    lines = [json.loads(line) for text in texts for line in text.splitlines()]
    done = {line["seed"] for line in lines}
    for seed in range(first, first + count, step):
        if seed in done:
            continue
        line = _one_closing(seed, individuals, rounds)
        lines.append(json.loads(json.dumps(plain(line), allow_nan=False)))
        with files[0].open("a", encoding="utf-8") as file:
            file.write(json.dumps(lines[-1]) + "\n")
        print(json.dumps({key: line.get(key) for key in ("seed", "scene", "kind", "measured", "error_mm", "cpu_s",
                                                         "failed")}), flush=True)
    print("", _table(lines), sep="\n")


def _drawn_scene(rng: np.random.Generator, individuals: int) -> PathScene:
    """A circle on one arm."""
    robot = str(rng.choice(list(PLACES)))
    centre, tilt = PLACES[robot]
    individual = FIRST_INDIVIDUAL + int(rng.integers(individuals))
    scene = load_scene("close_stribeck").changed(
        robot=robot, seed=int(rng.integers(1, 10**6)), speed=float(rng.uniform(0.25, 0.5)),
        path={"size_mm": float(rng.uniform(120.0, 220.0)), "tilt_deg": tilt,
              "centre": [float(c + rng.uniform(-0.05, 0.05)) for c in centre]})
    assert isinstance(scene, PathScene)
    own = {"world": {"individual": individual}, "model": "own"} if individual != FIRST_INDIVIDUAL else {"world": {}}
    return scene.model_copy(update=own)


def _drawn_misfit(rng: np.random.Generator, robot: Robot, world: World, count: int) -> dict[str, Any]:
    """Keys of a world with one or two effects of two to ten times what can be seen."""
    result: dict[str, Any] = {}
    n, torque = robot.n, SEEN * np.where(np.isfinite(robot.tau_max), robot.tau_max, 100.0)
    for key in map(str, rng.choice([*TORQUE, *BEHIND], count, replace=False)):
        j, times = int(rng.integers(min(n, 3))), float(rng.uniform(2.0, 10.0))
        usual = world.per_joint(key, n) if isinstance(getattr(world, key), (float, tuple)) else np.zeros(n)
        size, coulomb = times * torque[j], world.per_joint("coulomb", n)[j]
        if key == "payload_mass":
            result |= {"payload_mass": times * float(torque[1]) / G, "payload_com": [0.02, 0.01, 0.08]}
        elif key == "kinematic_error":
            result["kinematic_error"] = times * 2e-5
        else:
            # A stribeck shows near standstill alone, in a few per cent of the time.
            own = {"coulomb": usual[j] + size, "degressive": usual[j] + size, "stribeck": usual[j] + 5.0 * size,
                   "viscous": usual[j] + size / 0.3, "friction_asymmetry": usual[j] + min(size / coulomb, 0.5),
                   "load_friction": usual[j] + 10.0 * size / coulomb, "extra_rotor_inertia": size / 1.5,
                   "torque_ripple": usual[j] + np.sqrt(2.0) * times * SEEN,
                   "stiffness": 1.0 / (1.0 / usual[j] + times * TWIST / (80.0 * torque[j])) if usual[j] else 0.0,
                   "transmission_error": np.sqrt(2.0) * times * TWIST, "backlash": 2.0 * times * TWIST}[key]
            result[key] = [float(own if i == j else value) for i, value in enumerate(usual)]
    return result


def drawn_line(rng: np.random.Generator) -> LineScene:
    """A wavy line under a camera that is right."""
    length, height = float(rng.uniform(0.6, 1.0)), float(rng.uniform(0.02, 0.05))
    scene = load_scene("close_camera").changed(
        world="bench", seed=int(rng.integers(1, 10**6)), speed=float(rng.uniform(0.4, 0.7)),
        camera={"stamp_drift": 0.0},
        line={"formula": f"{height:.4f}*sin(2*pi*x/{rng.uniform(0.5, 0.8):.3f})", "length": length},
        calibration=dict.fromkeys(_CALIBRATION, 0.0))
    assert isinstance(scene, LineScene)
    return scene


def drawn_error(rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """One or two things that are wrong with a camera, as tables of the scene."""
    result: dict[str, dict[str, float]] = {}
    for key in map(str, rng.choice(list(SIZES), int(rng.integers(1, 3)), replace=False)):
        table, name = key.split(".")
        # The sizes of a calibration's errors have the signs that the scene's seed draws.
        sign = float(rng.choice([-1.0, 1.0])) if table == "camera" else 1.0
        result.setdefault(table, {})[name] = sign * float(rng.uniform(*SIZES[key]))
    return result


def _one_closing(seed: int, individuals: int, rounds: int) -> dict[str, Any]:
    """Draws and closes one arm, or one camera."""
    rng = np.random.default_rng([seed, 14])
    kind = ("none", "outside", "library", "library", "library")[seed % 5]
    measured = "motor" if (seed // 5) % 2 == 0 else "tcp"
    begun, wall = time.process_time(), time.monotonic()
    line: dict[str, Any] = {"seed": seed, "kind": kind, "measured": measured}
    try:
        if (seed // 10) % 2 == 1 and seed % 5 in (0, 4):
            line |= {"scene": "line", **_closed_line(rng, kind == "none", measured)}
        else:
            line |= {"scene": "path", **_closed_path(rng, kind, measured, individuals, rounds)}
    except IdealRobotError as error:
        return {**line, "failed": str(error)}
    return {**line, "cpu_s": time.process_time() - begun, "wall_s": time.monotonic() - wall}


def _closed_line(rng: np.random.Generator, right: bool, measured: str) -> dict[str, Any]:
    scene = drawn_line(rng)
    misfit = {} if right else drawn_error(rng)
    hidden = scene.changed(**misfit) if misfit else scene
    assert isinstance(hidden, LineScene)
    undeclared = () if right else line_closing.undeclared_effects(hidden)
    values = line_closing.closed(hidden, undeclared, measured=measured).json()
    return {"robot": scene.robot, "speed": scene.speed, "misfit": misfit, "undeclared": values["undeclared"],
            "error_mm": {name: values["path_error_mm"][name]["mean"] for name in ("before", "after", "oracle", "true")},
            "steps": values["steps"]}


def _closed_path(rng: np.random.Generator, kind: str, measured: str, individuals: int, rounds: int) -> dict[str, Any]:
    scene = _drawn_scene(rng, individuals)
    robot = arm_of(scene.robot)
    cell = set_up(scene, delay=False, model=model_for(scene, robot))
    result, misfit = _with_misfit(rng, kind, scene, cell, measured, rounds)
    values = result.json()
    return {"robot": scene.robot, "individual": cell.world.individual, "speed": scene.speed,
            "size_mm": scene.path.size_mm, "misfit": misfit, "error_mm": values["E_car_aligned_mm"],
            "undeclared": values["undeclared"], "steps": values["steps"]}


def _with_misfit(rng: np.random.Generator, kind: str, scene: PathScene, cell: PathCell, measured: str,
                 rounds: int) -> tuple[Closing, Any]:
    robot = cell.robot
    if kind == "none":
        return closed(scene, ArmOnPath(cell, checked_measured(measured)), (), rounds_at_most=rounds), {}
    if kind == "outside":
        size = float(rng.uniform(2.0, 10.0) * SEEN * robot.tau_max[1] * 4.0)
        cause = causes_along(cell, size, 4.0 * size, size)[int(rng.integers(3))]
        result = close_outside(scene, cell, cause, measured=measured, rounds=rounds)
        return result, {"outside": cause.name, "size": size}
    misfit = _drawn_misfit(rng, robot, cell.world, int(rng.integers(1, 3)))
    hidden = scene.model_copy(update={"world": {**scene.world, **misfit}})
    arm = PathCell(robot, cell.world.replace(**misfit), cell.model, cell.path, cell.learn_from, cell.seed)
    subject = ArmOnPath(arm, checked_measured(measured))
    return closed(hidden, subject, undeclared_effects(hidden, robot.n), rounds_at_most=rounds), misfit


def _table(lines: list[dict[str, Any]]) -> str:
    """What the closings say, as Markdown."""
    played = [closing for closing in lines if "failed" not in closing]
    if not played:
        raise InputError("no closing has been played yet", field="FILES")
    errors = np.array([[closing["error_mm"][name] for name in ("before", "after", "oracle")] for closing in played])
    # An oracle that makes the path worse is the arm as it was.
    errors[:, 2] = np.minimum(errors[:, 2], errors[:, 0])
    groups = {"all": np.ones(len(played), dtype=bool)}
    for key, values in (("measured", ("motor", "tcp")), ("scene", ("path", "line")),
                        ("kind", ("none", "outside", "library"))):
        groups |= {value: np.array([closing[key] == value for closing in played]) for value in values}
    rows = ["| what | " + " | ".join(groups) + " |", "| --- |" + " --- |" * len(groups)]
    worse = errors[:, 1] > errors[:, 0] + np.maximum(WORSE_SHARE * errors[:, 0], WORSE_LEAST)
    ratio = errors[:, 1] / errors[:, 2]
    taken = np.array([any(step["taken"] for step in closing["steps"]) for closing in played])

    def row(name: str, cell: Any) -> None:
        rows.append(f"| {name} | " + " | ".join(cell(g) if g.any() else "" for g in groups.values()) + " |")

    row("closings", lambda g: str(int(g.sum())))
    row("worse than before by more than 5 % and 3 µm", lambda g: str(int(worse[g].sum())))
    row("model changed", lambda g: str(int(taken[g].sum())))
    row("median after / before", lambda g: f"{np.median(errors[g, 1] / errors[g, 0]):.2f}")
    row("median oracle / before", lambda g: f"{np.median(errors[g, 2] / errors[g, 0]):.2f}")
    row("median after / oracle", lambda g: f"{np.median(ratio[g]):.2f}")
    row("after ≤ 1.5 × oracle", lambda g: f"{int(np.sum(ratio[g] <= 1.5))} of {int(g.sum())}")
    if len(played) < len(lines):
        rows.append(f"\n{len(lines) - len(played)} could not be played.")
    return "\n".join(rows)


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


def true_friction(scene: str = "close_stribeck", world: str = "{}") -> None:
    """The floor of a friction scene: its path by an ideal robot that is told the true friction of the joints.

    --world holds keys of the world to change, as JSON. Rows: the model as it was; the true steady friction (its curve
    over speed, its growth with load, the way over which it turns) of the joints whose friction the scene changed; and
    of all joints. What is then left is what no better number of friction takes away.
    """
    played = load_scene(scene).changed(world=json.loads(world))
    if not isinstance(played, PathScene):
        raise typer.BadParameter("expected a scene of kind path")
    cell = set_up(played, delay=False)
    changed = sorted({joint for _, joint in undeclared_effects(played, cell.robot.n)})
    head("friction known", "E_car aligned", "E_max aligned")
    for name, joints in (("none: the model as it was", []), (f"true in joint {', '.join(map(str, changed))}", changed),
                         ("true in all joints", list(range(1, cell.robot.n + 1)))):
        loop = with_true_friction(cell.loop(), cell.robot, cell.world, joints) if joints else cell.loop()
        error = cell.play(Inverse(loop)).errors.aligned
        row(name, f"{1e3 * error.E_car:.3f} mm", f"{1e3 * error.E_max:.3f} mm")
