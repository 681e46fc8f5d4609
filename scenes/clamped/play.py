"""Scenes of kind ``clamped``: the flange is held by a stiff environment and the motors push ([J] section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pydantic

from ideal_robot.arrays import Array
from ideal_robot.elasticity.configurations import ClampLimits, choose_configurations
from ideal_robot.elasticity.stiffness_analysis import StiffnessAnalysis, analyse_stiffness
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.clamped.page import stiffness_page
from scenes.outputs import whole_folder
from scenes.report.page import plain
from scenes.result import Progress, silent
from scenes.scene import Scene
from sim.contact.clamp import WRENCH, ClampedArm, ClampTruth
from sim.contact.clamp_world import ClampWorld
from sim.contact.payload_rig import hang_payloads

METHODS = ("motor", "wrench", "both")

SHARES = (0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0)
"""Levels of a motor's shift as shares of the largest allowed one; each from both sides, so that friction cancels."""


class ClampTable(pydantic.BaseModel):
    """The ``[clamp]`` table: where the flange is clamped, and how it is pushed."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    configurations: tuple[tuple[float, ...], ...] = ()
    """Joint angles [rad]; none: the program chooses."""
    most: int = pydantic.Field(default=3, ge=1, le=12)
    """How many configurations the program may choose."""
    push: Literal["tool_z", "joints"] = "joints"
    """``tool_z``: force-controlled levels along −z of the tool ([J]); ``joints``: one motor after the other."""
    forces: tuple[float, ...] = (1000.0, 2000.0, 3000.0, 4000.0, 5000.0, 6000.0, 7000.0)
    """Force levels of ``tool_z`` [N]; held upwards, then downwards."""
    components: tuple[str, ...] = WRENCH
    """Wrench components that the sensor records."""
    hold: float = pydantic.Field(default=2.0, gt=0.2)
    """Time at a level [s]."""
    payloads: tuple[float, ...] = ()
    """Masses hung on the unclamped flange for comparison [kg]; none: no comparison."""


class SceneModel(Scene):
    """A clamped scene."""

    robot: str = "kr500"
    clamp: ClampTable = ClampTable()


@dataclass(frozen=True)
class ClampedResult:
    """One clamped scene played and analysed."""

    scene: SceneModel
    analysis: StiffnessAnalysis
    truths: tuple[ClampTruth, ...]
    recordings: tuple[Path, ...]
    chosen: Array
    report: Path | None
    failure: str | None = None

    def errors(self) -> list[dict[str, Any]]:
        """How far each result is from the simulated truth, and the wrong drive gain's part in it [%]."""
        found = []
        for one in self.analysis.joints:
            truth = float(self.truths[0].stiffness[one.joint - 1])
            # The data sheet's gain times the recorded current is the true torque over the true gain's factor.
            gain = 100 * (float(np.mean([1 / t.gain_factor[one.joint - 1] for t in self.truths])) - 1)
            found.append({"joint": one.joint, "method": one.method, "truth": truth,
                          "error_percent": 100 * (one.stiffness / truth - 1),
                          "from_drive_gain_percent": gain if one.method == "motor" else 0.0,
                          "covered": one.interval[0] <= truth <= one.interval[1]})
        return found

    def json(self) -> dict[str, Any]:
        """The content of ``--json``."""
        content: dict[str, Any] = plain({
            "scene": self.scene.name, "seed": self.scene.seed, **self.analysis.to_dict(),
            "against_truth": self.errors(),
            "configurations": self.chosen, "recording": self.recordings[0], "recording_files": list(self.recordings),
            "report": self.report})
        return content

    def summary(self) -> list[tuple[str, str]]:
        """Joint and method with stiffness, %σ and error."""
        return [(f"joint {one.joint}, {one.method}",
                 f"{one.stiffness:.4g} N m/rad, %σ {one.std_percent:.2f}, error {error['error_percent']:+.2f} %")
                for one, error in zip(self.analysis.joints, self.errors(), strict=True)]

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """One row a joint and method."""
        return (["joint", "method", "k [N m/rad]", "%σ", "error [%]"],
                [[one.joint, one.method, one.stiffness, one.std_percent, error["error_percent"]]
                 for one, error in zip(self.analysis.joints, self.errors(), strict=True)])


def run(scene: SceneModel, *, method: str | None = None, out: Path | None = None,
        progress: Progress = silent) -> ClampedResult:
    """Clamps, pushes, records, identifies; writes recordings and report into ``out``."""
    robot = Robot.load(scene.robot)
    world = world_of(robot, scene.world)
    rng = np.random.default_rng(scene.seed)
    progress(0.05, "choosing configurations")
    postures = configurations(scene, robot, rng)
    recordings, truths = record(scene, robot, world, postures, rng)
    progress(0.4, "identifying")
    analysis = analyse_stiffness(recordings, robot, method or "both")
    progress(0.7, "drawing")
    files: tuple[Path, ...] = ()
    page = None
    if out is not None:
        names = ["recording.parquet", *(f"recording_{i}.parquet" for i in range(2, len(recordings) + 1))]
        with whole_folder(out) as new:
            for one, name in zip(recordings, names, strict=True):
                one.write(new / name)
            stiffness_page(analysis, title=scene.title, truth=world.stiffness).write(new / "report.html")
        files, page = tuple(out / name for name in names), out / "report.html"
    return ClampedResult(scene, analysis, tuple(truths), files, postures, page)


def compare(scene: SceneModel, *, out: Path | None = None, progress: Progress = silent) -> ClampedResult:
    """Both methods (and payloads, where the scene has them) side by side: a run with ``both``."""
    return run(scene, method="both", out=out, progress=progress)


def world_of(robot: Robot, table: dict[str, Any]) -> ClampWorld:
    """The default clamp world with the changes of a scene's ``[world]`` table.

    Raises:
        InputError: unknown key.
    """
    base = ClampWorld.default(robot)
    allowed = ClampWorld.__dataclass_fields__
    for key in table:
        if key not in allowed:
            raise InputError(f"unknown key; allowed here are {', '.join(allowed)}", field=f"world.{key}")
    changes = {key: np.array(value, dtype=float) if isinstance(getattr(base, key), np.ndarray) else
               tuple(value) if isinstance(value, list) else value for key, value in table.items()}
    return ClampWorld(**{**base.__dict__, **changes})


def configurations(scene: SceneModel, robot: Robot, rng: np.random.Generator) -> Array:
    """The scene's configurations, or chosen ones ``(c, n)``."""
    if scene.clamp.configurations:
        given = np.array(scene.clamp.configurations)
        if given.ndim != 2 or given.shape[1] != robot.n:
            raise InputError(f"expected lists of {robot.n} joint angles", field="clamp.configurations")
        return given
    return choose_configurations(robot, ClampLimits.of(robot), rng, most=scene.clamp.most).q


def record(scene: SceneModel, robot: Robot, world: ClampWorld, postures: Array, rng: np.random.Generator,
           arms: Sequence[ClampedArm] | None = None) -> tuple[list[Recording], list[ClampTruth]]:
    """Plays the pushes in every posture, and the payloads where the scene has them.

    ``arms`` may hold the clamped arms of an earlier call for the same postures and world.
    """
    table, limits = scene.clamp, ClampLimits.of(robot)
    gain_seed = int(rng.integers(2**31))
    recordings, truths = [], []
    for number, posture in enumerate(postures):
        arm = arms[number] if arms is not None else ClampedArm(robot, world, posture)
        if table.push == "tool_z":
            up = np.array(table.forces)
            pushes, approach = [arm.press(np.concatenate([up, up[-2::-1]]), rng)], 0.005
        else:
            pushes, approach = [arm.guarded(axis, np.array(SHARES), torque=limits.torque_share * robot.tau_max,
                                            force=limits.force, moment=limits.moment) for axis in np.eye(robot.n)], 0.0
        recording, truth = arm.play(pushes, rng, gain_rng=np.random.default_rng(gain_seed), hold=table.hold,
                                    components=table.components, approach=approach)
        recordings.append(Recording(recording.columns, recording.meta, f"configuration {number + 1}"))
        truths.append(truth)
    if table.payloads:
        lever = np.array([0.2, 0.1, -0.1])
        recordings.append(hang_payloads(robot, world, postures, np.array([0.0, *table.payloads]), lever, rng))
    return recordings, truths
