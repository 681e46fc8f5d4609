"""The whole circle on a simulated arm: run, diagnose, extend the model, run again; path error before and after.

The scene's world holds an effect that the model was not told of. The oracle is told its name and joint, and estimates
its size from the same recording.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.diagnosis import Diagnosis, diagnose
from ideal_robot.diagnosis.validation.adoption import adopted
from ideal_robot.diagnosis.validation.oracle import told
from ideal_robot.errors import InputError
from ideal_robot.feedforward.passthrough import PassThrough
from ideal_robot.model.model import Model
from ideal_robot.signals.recording import Recording
from scenes.line.scene import LineScene
from scenes.metrics import PathErrors
from scenes.path.methods import Workshop, training_path
from scenes.path.play import workshop
from scenes.path.scene import JointPath, PathScene
from scenes.result import Progress, silent
from scenes.scene import Scene
from sim.arm.world import World

if TYPE_CHECKING:
    from scenes.refine.line import CloseLineResult

_EFFECT_OF_KEY = {"stribeck": "stribeck", "presliding": "presliding_hysteresis", "stiffness": "joint_elasticity",
                  "viscous": "viscous", "coulomb": "coulomb", "friction_asymmetry": "asymmetric_friction",
                  "backlash": "backlash", "degressive": "degressive", "load_friction": "load_dependent_friction"}
"""What a key of the scene's world is called in the effect library."""


@dataclass(frozen=True)
class CloseLoopResult:
    """One turn of the loop.

    Attributes:
        scene: what was played.
        undeclared: effects that the world holds and the model was not told of: name, joint.
        before, after, oracle: path errors with the model as it was, as extended, and with the oracle's.
        diagnosis: what was found.
        recording: what it was found from.
    """

    scene: PathScene
    undeclared: tuple[tuple[str, int], ...]
    before: PathErrors
    after: PathErrors
    oracle: PathErrors
    diagnosis: Diagnosis = field(repr=False)
    recording: Recording = field(repr=False)
    model_path: Path | None = None
    report: Path | None = None

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        before, after, oracle = (e.aligned.E_car for e in (self.before, self.after, self.oracle))
        return {
            "scene": self.scene.name, "undeclared": [{"effect": n, "joint": j} for n, j in self.undeclared],
            "path_error_mm": {"before": self.before.json_mm(), "after": self.after.json_mm(),
                              "oracle": self.oracle.json_mm()},
            "E_car_aligned_mm": {"before": 1e3 * before, "after": 1e3 * after, "oracle": 1e3 * oracle},
            "after_over_oracle": after / oracle, "diagnosis": self.diagnosis.to_dict(), "model": self.model_path,
            "report": self.report,
        }

    columns = ("model", "E_car timed", "aligned", "geometric", "E_max aligned")

    def table(self) -> list[list[Any]]:
        """One row a model: errors in mm."""
        return [[name, *[1e3 * value for value in (e.time_matched.E_car, e.aligned.E_car, e.geometric.E_car,
                                                   e.aligned.E_max)]]
                for name, e in (("before", self.before), ("after", self.after), ("oracle", self.oracle))]


def close_loop(scene: Scene, *, out: Path | None = None,
               progress: Progress = silent) -> CloseLoopResult | CloseLineResult:
    """Plays a path or line scene, finds what its model misses, and plays it again.

    Raises:
        InputError: a scene of another kind, or one whose world holds nothing undeclared.
    """
    if isinstance(scene, LineScene):
        from scenes.refine.line import close_line

        return close_line(scene, out=out, progress=progress)
    if not isinstance(scene, PathScene):
        raise InputError("only scenes of kind path and line can be closed; they hold the undeclared effect",
                         field="kind", value=scene.kind)
    place = workshop(scene, delay=False)
    undeclared = undeclared_effects(scene, place.robot.n)
    progress(0.0, "before")
    before = place.play(place.feedforward("ideal"))
    progress(0.15, "diagnostic motion")
    recording = place.play(PassThrough(place.world.t_ipo), path=diagnostic_motion(place)).recording
    progress(0.3, "diagnose")
    # The run takes no part in the diagnosis: it decides afterwards what goes into the loop.
    found = diagnose(recording, place.robot, model=place.model,
                     progress=lambda share, word: progress(0.3 + 0.4 * share, word))
    extended = adopted(place.model, found, before.recording, place.robot)
    progress(0.7, "after")
    after = _played(place, extended)
    progress(0.85, "oracle")
    oracle_model = told(recording, place.robot, place.model, undeclared)
    oracle = _played(place, oracle_model)
    result = CloseLoopResult(scene, undeclared, before.errors, after, oracle, found, recording)
    if out is None:
        return result
    from scenes.refine.page import write_circle

    return write_circle(result, extended, out)


def undeclared_effects(scene: PathScene, n: int) -> tuple[tuple[str, int], ...]:
    """Effects by which the scene's world differs from the default one, with the joints they sit in."""
    default = World.default(scene.robot)
    result = []
    for key, value in scene.world.items():
        if key not in _EFFECT_OF_KEY:
            continue
        usual = default.per_joint(key, n)
        own = np.broadcast_to(np.asarray(value, dtype=float), (n,))
        result += [(_EFFECT_OF_KEY[key], int(j) + 1) for j in np.flatnonzero(own != usual)]
    if not result:
        raise InputError("the scene's world holds nothing that the model was not told of; set one of "
                         f"{', '.join(_EFFECT_OF_KEY)}", file=f"scene {scene.name}", field="world")
    return tuple(result)


def diagnostic_motion(place: Workshop) -> JointPath:
    """All joints about the path's postures, at full, half and a fifth of the path's speed, one after another."""
    fast = training_path(place.path, place.world.t_ipo)
    parts = [fast.q_d]
    for slowness in (2, 5):
        at = np.arange(0.0, len(fast.q_d) - 1, 1.0 / slowness)
        parts.append(np.column_stack([np.interp(at, np.arange(len(fast.q_d)), q) for q in fast.q_d.T]))
    q_d = np.concatenate([parts[0], *[_joined(a[-1], b) for a, b in pairwise(parts)]])
    t = place.world.t_ipo * np.arange(float(len(q_d)))
    counts = np.ones(len(q_d), dtype=bool)
    return JointPath(q_d, np.zeros((len(q_d), 3)), np.asarray(t), counts, place.path.tool)


def _joined(end: np.ndarray, part: np.ndarray, steps: int = 80) -> np.ndarray:
    """A part with a smooth approach to its start in front."""
    s = np.linspace(0.0, 1.0, steps)[:, None]
    return np.concatenate([end + (part[0] - end) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2), part])


def _played(place: Workshop, model: Model) -> PathErrors:
    again = dataclasses.replace(place, model=model)
    return again.play(again.feedforward("ideal")).errors
