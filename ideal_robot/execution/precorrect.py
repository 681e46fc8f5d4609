"""Corrects a joint path for a controller that knows nothing of models: arrays in, commands out."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.execution.cycles import path_at_cycles
from ideal_robot.execution.path_limits import check_limits, require_within_limits
from ideal_robot.feedforward.corrected_arm import CorrectedArm
from ideal_robot.feedforward.method import Needs
from ideal_robot.feedforward.registry import feedforward, methods
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.plain import plain
from ideal_robot.plots import over_time
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.given import expect
from ideal_robot.signals.recording import Recording
from ideal_robot.summary import Summarised, listed

if TYPE_CHECKING:
    from ideal_robot.plots import Figure


@dataclass(frozen=True, repr=False)
class PrecorrectedPath(Summarised):
    """A path and what became of it, at the interpolation cycle, rest before and behind included.

    Attributes:
        recording: ``t``, ``q_c_i``, ``q_d_i``, to be written to a file.
        method: how it was corrected.
        robot_name: arm.
        t: ``(N,)`` [s].
        q_d, q_c: desired and commanded ``(N, n)`` [rad].
        expected: error the identified loop still makes with the commands, and without ``(N, n)`` each [rad].
    """

    recording: Recording = field(repr=False)
    method: str
    robot_name: str
    t: Array = field(repr=False)
    q_d: Array = field(repr=False)
    q_c: Array = field(repr=False)
    expected: tuple[Array, Array] = field(repr=False)

    @property
    def expected_rms(self) -> tuple[Array, Array]:
        """Root mean square per joint of ``expected``: corrected, uncorrected ``(n,)`` each [rad]."""
        after, before = (np.sqrt(np.mean(error**2, axis=0)) for error in self.expected)
        return after, before

    def summary(self) -> list[tuple[str, str]]:
        """What was corrected, and the error that the model expects to be left."""
        after, before = (1e3 * rms for rms in self.expected_rms)
        return [("path", f"{self.robot_name!r}, {self.method}: {len(self.t)} cycles, {self.t[-1] - self.t[0]:.4g} s"),
                ("expected rms error", listed(after, "mrad or mm")), ("uncorrected", listed(before, "mrad or mm"))]

    def plot(self) -> Figure:
        """Expected error of each joint, corrected and uncorrected."""
        after, before = (1e3 * error for error in self.expected)
        return over_time(self.t, [(f"joint {j + 1} [mrad or mm]", [("uncorrected", before[:, j]),
                                                                   ("corrected", after[:, j])])
                                  for j in range(self.q_d.shape[1])], f"expected error, {self.method}")

    def to_dict(self) -> dict[str, Any]:
        """Key figures as plain values."""
        after, before = (1e3 * rms for rms in self.expected_rms)
        values: dict[str, Any] = plain({
            "method": self.method, "robot": self.robot_name, "cycles": len(self.t), "duration_s": float(self.t[-1]),
            "largest_correction_mrad": 1e3 * np.max(np.abs(self.q_c - self.q_d), axis=0),
            "expected_rms_error_mrad": {"corrected": after, "uncorrected": before}})
        return values


def precorrect(t: Array, q_d: Array, model: Model, robot: Robot, method: str = "ideal", *, delay: int = 0,
               rest: float = 0.6, file: str | Path | None = None, column: str = "q_d") -> PrecorrectedPath:
    """Corrects a path and checks the result against the robot's limits.

    Args:
        t: times of the path ``(N,)`` [s].
        q_d: desired joint positions ``(N, n)`` [rad, or m where a joint slides].
        model: identified model of the arm.
        robot: cycle and limits.
        method: a method that needs no plays on the arm, see ``ideal_robot.methods``.
        delay: cycles between hand-over of a command and the start of its interpolation.
        rest: added before the path, for the gears' deflection [s].
        file: where the path comes from, for messages.
        column: what its positions are called there.

    Raises:
        InputError: unsuitable input, or a path outside the limits.
        LimitError: the corrected path leaves the limits.
    """
    expect(model, Model, "model", "load one by Model.load or identify one")
    expect(robot, Robot, "robot", "load one by Robot.load")
    if method not in methods(Needs.PATH):
        raise InputError(f"expected one of {', '.join(methods(Needs.PATH))}", field="method", value=method)
    source = None if file is None else str(file)
    times, path = path_at_cycles(t, q_d, robot, rest=rest, file=source, column=column)
    loop = loop_model(model, robot, delay=delay)
    require_within_limits(path, robot, start=-rest, file=source, column=column)
    # Learning on the model starts from the ideal robot, which leaves little to learn.
    start = feedforward("ideal", model, robot, delay=delay).along(path) if method == "model_learned" else None
    q_c = feedforward(method, model, robot, delay=delay, q_d=path, q_c=start).along(path)
    check_limits(q_c, robot, robot.t_ipo)
    recording = Recording.from_arrays(
        times, meta={"robot": robot.name, "cycle_time": robot.t_ipo, "method": method, "source": "precorrect",
                     "units": {"t": "s", "q_c": "rad", "q_d": "rad"}}, q_c=q_c, q_d=path)
    # Of an arm whose geometry is not the drawn one, other joint angles bring the tool where the path wants it.
    wanted = CorrectedArm(robot, model.effects).from_rest(path, robot.t_ipo)
    errors = [np.asarray(wanted - simulate(loop, commands).q_a[:-1]) for commands in (q_c, path)]
    return PrecorrectedPath(recording, method, robot.name, times, path, q_c, (errors[0], errors[1]))
