"""A user's way: shipped scenes with one hidden thing each, played, and diagnosed against the shipped model."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ideal_robot.diagnosis import Diagnosis, diagnose
from ideal_robot.identification.inspection import inspect
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes import load_scene, run_scene, shipped_model
from studies.report import head, row

SCENES = ("line", "edge", "iso9283_1", "iso9283_2", "iso9283_3", "force_wave", "vertical_circle")


@dataclass(frozen=True)
class Hidden:
    """One thing that a user's arm has and its model lacks.

    Attributes:
        words: for people.
        world: keys of the scene's world.
        names: causes that say it, and their joint; 0 for the whole arm.
        joint: of the cause.
    """

    words: str
    world: dict[str, Any]
    names: tuple[str, ...] = ()
    joint: int = 0


FRICTION = ("coulomb", "viscous", "degressive", "load_dependent_friction")
HIDDEN = {
    "nothing": Hidden("nothing", {}),
    "payload": Hidden("4 kg at the tool", {"payload_mass": 4.0}, ("payload",)),
    "backlash": Hidden("0.8 mrad of play in joint 2", {"backlash": [0.0, 0.8e-3, 0.0, 0.0, 0.0, 0.0]},
                       ("backlash", "encoder_offset"), 2),
    "friction": Hidden("1.5 times the friction in joint 3", {"friction_scale": [1.0, 1.0, 1.5, 1.0, 1.0, 1.0]},
                       FRICTION, 3),
    "cold": Hidden("a start at 15 °C", {"start_temperature": 15.0}, ("warmth",)),
    "soft": Hidden("half the stiffness in joint 3", {"stiffness_scale": [1.0, 1.0, 0.5, 1.0, 1.0, 1.0]},
                   ("joint_elasticity",), 3),
    "balancer": Hidden("a balancer of 600 N m on joint 2", {"balancer": 600.0}, ("gravity_spring",), 2),
}


def users_way(scenes: str = ",".join(SCENES), hidden: str = ",".join(HIDDEN), seed: int = 1, individual: int = 1,
              lines: Path | None = None) -> None:
    """Shipped scenes with one hidden thing each, played, and diagnosed against the shipped model.

    A cause that the motion cannot tell apart counts as found where it stands among those that are said to be as
    likely: a gap that is never crossed is a moved encoder. A recording is accused where it is said to hold other units,
    signs, axes or no gravity; none does. --individual 2 and above are other arms of the type.
    --lines FILE gets a line a play.
    """
    rows = []
    for name in scenes.split(","):
        for key in hidden.split(","):
            rows.append(_one(name, key, seed, individual))
            if lines is not None:
                with lines.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
            print(f"{name:16s} {key:9s} {'right' if rows[-1]['right'] else '-':6s} {rows[-1]['said']}", flush=True)
    print()
    head("hidden", "plays", "right", "false names", "accused", "seconds")
    for key in (*hidden.split(","), ""):
        own = [r for r in rows if key in ("", r["hidden"])]
        row(HIDDEN[key].words if key else "all", len(own), sum(r["right"] for r in own), sum(r["false"] for r in own),
            sum(bool(r["accused"]) for r in own), round(sum(r["seconds"] for r in own) / max(len(own), 1), 1))


def _one(name: str, key: str, seed: int, individual: int) -> dict[str, Any]:
    """What is said of one play."""
    scene, what = load_scene(name), HIDDEN[key]
    with TemporaryDirectory() as folder:
        run_scene(scene, seed=seed, out=Path(folder), world={**dict(scene.world), **what.world,
                                                             **({"individual": individual} if individual > 1 else {})})
        recording = Recording.read(Path(folder) / "recording.parquet")
    began = time.process_time()
    robot = Robot.load(scene.robot)
    answer = diagnose(recording, robot, model=Model.load(shipped_model(scene.robot)))
    right, wrong = judged(answer, what)
    return {"scene": name, "hidden": key, "right": right, "false": wrong, "seconds": time.process_time() - began,
            "accused": [finding.kind for finding in inspect(recording, robot).contradictions],
            "taken_for": answer.taken_for, "said": said(answer)}


def judged(answer: Diagnosis, what: Hidden) -> tuple[bool, int]:
    """Whether a diagnosis says what is hidden and nothing else, and how many names are false."""
    true = [_says(effect, what) for effect in answer.effects]
    wrong = len(true) - sum(true)
    return (any(true) or not what.names) and not wrong, wrong


def _says(effect: Any, what: Hidden) -> bool:
    """Whether one of the names, or one that is said to be as likely, is what is hidden."""
    near = [(word.partition(" of joint ")[0], word.partition(" of joint ")[2])
            for word in effect.indistinguishable_from]
    every = [(effect.fitted.name, effect.fitted.joint),
             *((name, int(joint or effect.fitted.joint)) for name, joint in near)]
    return any(name in what.names and joint == what.joint for name, joint in every) or \
        any(name in what.names and not what.joint for name, _ in every)


def said(answer: Diagnosis) -> str:
    """The names of a diagnosis in one line."""
    names: Sequence[str] = [f"{e.fitted.name} in {e.fitted.channel}" for e in answer.effects]
    return ", ".join([*names, *(f"a curve in {u.fitted.channel}" for u in answer.unknown)]) or answer.verdict
