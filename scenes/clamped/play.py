"""Plays scenes of kind ``clamped``: the flange is held by a stiff environment and the motors push ([J] section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.elasticity.configurations import ClampLimits, choose_configurations
from ideal_robot.elasticity.stiffness_analysis import StiffnessAnalysis
from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.report.page import plain
from scenes.result import ShownRun
from scenes.scene_files.clamped_scene import ClampedScene
from sim.contact.clamp import ClampedArm, ClampTruth, hang_payloads
from sim.contact.clamp_world import ClampWorld

SHARES = (0.5, 1.0, 0.5, 0.0, -0.5, -1.0, -0.5, 0.0)
"""Levels of a motor's shift as shares of the largest allowed one; each from both sides, so that friction cancels."""


def configurations(scene: ClampedScene, robot: Robot, rng: np.random.Generator) -> Array:
    """The scene's configurations, or chosen ones ``(c, n)`` [rad].

    Args:
        scene: what to play; its own configurations count first [rad].
        robot: the arm, with its limits.
        rng: draws the candidates that configurations are chosen from.
    """
    if scene.clamp.configurations:
        given = np.array(scene.clamp.configurations)
        if given.ndim != 2 or given.shape[1] != robot.n:
            raise InputError(f"expected lists of {robot.n} joint angles", field="clamp.configurations")
        return given
    return choose_configurations(robot, ClampLimits.of(robot), rng, most=scene.clamp.most).q


def record(scene: ClampedScene, robot: Robot, world: ClampWorld, postures: Array, rng: np.random.Generator,
           arms: Sequence[ClampedArm] | None = None) -> tuple[list[Recording], list[ClampTruth]]:
    """Plays the pushes in every posture, and the payloads where the scene has them.

    Args:
        scene: what to play.
        robot: the arm.
        world: gears, clamp and drives as they are.
        postures: joint angles in which the flange is clamped ``(c, n)`` [rad].
        rng: draws noise and drive gains.
        arms: the clamped arms of an earlier call for the same postures and world; made if None.
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


@dataclass(frozen=True, repr=False)
class ClampedResult(ShownRun):
    """One clamped scene played and analysed."""

    scene: ClampedScene
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
            "configurations": self.chosen, "recording": next(iter(self.recordings), None),
            "recording_files": list(self.recordings),
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
