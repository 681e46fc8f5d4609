"""Corrects a recorded or planned joint path for a controller that knows nothing of models."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import make_interp_spline

from ideal_robot.arrays import Array, held
from ideal_robot.errors import InputError, LimitError
from ideal_robot.feedforward.ideal import IdealRobot
from ideal_robot.feedforward.learning import learn_on_model
from ideal_robot.feedforward.precorrection import Precorrection
from ideal_robot.loop.closed_loop import simulate
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import SHIPPED, Robot
from ideal_robot.signals.plausible import checked_time
from ideal_robot.signals.recording import Recording
from scenes.report.page import Report

METHODS = ("ideal", "model_learned", "precorrected")
REST_AFTER = 0.3
"""Rest added behind the path [s]."""


@dataclass(frozen=True)
class CorrectedPath:
    """A path and what became of it.

    Attributes:
        recording: ``t``, ``q_c_i``, ``q_d_i``.
        method: how it was corrected.
        robot_name: arm.
        q_d, q_c: desired and commanded ``(N, n)`` [rad].
        expected: error the identified loop still makes with the commands, and without ``(N, n)`` each [rad].
        t: ``(N,)`` [s].
    """

    recording: Recording
    method: str
    robot_name: str
    t: Array
    q_d: Array
    q_c: Array
    expected: tuple[Array, Array]

    def json(self) -> dict[str, Any]:
        """Key figures."""
        after, before = (1e3 * np.sqrt(np.mean(error**2, axis=0)) for error in self.expected)
        return {"method": self.method, "robot": self.robot_name, "cycles": len(self.t), "duration_s": float(self.t[-1]),
                "largest_correction_mrad": 1e3 * np.max(np.abs(self.q_c - self.q_d), axis=0),
                "expected_rms_error_mrad": {"corrected": after, "uncorrected": before}}

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """One row a joint."""
        figures = self.json()
        expected = figures["expected_rms_error_mrad"]
        rows = [[i + 1, float(figures["largest_correction_mrad"][i]), float(expected["uncorrected"][i]),
                 float(expected["corrected"][i])] for i in range(self.q_d.shape[1])]
        return ["joint", "largest correction mrad", "expected error before mrad", "after mrad"], rows


def precorrected_path(path: Path, model_file: Path, *, robot: str | None = None, method: str = "ideal",
                      delay: bool = False, rest: float = 0.6) -> CorrectedPath:
    """Reads a joint path, corrects it and checks the result against the robot's limits.

    Raises:
        InputError: unreadable or unsuitable input.
        LimitError: the corrected path leaves the limits.
    """
    if method not in METHODS:
        raise InputError(f"expected one of {', '.join(METHODS)}", field="--method", value=method)
    if not 0.0 <= rest <= 60.0:
        raise InputError("expected 0 to 60 seconds", field="--rest", value=rest)
    model = Model.load(model_file)
    arm = robot_of(model, robot, model_file)
    t, q_d = desired_path(Recording.read(path), arm, path, rest)
    loop = loop_model(model, arm, delay=int(delay))
    check_limits(q_d, arm, arm.t_ipo, file=path, start=-rest)
    q_c = _commands(method, loop, model, arm, q_d)
    check_limits(q_c, arm, arm.t_ipo)
    recording = Recording.from_arrays(
        t, meta={"robot": arm.name, "cycle_time": arm.t_ipo, "method": method, "model": str(model_file),
                 "source": "precorrect", "units": {"t": "s", "q_c": "rad", "q_d": "rad"}}, q_c=q_c, q_d=q_d)
    errors = [np.asarray(q_d - simulate(loop, commands).q_a[:-1]) for commands in (q_c, q_d)]
    return CorrectedPath(recording, method, arm.name, t, q_d, q_c, (errors[0], errors[1]))


def robot_of(model: Model, wanted: str | None, file: Path) -> Robot:
    """The robot asked for, else the shipped one that the model of ``file`` names."""
    name = wanted or model.robot_name
    if wanted is None and name not in SHIPPED:
        raise InputError(f"the model is of {name!r}, which is not shipped; give its URDF with --robot", file=file,
                         field="robot", value=name)
    return Robot.load(name)


def desired_path(recording: Recording, arm: Robot, path: Path, rest: float) -> tuple[Array, Array]:
    """Times ``(N,)`` and path ``q_d (N, n)`` of a recording at the interpolation cycle, with rest before and behind.

    Raises:
        InputError: columns are missing or do not fit the arm, too few samples, values that are not finite.
    """
    names = [[f"{prefix}_{i + 1}" for i in range(arm.n)] for prefix in ("q_d", "q")]
    found = next((columns for columns in names if all(name in recording.columns for name in columns)), None)
    if found is None:
        raise InputError(f"columns q_d_1 to q_d_{arm.n} (or q_1 to q_{arm.n}) are needed", file=path, field="q_d_1")
    if f"{found[0][:-1]}{arm.n + 1}" in recording.columns:
        raise InputError(f"the path has more joints than {arm.name} ({arm.n})", file=path,
                         field=f"{found[0][:-1]}{arm.n + 1}")
    t, q = recording.t, np.column_stack([recording.columns[name] for name in found])
    if len(t) < 6 or not np.all(np.diff(t) > 0):
        raise InputError("needs at least six samples with rising times", file=path, field="t", value=len(t))
    for name, column in zip(found, q.T, strict=True):
        if not np.isfinite(column).all():
            raise InputError("holds values that are not finite", file=path, field=name)
    checked_time(t, str(path))
    grid = np.arange(t[0], t[-1] + 1e-9, arm.t_ipo)
    if len(grid) == len(t) and np.allclose(grid, t, atol=1e-6):
        samples = q
    else:
        # Other sampling than the cycle: a spline through the samples, straight on from the last one.
        samples = np.asarray(make_interp_spline(t, q, k=min(5, len(t) - 1))(grid))
    first, last = round(rest / arm.t_ipo), round(REST_AFTER / arm.t_ipo)
    q_d = held(samples, before=first, after=last)
    return np.asarray(arm.t_ipo * np.arange(float(len(q_d)))), q_d


def _commands(method: str, loop: LoopModel, model: Model, arm: Robot, q_d: Array) -> Array:
    ideal = IdealRobot(loop)
    if method == "model_learned":
        return learn_on_model(loop, q_d, ideal.along(q_d)).q_c
    if method == "precorrected":
        return Precorrection.complete(model, arm, delay=loop.delay).along(q_d)
    return ideal.along(q_d)


def check_limits(q: Array, arm: Robot, t_ipo: float, *, file: Path | None = None, start: float = 0.0) -> None:
    """Positions, speeds and accelerations of a path ``(N, n)`` that begins at ``start`` [s] against the arm's limits.

    Raises:
        InputError: outside, and the path is the user's (``file``).
        LimitError: outside, and the path is ours.
    """
    speed = np.diff(q, axis=0) / t_ipo
    # A linear interpolator's acceleration is what speed changes over a cycle; twice the limit is what a
    # controller's own monitoring lets pass before it trips.
    bend = np.diff(speed, axis=0) / t_ipo
    checks = (("position [rad]", q, arm.q_min, arm.q_max, "move the path"),
              ("velocity [rad/s]", speed, -arm.v_max, arm.v_max, "move slower"),
              ("acceleration [rad/s²]", bend, -2 * arm.a_max, 2 * arm.a_max, "move slower or round corners"))
    for quantity, values, low, high, remedy in checks:
        if len(values) == 0:
            continue
        outside = np.argwhere((values < low) | (values > high))
        if len(outside):
            row, joint = (int(index) for index in outside[0])
            value = float(values[row, joint])
            limit = float(high[joint] if value > high[joint] else low[joint])
            error = LimitError(joint + 1, f"{quantity} at {start + row * t_ipo:.3f} s", value, limit, remedy)
            if file is not None:
                raise InputError(str(error), file=file, field=f"q_d_{joint + 1}")
            raise error


def write_page(result: CorrectedPath, path: Path) -> Path:
    """The page about a corrected path."""
    figures = result.json()["expected_rms_error_mrad"]
    report = Report(f"Corrected path for {result.robot_name}",
                    f"Expected from the identified model: {np.max(figures['corrected']):.3f} mrad root mean square "
                    f"on the worst joint with the corrected path, {np.max(figures['uncorrected']):.2f} mrad without.")
    report.table(*result.table())
    figure = Figure(figsize=(9.0, 4.0))
    axes = figure.add_subplot()
    for i in range(result.q_d.shape[1]):
        axes.plot(result.t, 1e3 * (result.q_c[:, i] - result.q_d[:, i]), lw=1, label=f"joint {i + 1}")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("correction [mrad]")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(fontsize=8, frameon=False, ncols=3)
    report.figure(figure, "Command minus desired position.")
    return report.write(path)
