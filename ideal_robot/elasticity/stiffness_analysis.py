"""Stiffness of an arm from any mix of clamped and payload recordings, by all possible methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import nnls

from ideal_robot.arrays import Array
from ideal_robot.elasticity.clamped_signals import ClampedSignals, clamped_signals
from ideal_robot.elasticity.payload_stiffness import identify_from_payloads
from ideal_robot.elasticity.stiffness import (
    WORST_CONDITION,
    JointStiffness,
    Method,
    Tolerances,
    condition_number,
    flange_jacobian,
    identify_stiffness,
    joint_torque,
)
from ideal_robot.errors import InputError
from ideal_robot.results import Figure, Summarised, plain, with_intervals
from ideal_robot.robots.joints import joint_motions, own_joints
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.plausible import plausible, require_joint_units
from ideal_robot.signals.recording import Recording, recordings_of

# The compliance of clamp and links is estimated from the wrench and removed from the motor angles.
#
# [J] assumes that the arm is at rest while the motors turn. A real clamp and links deflect, so the arm angles move a
# little and every gear looks softer than it is. With motor angles and wrenches of several configurations that
# compliance can be estimated beside the stiffnesses, because it couples the joints while a gear does not:
#
#     q_m = q_0 + K⁻¹ τ + J(q_0)⁻¹ C F_e,      C = c_t I_t + c_r I_r + Σ_j c_j J_bj J_bjᵀ
#
# c_t and c_r are translational and rotational compliance of the clamp, c_j is the bending compliance of link j, J_bj
# maps its rotations across its joint axis to the flange. All unknowns enter linearly, and none is negative.

def without_clamp_give(signals: Sequence[ClampedSignals], robot: Robot) -> tuple[ClampedSignals, ...]:
    """The recordings with the motor angles corrected for the compliance of clamp and links, as [J] (3) assumes none.

    The recordings are two or more in different configurations, with all six wrench components. Raises InputError where
    there are not six joints, a wrench component is missing, or too few samples are under load.
    """
    n = robot.n
    if n != 6:
        raise InputError("compliance of clamp and links is estimated on arms of six joints only; leave --clamp out",
                         field="robot", value=f"{robot.name}, {n} joints")
    blocks = [_block(signal, robot) for signal in signals]
    weight = np.ones(n)
    for _ in range(3):
        W = np.vstack([(rows * weight[None, :, None]).reshape(-1, rows.shape[2]) for rows, _ in blocks])
        Y = np.concatenate([(angles * weight).reshape(-1) for _, angles in blocks])
        scale = np.linalg.norm(W, axis=0)
        chi = nnls(W.T @ W / np.outer(scale, scale), W.T @ Y / scale)[0] / scale
        residual = np.vstack([angles - rows @ chi for rows, angles in blocks])
        # Joints with larger residuals get less weight from the second pass on.
        weight = 1 / np.maximum(np.std(residual, axis=0), 1e-12)
    corrected = []
    for signal in signals:
        assert signal.wrench is not None
        compliance = np.tensordot(chi[n:], compliance_shapes(robot, signal.q_0), axes=1)
        arm_motion = np.linalg.solve(flange_jacobian(robot, signal.q_0), compliance @ signal.wrench.T).T
        known = np.all(np.isfinite(arm_motion), axis=1)
        standing = signal.q_m - np.where(known[:, None], arm_motion, 0.0)
        corrected.append(replace(signal, q_m=standing, clamped=signal.clamped & known))
    return tuple(corrected)


def _block(signal: ClampedSignals, robot: Robot) -> tuple[Array, Array]:
    """Regressor ``(N, n, 2 n + 2)`` and motor angles ``(N, n)``, the means taken away from each."""
    if len(signal.measured) < 6:
        raise InputError("all six wrench components are needed to distinguish clamp and gears", file=signal.source,
                         field="fx fy fz mx my mz")
    tau, use = joint_torque(signal, robot, "wrench")
    if np.count_nonzero(use) < 10:
        raise InputError("fewer than 10 samples under load", file=signal.source)
    assert signal.wrench is not None
    wrench, q_m = signal.wrench[use], signal.q_m[use]
    jacobian = flange_jacobian(robot, signal.q_0)
    shapes = compliance_shapes(robot, signal.q_0)
    rows = np.zeros((len(q_m), robot.n, robot.n + len(shapes)))
    rows[:, range(robot.n), range(robot.n)] = tau[use]
    for column, shape in enumerate(shapes):
        rows[:, :, robot.n + column] = np.linalg.solve(jacobian, shape @ wrench.T).T
    return rows - rows.mean(axis=0), q_m - q_m.mean(axis=0)


def compliance_shapes(robot: Robot, q: Array) -> list[Array]:
    """Compliance matrices I_t, I_r and J_bj J_bjᵀ of each link in the tool frame, each ``(6, 6)``."""
    data = robot.pinocchio.createData()
    pin.framesForwardKinematics(robot.pinocchio, data, q)
    flange = data.oMf[robot.tool_id]
    shapes = [np.diag([1.0] * 3 + [0.0] * 3), np.diag([0.0] * 3 + [1.0] * 3)]
    motions = joint_motions(robot.pinocchio)
    about = np.where(motions.prismatic[:, None], 0.0, motions.axis)
    for joint, axis in zip(own_joints(robot.pinocchio), about[motions.own], strict=True):
        across = np.linalg.svd(axis[None])[2][1:]
        bending = (flange.inverse() * data.oMi[joint]).action[:, 3:] @ across.T
        shapes.append(bending @ bending.T)
    return shapes


CLAMPED_METHODS: tuple[Method, ...] = ("motor", "wrench")


@dataclass(frozen=True, repr=False)
class StiffnessAnalysis(Summarised):
    """Results of all methods that the recordings allow.

    Attributes:
        robot: the arm.
        joints: one entry per joint and method.
        signals: the clamped recordings as they were used.
        clamp_estimated: whether the compliance of clamp and links was estimated and removed from the motor angles.
        warnings: warnings for the user.
    """

    robot: Robot
    joints: tuple[JointStiffness, ...]
    signals: tuple[ClampedSignals, ...]
    clamp_estimated: bool
    warnings: tuple[str, ...]

    def by(self, method: str) -> dict[int, JointStiffness]:
        """Joint (from 1) → result of one method."""
        return {entry.joint: entry for entry in self.joints if entry.method == method}

    def differences(self) -> list[dict[str, Any]]:
        """[J] table 7: difference of the motor method from the wrench method, joint by joint [%]."""
        motor, wrench = self.by("motor"), self.by("wrench")
        return [{"joint": joint,
                 "difference_percent": 100 * abs(motor[joint].stiffness - wrench[joint].stiffness)
                 / wrench[joint].stiffness}
                for joint in sorted(set(motor) & set(wrench))]

    def summary(self) -> list[tuple[str, str]]:
        """Stiffness of each joint by each method."""
        return [("arm", f"{self.robot.name!r}: {len(self.signals)} clamped recordings, {len(self.warnings)} warnings"),
                *((f"joint {entry.joint}, {entry.method}", f"{entry.stiffness:.4g} N m/rad ± {entry.std_percent:.2g} %")
                  for entry in self.joints)]

    def plot(self) -> Figure:
        """Stiffnesses with their 95 % intervals."""
        return with_intervals([(f"joint {entry.joint}, {entry.method}", entry.stiffness, *entry.interval)
                               for entry in self.joints], "stiffness [N m/rad]", f"stiffness of {self.robot.name}")

    def to_dict(self) -> dict[str, Any]:
        """The figures as plain values."""
        return plain({
            "robot": self.robot.name,
            "urdf": self.robot.urdf,
            "joints": [
                {"joint": entry.joint, "method": entry.method, "stiffness": entry.stiffness, "offset": entry.offset,
                 "std_percent": entry.std_percent, "offset_std_percent": entry.offset_std_percent,
                 "relative_error_percent": entry.relative_error_percent, "interval_95": list(entry.interval),
                 "condition": entry.condition, "recordings": list(entry.recordings)}
                for entry in self.joints],
            "differences": self.differences(),
            "clamp_estimated": self.clamp_estimated,
            "recordings": [
                {"source": signal.source, "q_0": signal.q_0, "measured": list(signal.measured),
                 "clock_offset": signal.clock.offset, "clock_drift": signal.clock.drift,
                 "condition": condition_number(self.robot, signal.q_0)} for signal in self.signals],
            "warnings": self.warnings,
        })


def analyse_stiffness(recordings: Recording | Sequence[Recording], robot: Robot, method: str = "both", *,
                      clamp: bool | None = None, drive_gain: float = 0.03) -> StiffnessAnalysis:
    """Identifies stiffness by one method or all possible ones.

    Args:
        recordings: clamped ones, and such with a column ``payload``.
        robot: geometry and data-sheet drive gains.
        method: ``motor``, ``wrench`` or ``both``.
        clamp: also estimate the compliance of clamp and links; None: where the recordings allow it (two or more clamped
            configurations with all six wrench components, of an arm of six joints).
        drive_gain: relative standard deviation of the data sheet's drive gains.

    Raises:
        InputError: unknown method, or a recording without the needed columns.
    """
    if method not in (*CLAMPED_METHODS, "both"):
        raise InputError("expected motor, wrench or both", field="method", value=method)
    recordings = recordings_of(recordings, "recordings")
    for recording in recordings:
        if recording.n != robot.n:
            raise InputError(f"recording has {recording.n} joints, the robot {robot.n}", file=recording.source,
                             field="q_i")
    hung = [recording for recording in recordings if "payload" in recording.columns]
    pushed, warnings = _plausible([recording for recording in recordings if "payload" not in recording.columns])
    signals = tuple(clamped_signals(recording, robot) for recording in pushed)
    for recording in (*pushed, *hung):
        require_joint_units(recording.joints("q"), robot, file=recording.source)
    methods = [name for name in CLAMPED_METHODS if method in (name, "both")]
    if method == "both":
        # Both methods only if both are recorded: an arm without a force sensor still gets its stiffnesses.
        methods = [name for name in methods
                   if all((had.tau if name == "motor" else had.wrench) is not None for had in signals)]
    if clamp is None:
        clamp = robot.n == 6 and len(signals) > 1 and all(len(signal.measured) == 6 for signal in signals)
    if "motor" in methods and not robot.knows_drive_gains and not all(recording.has("tau") for recording in pushed):
        warnings.append(robot.unknown_drive_gain)
    joints: list[JointStiffness] = []
    if signals and not methods:
        raise InputError("the recordings share no method: some lack currents, others the wrench", field="recordings")
    clamp = clamp and bool(signals)
    standing = without_clamp_give(signals, robot) if clamp else signals
    # Once the compliance of clamp and links is estimated, a third of its uncertainty remains.
    tolerances = Tolerances(drive_gain=drive_gain, model=0.01 if clamp else Tolerances.model)
    for name in methods if signals else []:
        joints.extend(identify_stiffness(standing, robot, name, tolerances))
    if hung:
        joints.extend(identify_from_payloads(hung, robot))
    return StiffnessAnalysis(robot, tuple(joints), standing, bool(clamp),
                             (*warnings, *_warnings(signals, robot, joints)))


def _plausible(recordings: Sequence[Recording]) -> tuple[list[Recording], list[str]]:
    """The clamped recordings without samples that cannot be, and warnings."""
    usable, warnings = [], []
    for recording in recordings:
        joints = range(1, recording.n + 1)
        driven = [f"{key}_{i}" for key in ("current", "tau") for i in joints if recording.has(key)]
        recording, texts = plausible(recording, [f"q_{i}" for i in joints], driven)
        usable.append(recording)
        warnings += [f"{recording.source}: {text}" for text in texts]
    return usable, warnings


def _warnings(signals: Sequence[ClampedSignals], robot: Robot, joints: Sequence[JointStiffness]) -> tuple[str, ...]:
    texts = []
    for signal in signals:
        condition = condition_number(robot, signal.q_0)
        if condition > WORST_CONDITION:
            texts.append(f"{signal.source}: the Jacobian's condition number is {condition:.0f}; joint torques from the "
                         "wrench are unreliable there, clamp in another configuration")
        if 0 < len(signal.measured) < 6:
            texts.append(f"{signal.source}: only {', '.join(signal.measured)} measured, the rest is taken as zero")
    motor, wrench = ({entry.joint: entry for entry in joints if entry.method == method} for method in CLAMPED_METHODS)
    for joint in sorted(set(motor) & set(wrench)):
        own, other = motor[joint], wrench[joint]
        if max(own.interval[0], other.interval[0]) > min(own.interval[1], other.interval[1]):
            texts.append(f"methods-disagree: joint {joint}: {own.stiffness:.3g} N m/rad by motor, "
                         f"{other.stiffness:.3g} by wrench, and the 95 % intervals do not meet; check the units of "
                         "currents or torques [A, N m] and of the wrench [N, N m], and the drive gains")
    missing = sorted(set(range(1, robot.n + 1)) - {entry.joint for entry in joints})
    if missing:
        texts.append(f"not loaded, so not identified: joint {', '.join(map(str, missing))}")
    return tuple(texts)
