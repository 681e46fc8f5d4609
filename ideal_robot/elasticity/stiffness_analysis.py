"""Stiffness of an arm from any mix of clamped and payload recordings: all methods that they allow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ideal_robot.elasticity.clamp_compliance import without_clamp_give
from ideal_robot.elasticity.clamped_signals import ClampedSignals, clamped_signals
from ideal_robot.elasticity.payload_stiffness import identify_from_payloads
from ideal_robot.elasticity.stiffness import (
    WORST_CONDITION,
    JointStiffness,
    Method,
    Tolerances,
    condition_number,
    identify_stiffness,
)
from ideal_robot.errors import InputError
from ideal_robot.plain import plain
from ideal_robot.plots import with_intervals
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.given import recordings_of
from ideal_robot.signals.plausible import plausible
from ideal_robot.signals.recording import Recording
from ideal_robot.summary import Summarised

if TYPE_CHECKING:
    from ideal_robot.plots import Figure

CLAMPED_METHODS: tuple[Method, ...] = ("motor", "wrench")


@dataclass(frozen=True, repr=False)
class StiffnessAnalysis(Summarised):
    """Results of all methods that the recordings allow.

    Attributes:
        robot: the arm.
        joints: one entry per joint and method.
        signals: the clamped recordings as they were used.
        clamp_estimated: whether the give of clamp and links was estimated, and taken away from the motor angles.
        warnings: what the user should know.
    """

    robot: Robot
    joints: tuple[JointStiffness, ...]
    signals: tuple[ClampedSignals, ...]
    clamp_estimated: bool
    warnings: tuple[str, ...]

    def by(self, method: str) -> dict[int, JointStiffness]:
        """Joint (from 1) → result of one method."""
        return {one.joint: one for one in self.joints if one.method == method}

    def differences(self) -> list[dict[str, Any]]:
        """[J] table 7: how far the motor method is from the wrench method, joint by joint [%]."""
        motor, wrench = self.by("motor"), self.by("wrench")
        return [{"joint": joint,
                 "difference_percent": 100 * abs(motor[joint].stiffness - wrench[joint].stiffness)
                 / wrench[joint].stiffness}
                for joint in sorted(set(motor) & set(wrench))]

    def summary(self) -> list[tuple[str, str]]:
        """Stiffness of each joint by each method."""
        return [("arm", f"{self.robot.name!r}: {len(self.signals)} clamped recordings, {len(self.warnings)} warnings"),
                *((f"joint {one.joint}, {one.method}", f"{one.stiffness:.4g} N m/rad ± {one.std_percent:.2g} %")
                  for one in self.joints)]

    def plot(self) -> Figure:
        """Stiffnesses with their 95 % intervals."""
        return with_intervals([(f"joint {one.joint}, {one.method}", one.stiffness, *one.interval)
                               for one in self.joints], "stiffness [N m/rad]", f"stiffness of {self.robot.name}")

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values."""
        values: dict[str, Any] = plain({
            "robot": self.robot.name,
            "urdf": self.robot.urdf,
            "joints": [
                {"joint": one.joint, "method": one.method, "stiffness": one.stiffness, "offset": one.offset,
                 "std_percent": one.std_percent, "offset_std_percent": one.offset_std_percent,
                 "relative_error_percent": one.relative_error_percent, "interval_95": list(one.interval),
                 "condition": one.condition, "recordings": list(one.recordings)}
                for one in self.joints],
            "differences": self.differences(),
            "clamp_estimated": self.clamp_estimated,
            "recordings": [
                {"source": one.source, "q_0": one.q_0, "measured": list(one.measured),
                 "clock_offset": one.clock.offset, "clock_drift": one.clock.drift,
                 "condition": condition_number(self.robot, one.q_0)} for one in self.signals],
            "warnings": self.warnings,
        })
        return values


def analyse_stiffness(recordings: Recording | Sequence[Recording], robot: Robot, method: str = "both", *,
                      clamp: bool | None = None, drive_gain: float = 0.03) -> StiffnessAnalysis:
    """Identifies stiffness by every method asked for.

    Args:
        recordings: clamped ones, and such with a column ``payload``.
        robot: geometry and data-sheet drive gains.
        method: ``motor``, ``wrench`` or ``both``.
        clamp: estimate the give of clamp and links, too; None: where the recordings allow it (two or more clamped
            configurations with all six wrench components, of an arm of six joints).
        drive_gain: relative standard deviation of the data sheet's drive gains.

    Raises:
        InputError: unknown method, or a recording that does not have what it takes.
    """
    if method not in (*CLAMPED_METHODS, "both"):
        raise InputError("expected motor, wrench or both", field="method", value=method)
    recordings = recordings_of(recordings, "recordings")
    hung = [one for one in recordings if "payload" in one.columns]
    pushed, warnings = _plausible([one for one in recordings if "payload" not in one.columns], robot)
    signals = tuple(clamped_signals(one, robot) for one in pushed)
    wanted = [one for one in CLAMPED_METHODS if method in (one, "both")]
    if method == "both":
        # Both where both are recorded: a robot without a force sensor still gets its stiffnesses.
        wanted = [one for one in wanted if all(_allows(signal, one) for signal in signals)]
    if clamp is None:
        clamp = robot.n == 6 and len(signals) > 1 and all(len(signal.measured) == 6 for signal in signals)
    joints: list[JointStiffness] = []
    if signals and not wanted:
        raise InputError("the recordings share no method: some lack currents, others the wrench", field="recordings")
    clamp = clamp and bool(signals)
    standing = without_clamp_give(signals, robot) if clamp else signals
    # Told apart, the give of clamp and links leaves a third of the uncertainty.
    tolerances = Tolerances(drive_gain=drive_gain, model=0.01 if clamp else Tolerances.model)
    for one in wanted if signals else []:
        joints.extend(identify_stiffness(standing, robot, one, tolerances))
    if hung:
        joints.extend(identify_from_payloads(hung, robot))
    return StiffnessAnalysis(robot, tuple(joints), standing, bool(clamp),
                             (*warnings, *_warnings(signals, robot, joints)))


def _plausible(recordings: Sequence[Recording], robot: Robot) -> tuple[list[Recording], list[str]]:
    """The clamped recordings without samples that cannot be, and warnings."""
    usable, warnings = [], []
    for one in recordings:
        if one.n != robot.n:
            raise InputError(f"recording has {one.n} joints, the robot {robot.n}", file=one.source, field="q_i")
        joints = range(1, one.n + 1)
        driven = [f"{key}_{i}" for key in ("current", "tau") for i in joints if one.has(key)]
        one, found = plausible(one, [f"q_{i}" for i in joints], driven)
        usable.append(one)
        warnings += [f"{one.source}: {text}" for text in found]
    return usable, warnings


def _allows(signals: ClampedSignals, method: Method) -> bool:
    return (signals.tau if method == "motor" else signals.wrench) is not None


def _warnings(signals: Sequence[ClampedSignals], robot: Robot, joints: Sequence[JointStiffness]) -> tuple[str, ...]:
    found = []
    for one in signals:
        condition = condition_number(robot, one.q_0)
        if condition > WORST_CONDITION:
            found.append(f"{one.source}: the Jacobian's condition number is {condition:.0f}; joint torques from the "
                         "wrench are unreliable there, clamp in another configuration")
        if 0 < len(one.measured) < 6:
            found.append(f"{one.source}: only {', '.join(one.measured)} measured, the rest counts as zero")
    missing = sorted(set(range(1, robot.n + 1)) - {one.joint for one in joints})
    if missing:
        found.append(f"not loaded, so not identified: joint {', '.join(map(str, missing))}")
    return tuple(found)
