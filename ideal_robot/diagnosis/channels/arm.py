"""Regressions behind the gear: measured arm angles against motor angles, measured TCP against kinematics."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy import signal

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.motor_torque import Experiment
from ideal_robot.diagnosis.search.choice import Choice
from ideal_robot.diagnosis.statistics.cross_products import Data
from ideal_robot.diagnosis.statistics.estimate import estimate
from ideal_robot.effects import ARM_POSITION, TCP_POSITION, Frames, Signals
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import resampled
from ideal_robot.signals.recording import Recording


@dataclass(frozen=True)
class ToolExperiment(Experiment):
    """The regression of the TCP's position: effects of every joint show in all three channels.

    Attributes:
        prismatic: which joints slide ``(n,)``.
    """

    prismatic: tuple[bool, ...] = ()

    def channel_of(self, joint: int) -> int | None:
        """None: a joint has no channel of its own."""
        return None

    def decimated_signals(self) -> Signals:
        """The signals at the rows of ``y`` with the frames, through which effects of a joint are looked for."""
        signals, frames = super().decimated_signals(), self.signals.frames
        if frames is None:
            return signals
        step, keep = self.filtered.factor, self.filtered.keep
        at = {f.name: getattr(frames, f.name)[::step][keep] for f in dataclasses.fields(Frames)}
        return dataclasses.replace(signals, frames=Frames(**at))


def arm_experiment(recording: Recording, robot: Robot, torque: Experiment,
                   stiffness: Array | None) -> Experiment | None:
    """Arm angle minus motor angle of each joint, and minus the gears' known deflection.

    Only a constant difference is taken for granted.

    Args:
        recording: with ``qa_i``, else the result is None.
        robot: the arm.
        torque: the regression of its torques, for signals and filters.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    if not recording.has("qa"):
        return None
    grid = torque.filtered.t
    qa, q = (resampled(recording.t, recording.joints(key), grid) for key in ("qa", "q"))
    n = robot.n
    y = torque.decimate(qa - q - _deflection(torque, stiffness))
    W = np.zeros((len(y), n, n))
    W[:, np.arange(n), np.arange(n)] = 1.0
    names = tuple(f"qa_{j + 1}" for j in range(n))
    units = tuple("m" if unit == "N" else "rad" for unit in torque.units)
    return dataclasses.replace(torque, channels=names, units=units, y=y, measured=y - y.mean(axis=0),
                               W=W, use=np.ones(y.shape, dtype=bool), quiet=noise_in_band(y, torque),
                               domain=ARM_POSITION)


def tcp_experiment(recording: Recording, robot: Robot, torque: Experiment,
                   stiffness: Array | None) -> ToolExperiment | None:
    """Measured TCP minus that of the nominal kinematics at the arm angles.

    Where arm angles are not measured they are the motor angles with the gears' known deflection.

    Taken for granted: where the measuring device stands (a small rotation and a shift).
    """
    if not all(axis in recording.columns for axis in "xyz"):
        return None
    measured = np.column_stack([recording.columns[axis] for axis in "xyz"])
    if not np.all(np.isfinite(measured)):
        return None
    grid = torque.filtered.t
    xyz = resampled(recording.t, measured, grid)
    behind = recording.has("qa")
    q = (resampled(recording.t, recording.joints("qa"), grid) if behind
         else torque.signals.q + _deflection(torque, stiffness))
    frames = frames_along(robot, q)
    y = torque.decimate(xyz - frames.tool)
    p = frames.tool - frames.tool.mean(axis=0)
    W = np.zeros((len(grid), 3, 6))
    W[:, :, :3] = np.eye(3)
    for i, axis in enumerate(np.eye(3)):
        W[:, :, 3 + i] = np.cross(axis, p)
    # With measured arm angles the gears have no part in what is left.
    load = np.zeros_like(q) if behind else torque.signals.load
    signals = dataclasses.replace(torque.signals, q=q, load=load, frames=frames)
    own = {f.name: getattr(torque, f.name) for f in dataclasses.fields(Experiment)}
    own |= {"channels": ("x", "y", "z"), "units": ("m",) * 3, "y": y, "measured": y - y.mean(axis=0),
            "W": torque.decimate(W), "use": np.ones(y.shape, dtype=bool), "signals": signals, "domain": TCP_POSITION,
            "quiet": noise_in_band(y, torque)}
    return ToolExperiment(**own, prismatic=tuple(unit == "N" for unit in torque.units))


def with_equivalents(made: Experiment, data: Data, choices: list[Choice], share: float = 0.95) -> list[Choice]:
    """The choices with what other joints' geometry could do as well: links of parallel axes are one length.

    Args:
        made, data: the regression of the TCP.
        choices: what was selected.
        share: of the squares that another joint's columns have to reproduce.
    """
    keys = [choice.candidate for choice in choices]
    found = estimate(made, data, keys, None, spread=False)
    result = []
    for k, choice in enumerate(choices):
        effect, joint, theta = choice.candidate.effect, choice.candidate.joint, choice.candidate.theta
        more: list[tuple[str, int, float]] = []
        if effect.geometric:
            own = made.decimate(effect.columns(made.signals, joint, theta) @ found.coefficients[k]).reshape(-1)
            W = made.W.reshape(len(own), -1)
            alone = float(np.sum(_without(W, own) ** 2))
            for other in effect.joints(made.signals):
                if other != joint and effect.usable(made.signals, other):
                    theirs = made.decimate(effect.columns(made.signals, other, theta)).reshape(len(own), -1)
                    left = float(np.sum(_without(np.column_stack([W, theirs]), own) ** 2))
                    if left < (1.0 - share) * alone:
                        more.append((f"{effect.name} of joint {other}", other, 1.0 - left / alone))
        result.append(dataclasses.replace(choice, rivals=choice.rivals + tuple(more)))
    return result


def _without(columns: Array, values: Array) -> Array:
    """What of values ``(N,)`` the columns ``(N, m)`` cannot make."""
    size = np.linalg.norm(columns, axis=0) + 1e-300
    return np.asarray(values - columns / size @ np.linalg.lstsq(columns / size, values, rcond=1e-9)[0])


def frames_along(robot: Robot, q: Array) -> Frames:
    """Joint frames, their axes and the TCP along a motion ``(N, n)``."""
    model, data, tool = robot.pinocchio, robot.pinocchio.createData(), robot.tool_id
    N, n = q.shape
    axis, x, position, tip = (np.empty((N, n, 3)), np.empty((N, n, 3)), np.empty((N, n, 3)), np.empty((N, 3)))
    prismatic = robot.prismatic
    normals = _normals(robot, prismatic)
    jacobian = np.empty((N, 3, n))
    for k in range(N):
        pin.framesForwardKinematics(model, data, q[k])
        tip[k] = data.oMf[tool].translation
        full = pin.computeFrameJacobian(model, data, q[k], tool, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        jacobian[k] = full[:3]
        for j in range(n):
            placement = data.oMi[j + 1]
            position[k, j] = placement.translation
            axis[k, j] = full[3:, j] if not prismatic[j] else full[:3, j]
            x[k, j] = placement.rotation @ normals[j]
    return Frames(axis, x, position, tip, jacobian)


def _normals(robot: Robot, prismatic: NDArray[np.bool_]) -> Array:
    """Common normal of each joint's axis and the next one, in the joint's own frame ``(n, 3)``.

    For parallel axes it points from one to the other; for the last joint towards the TCP.
    """
    model, q = robot.pinocchio, pin.neutral(robot.pinocchio)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    n = model.nv
    full = pin.computeFrameJacobian(model, data, q, robot.tool_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    axes = [full[:3, j] if prismatic[j] else full[3:, j] for j in range(n)]
    places = [*[data.oMi[j + 1].translation for j in range(n)], data.oMf[robot.tool_id].translation]
    result = np.empty((n, 3))
    for j in range(n):
        z = axes[j] / np.linalg.norm(axes[j])
        across = np.cross(z, axes[j + 1]) if j + 1 < n else np.zeros(3)
        for candidate in (across, places[j + 1] - places[j], *np.eye(3)):
            flat = candidate - (candidate @ z) * z
            if np.linalg.norm(flat) > 1e-3:
                break
        result[j] = data.oMi[j + 1].rotation.T @ (flat / np.linalg.norm(flat))
    return result


def _deflection(torque: Experiment, stiffness: Array | None) -> Array:
    """Arm minus motor angle by gears of known stiffness ``(N, n)``, [J] (2)."""
    if stiffness is None:
        return np.zeros_like(torque.signals.q)
    return np.asarray(-torque.signals.load / stiffness)


def noise_in_band(y: Array, torque: Experiment) -> Array:
    """Noise of measured positions in the band that is looked at ``(c,)``.

    Effects follow the motion and are slow against the band's end; so the floor of the spectrum over the band's upper
    part, where only noise is left, times the whole band. Noise whose spectrum falls is underestimated by that.

    Args:
        y: residual at the decimated rows ``(N, c)``.
        torque: whose filters made them.
    """
    rate = 1.0 / (torque.filtered.dt * torque.filtered.factor)
    length = min(len(y), 256)
    f, power = signal.welch(y, fs=rate, nperseg=length, axis=0)
    # The decimation filter falls off at the very end of the band.
    upper = (f >= 0.25 * rate) & (f <= 0.42 * rate)
    # The median of an average of K periodograms lies below its mean.
    K = max(1.0, 2.0 * len(y) / length - 1.0)
    return np.asarray(np.sqrt(np.median(power[upper], axis=0) / (1.0 - 1.0 / (9.0 * K)) ** 3 * 0.5 * rate))
