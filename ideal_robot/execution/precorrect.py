"""Corrects a joint path for a controller without models: arrays in, commands out."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import make_interp_spline

from ideal_robot.arrays import Array, held
from ideal_robot.command.motion import Motion
from ideal_robot.errors import IdealRobotError, InputError, LimitError
from ideal_robot.execution.command_limits import check_limits, require_within_limits
from ideal_robot.execution.planned_path import FEW, distinct, instants_of, through_few
from ideal_robot.execution.slowed import slowed
from ideal_robot.feedforward.built_in import BY_LAW, by_law
from ideal_robot.feedforward.command_inverse import CommandInverse, at_cycle_of
from ideal_robot.feedforward.corrected_arm import CorrectedArm
from ideal_robot.feedforward.method import Needs, Setting
from ideal_robot.feedforward.registry import feedforward, methods, require, settings
from ideal_robot.friction.table import largest_speeds
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.cascade import Cascade
from ideal_robot.model.model import Model
from ideal_robot.results import Figure, Summarised, listed, one_unit, over_time, plain
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.plausible import MOST_LEFT_OUT, checked_time, require_joint_units
from ideal_robot.signals.recording import Recording, expect

# Resamples a path to the interpolation cycle, with rest before and after.

DRAWS = 10
"""Controllers that are drawn where only their spread is known."""

REST_AFTER = 0.3
"""Rest added behind the path [s]."""

UNSURE = 1e-3
"""Uncertainty of a path where samples are missing, at most [rad, m]: 1 mm a metre away, of the size of the bends that
correction takes away, so that to correct what is guessed worse would be of no use."""
_MISSING = 1.5
"""A step longer than so many usual ones lacks samples."""


def path_at_cycles(t: Array, q_d: Array, robot: Robot, *, rest: float, file: str | None = None, column: str = "q_d"
                   ) -> tuple[Array, Array, tuple[str, ...]]:
    """Times ``(M,)`` [s] and positions ``(M, n)`` [rad] at the cycles, with rest; and warnings about the samples.

    Duplicate samples are dropped, fewer than six are joined by a smooth path from rest to rest, and missing ones are
    interpolated; each with a warning.

    Args:
        t, q_d: times of the path ``(N,)`` [s], and joint positions ``(N, n)`` [rad, or m where a joint slides].
        robot: cycle, number of joints, limits.
        rest: added before the path [s]; ``REST_AFTER`` is added behind.
        file, column: source of the path, and the name of its positions there, for messages.

    Raises:
        InputError: shapes that do not fit, fewer than two samples, times that fall, two positions at one time, a gap,
            values that are not finite, other units than seconds, radians and metres, samples that no smooth path
            within the limits joins.
    """
    t, q_d = np.asarray(t, dtype=float), np.asarray(q_d, dtype=float)
    if not 0.0 <= rest <= 60.0:
        raise InputError("expected 0 to 60 seconds", field="rest", value=rest)
    if q_d.ndim != 2 or q_d.shape[1] != robot.n:
        raise InputError(f"expected joint positions (N, {robot.n}), one column a joint of {robot.name}", file=file,
                         field=column, value=q_d.shape)
    if t.shape != (len(q_d),):
        raise InputError(f"expected one time for each of the {len(q_d)} rows of the path", file=file, field="t",
                         value=t.shape)
    if not np.isfinite(t).all():
        raise InputError("holds values that are not finite", file=file, field="t")
    for i, values in enumerate(q_d.T):
        if not np.isfinite(values).all():
            raise InputError("holds values that are not finite", file=file, field=f"{column}_{i + 1}")
    t, rows, doubled = distinct(t, q_d, file, column)
    q_d = q_d[rows]
    if len(t) < 2:
        raise InputError("a path needs two points at least", file=file, field="t", value=len(t))
    if len(t) >= FEW and checked_time(t, file or "path", _quickest(t, q_d, robot)):
        k = int(np.argmax(np.diff(t)))
        raise InputError(f"the path has a gap of {t[k + 1] - t[k]:.4g} s after t = {t[k]:.6g} s, and nothing gives its "
                         "way there; give samples in between, or correct the pieces one by one", file=file, field="t",
                         value=float(t[k + 1]))
    require_joint_units(q_d, robot, file=file, column=column)
    grid = instants_of(t, robot.t_ipo)
    if len(grid) == len(t) >= FEW and np.allclose(grid, t, atol=1e-6):
        samples = q_d
    else:
        samples = _between(t, q_d, grid, robot, file)
    warnings = (*doubled, *_bridged(t, q_d, robot, file))
    first, last = round(rest / robot.t_ipo), round(REST_AFTER / robot.t_ipo)
    whole = held(samples, before=first, after=last)
    return np.asarray(robot.t_ipo * np.arange(float(len(whole)))), whole, warnings


def _quickest(t: Array, q_d: Array, robot: Robot) -> float:
    """How many times as fast the path may be for no joint to be faster than it can."""
    speed = np.max(np.abs(np.diff(q_d, axis=0)) / np.diff(t)[:, None], axis=0)
    return float(np.min(largest_speeds(robot.v_max) / np.maximum(speed, 1e-300)))


def _bridged(t: Array, q_d: Array, robot: Robot, file: str | None) -> tuple[str, ...]:
    """A warning where samples of a path are missing, with the error of interpolating them.

    Two smooth ways through the other samples, splines of third and of fifth order, differ there by more than the finer
    one is off. Raises InputError where they differ by more than ``UNSURE``.

    Args:
        t, q_d: times of the path ``(N,)`` [s], and joint positions ``(N, n)`` [rad, or m where a joint slides].
        robot, file: whose joints these are, and where the path comes from, for messages.
    """
    steps = np.diff(t)
    usual = float(np.median(steps))
    if len(t) < FEW:
        return (f"sparse: the path has {len(t)} points; a smooth one from rest to rest is led through them",)
    # If more are missing, these are the path's own times.
    if not 0.0 < np.mean(steps > _MISSING * usual) <= MOST_LEFT_OUT:
        return ()
    gaps = np.flatnonzero(steps > _MISSING * usual)
    between = np.concatenate([np.linspace(t[k], t[k + 1], 11) for k in gaps])
    fine, coarse = (np.asarray(make_interp_spline(t, q_d, k=k)(between)) for k in (5, 3))
    off = np.abs(fine - coarse).max(axis=1).reshape(len(gaps), -1).max(axis=1)
    longest, worst = gaps[np.argmax(steps[gaps])], gaps[np.argmax(off)]
    unit = one_unit(robot.units("mrad"))
    if off.max() > UNSURE:
        raise InputError(f"samples are missing for {steps[worst]:.4g} s after t = {t[worst]:.6g} s, and "
                         f"interpolation is uncertain by {1e3 * off.max():.2g} {unit} there, at most {1e3 * UNSURE:g} "
                         "are allowed; give samples in between, or correct the parts one by one", file=file, field="t",
                         value=float(t[worst + 1]))
    return (f"bridged: {len(gaps)} times samples of the path are missing, for {steps[longest]:.4g} s at most after t = "
            f"{t[longest]:.6g} s; interpolation is uncertain by {1e3 * off.max():.2g} {unit} there",)


def _between(t: Array, q_d: Array, grid: Array, robot: Robot, file: str | None) -> Array:
    """A spline through samples ``(N, n)`` of other times ``(N,)`` than the cycles, at the cycles ``(M, n)``."""
    samples = through_few(t, q_d, grid) if len(t) < FEW else np.asarray(make_interp_spline(t, q_d, k=5)(grid))
    beyond = [np.any((q < robot.q_min) | (q > robot.q_max), axis=1) for q in (samples, q_d)]
    if beyond[0].any() and not beyond[1].any():
        steps = np.diff(t)
        k = int(np.argmin(steps))
        raise InputError(f"the samples are within the joint limits, a smooth path through them is not at t = "
                         f"{grid[np.argmax(beyond[0])]:.6g} s; of their times {t[k]:.9g} s and {t[k + 1]:.9g} s are "
                         f"{steps[k]:.4g} s apart, usually it is {np.median(steps):.4g} s: check these two, or give "
                         "more samples", file=file, field="t", value=float(t[k + 1]))
    return samples


@dataclass(frozen=True, repr=False)
class PrecorrectedPath(Summarised):
    """A corrected path with its expected errors, at the interpolation cycle, rest at both ends included.

    Attributes:
        recording: ``t``, ``q_c_i``, ``q_d_i``, to be written to a file.
        method: the method by which it was corrected.
        robot_name: arm.
        t: ``(N,)`` [s].
        q_d, q_c: desired and commanded ``(N, n)`` [rad].
        expected: size of the error that the model still expects with the commands, and the error without ``(N, n)``
            each [rad]; the first includes the model's residual on its own recordings.
        reach: root mean square of the first error with each of ``DRAWS`` controllers drawn from the model's uncertainty
            ``(DRAWS, n)`` [rad]; None where the model's controller was identified.
        warnings: unchecked assumptions, and missing samples of the path.
        units: of a thousandth of each joint's position, mrad or mm ``(n,)``.
    """

    recording: Recording = field(repr=False)
    method: str
    robot_name: str
    t: Array = field(repr=False)
    q_d: Array = field(repr=False)
    q_c: Array = field(repr=False)
    expected: tuple[Array, Array] = field(repr=False)
    reach: Array | None = field(repr=False, default=None)
    warnings: tuple[str, ...] = ()
    units: tuple[str, ...] = ()

    @property
    def expected_rms(self) -> tuple[Array, Array]:
        """Root mean square per joint of ``expected``: corrected, uncorrected ``(n,)`` each [rad]."""
        after, before = (np.sqrt(np.mean(error**2, axis=0)) for error in self.expected)
        return after, before

    @property
    def beyond_uncorrected(self) -> tuple[int, ...]:
        """Joints, from 1, in which a controller within the uncertainty makes the correction worse than none."""
        worst = np.zeros(self.q_d.shape[1]) if self.reach is None else self.reach.max(axis=0)
        return tuple(int(j) + 1 for j in np.flatnonzero(worst > self.expected_rms[1]))

    def summary(self) -> list[tuple[str, str]]:
        """Method and expected errors as rows of label and value."""
        after, before = (1e3 * rms for rms in self.expected_rms)
        unit = one_unit(self.units)
        rows = [("path", f"{self.robot_name!r}, {self.method}: {len(self.t)} cycles, {self.t[-1] - self.t[0]:.4g} s"),
                ("expected rms error", listed(after, unit)), ("uncorrected", listed(before, unit))]
        if self.reach is not None:
            rows.insert(2, ("by the controller's spread up to", listed(1e3 * self.reach.max(axis=0), unit)))
        return rows

    def plot(self) -> Figure:
        """Expected error of each joint, corrected and uncorrected."""
        after, before = (1e3 * error for error in self.expected)
        return over_time(self.t, [(f"joint {j + 1} [{unit}]", [("uncorrected", before[:, j]),
                                                           ("corrected", after[:, j])])
                                  for j, unit in enumerate(self.units)], f"expected error, {self.method}")

    def to_dict(self) -> dict[str, Any]:
        """Key figures as plain values; keys with ``mrad`` use each joint's unit in ``units``."""
        after, before = (1e3 * rms for rms in self.expected_rms)
        return plain({
            "method": self.method, "robot": self.robot_name, "cycles": len(self.t), "duration_s": float(self.t[-1]),
            "units": self.units, "largest_correction_mrad": 1e3 * np.max(np.abs(self.q_c - self.q_d), axis=0),
            "expected_rms_error_mrad": {"corrected": after, "uncorrected": before, **(
                {} if self.reach is None else {"corrected_from": 1e3 * self.reach.min(axis=0),
                                               "corrected_to": 1e3 * self.reach.max(axis=0)})},
            "warnings": self.warnings})


def precorrect(t: Array, q_d: Array, model: Model, robot: Robot, method: str = "ideal", *, delay: int = 0,
               rest: float = 0.6, slow: bool = False, file: str | Path | None = None, column: str = "q_d"
               ) -> PrecorrectedPath:
    """Corrects a path and checks the result against the robot's limits.

    Args:
        t: times of the path ``(N,)`` [s].
        q_d: desired joint positions ``(N, n)`` [rad, or m where a joint slides].
        model: identified model of the arm.
        robot: cycle and limits.
        method: a method that needs no runs on the arm, see ``ideal_robot.methods``.
        delay: cycles between hand-over of a command and the start of its interpolation.
        rest: added before the path, for the gears' deflection [s].
        slow: slow the path along itself where it or its commands leave a limit; else such a path is refused.
        file: the file that the path comes from, for messages.
        column: name of its positions there.

    Raises:
        InputError: unsuitable input, or a path outside the limits.
        LimitError: the corrected path leaves the limits.
    """
    expect(model, Model, "model", "load one by Model.load or identify one")
    expect(robot, Robot, "robot", "load one by Robot.load")
    robot = at_cycle_of(robot, model.command)
    require(method, (*methods(Needs.PATH), *settings(Needs.PATH)))
    source = None if file is None else str(file)
    times, path, warnings = path_at_cycles(t, q_d, robot, rest=rest, file=source, column=column)
    inverse = by_law(Setting(robot, model, delay=delay)) if method in BY_LAW else None
    loop = None if inverse is not None else loop_model(model, robot, delay=delay)
    if not slow:
        require_within_limits(path, robot, start=-rest, file=source, column=column)

    def corrected(path: Array) -> Array:
        # Learning on the model starts from the ideal robot, whose residual error is small.
        start = feedforward("ideal", model, robot, delay=delay).along(path) if method == "learned-model" else None
        return feedforward(method, model, robot, delay=delay, q_d=path, q_c=start).along(path)

    if slow:
        whole, result = len(path), slowed(path, corrected, robot)
        path, q_c = result.q_d, result.q_c
        times = times[0] + robot.t_ipo * np.arange(float(len(path)))
        if len(path) > whole:
            warnings = (*warnings, f"slowed: to {100 * result.slowest:.3g} % of its speed at the slowest, so that it "
                                   f"lasts {robot.t_ipo * (len(path) - whole):.3g} s longer")
    else:
        q_c = corrected(path)
        _require_within(q_c, path, corrected, robot)
    unit = one_unit(robot.units("rad"))
    recording = Recording.from_arrays(
        times, meta={"robot": robot.name, "cycle_time": robot.t_ipo, "method": method, "source": "precorrect",
                     "units": {"t": "s", "q_c": unit, "q_d": unit}}, q_c=q_c, q_d=path)
    # For an arm with geometric errors other joint angles bring the tool to the path.
    wanted = CorrectedArm(robot, model.effects).from_rest(path, robot.t_ipo)
    if loop is not None:
        errors = [np.asarray(wanted - simulate(loop, commands).q_a[:-1]) for commands in (q_c, path)]
        if model.command is not None and method != "none":
            # The loop's residual on its recordings is expected here as well.
            motion = Motion.of(wanted, robot.t_ipo, model.command.still)
            errors[0] = np.sqrt(errors[0] ** 2 + model.command.cascade_variance(motion))
            if (doubt := model.command.doubt) is not None:
                by = CommandInverse(model, robot, delay=delay).expected_by(q_c, wanted)
                errors[0] = np.sqrt((1.0 - doubt) * errors[0] ** 2 + doubt * by**2)
    else:
        assert inverse is not None
        plain = inverse.uncorrected(wanted)
        errors = [plain if method == "none" else inverse.expected(wanted), plain]
    _require_gain(errors[0], errors[1], method, robot)
    return PrecorrectedPath(recording, method, robot.name, times, path, q_c, (errors[0], errors[1]),
                            _reach(model, robot, delay, q_c, wanted), (*warnings, *_not_checked(robot)),
                            robot.units("mrad"))


def _require_within(q_c: Array, path: Array, corrected: Callable[[Array], Array], robot: Robot) -> None:
    """Raises LimitError where commands leave a limit: names the speed at which the whole path would not.

    Args:
        q_c, path: commands of a path ``(N, n)`` each [rad].
        corrected: commands of other paths.
        robot: limits and cycle.
    """
    try:
        check_limits(q_c, robot, robot.t_ipo)
    except LimitError as error:
        try:
            share = slowed(path, corrected, robot, everywhere=True).slowest
        except IdealRobotError:
            raise error from None
        remedy = (f"at {math.floor(100 * share):d} % of its speed the whole path is within the limits, and slow=True "
                  "(--slow) slows it just where needed")
        raise LimitError(error.joint, error.quantity, error.value, error.limit, remedy) from error


def _require_gain(after: Array, before: Array, method: str, robot: Robot) -> None:
    """Raises InputError where the error that is expected after the correction is not below the plain path's."""
    left, plain = (float(np.sqrt(np.mean(error**2))) for error in (after, before))
    if method != "none" and not left < plain:
        unit = one_unit(robot.units("mrad"))
        raise InputError(f"the correction is expected to leave {1e3 * left:.2g} {unit} and the path itself leaves "
                         f"{1e3 * plain:.2g}: command the path as it is, or identify from a motion like it",
                         field="method", value=method)


def _not_checked(robot: Robot) -> tuple[str, ...]:
    """A warning for each quantity that has no limit in some joints, and where it is given."""
    file = robot.urdf.with_suffix(".toml").name
    texts = []
    for quantity, limit, place in (
            ("speed", robot.v_max, f"velocity of the joints' <limit> in {robot.urdf.name}"),
            ("acceleration", robot.a_max, f"a_max [rad/s², m/s²] of [joints] in {file}, beside the URDF")):
        if (unknown := np.flatnonzero(~np.isfinite(limit)) + 1).size:
            texts.append(f"unknown-limit: the {quantity} of joint {', '.join(map(str, unknown))} was not checked, its "
                         f"limit is not known; give {place}")
    return tuple(texts)


def _reach(model: Model, robot: Robot, delay: int, q_c: Array, wanted: Array) -> Array | None:
    """Errors of the commands ``q_c`` ``(DRAWS, n)`` [rad] with controllers drawn from the spread of the model's one."""
    controller = model.controller
    if controller is None or not controller.spread:
        return None
    mean, rng, errors = Cascade.of(controller), np.random.default_rng(DRAWS), []
    for _ in range(DRAWS):
        drawn = mean.drawn(controller.spread, rng).controller(controller.t_cycle, {})
        drawn = dataclasses.replace(drawn, delay=controller.delay)
        loop = loop_model(dataclasses.replace(model, controller=drawn), robot, delay=delay)
        errors.append(np.sqrt(np.mean((wanted - simulate(loop, q_c).q_a[:-1]) ** 2, axis=0)))
    return np.array(errors)
