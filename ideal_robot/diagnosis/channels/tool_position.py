"""The regression of a measured TCP against kinematics."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.diagnosis.channels.arm_angle import arm_angles, deflection
from ideal_robot.diagnosis.channels.frames import frames_along
from ideal_robot.diagnosis.channels.noise import noise_in_band
from ideal_robot.diagnosis.channels.regression import Regression
from ideal_robot.effects import TCP_POSITION, Frames, Signals
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import resampled
from ideal_robot.signals.recording import Recording


@dataclass(frozen=True)
class ToolRegression(Regression):
    """The regression of the TCP's position: effects of every joint show in all three channels."""

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


def tool_regression(recording: Recording, robot: Robot, torque: Regression,
                   stiffness: Array | None) -> ToolRegression | None:
    """Measured TCP minus that of the nominal kinematics at the arm angles; None where it was not measured.

    Where arm angles are not measured they are the motor angles with the gears' known deflection. An axis that was not
    measured is absent. Where the measuring device stands (a small rotation and a shift) is fitted beside it.

    Args:
        recording: with some of ``x y z``, else the result is None.
        robot: the arm.
        torque: the regression of its torques, for signals and filters.
        stiffness: of the gears as far as the model knows ``(n,)`` [N m/rad], or None.
    """
    there = measured_axes(recording)
    if not there.any():
        return None
    grid = torque.filtered.t
    q = arm_angles(recording, torque, torque.signals.q + deflection(torque, stiffness))
    frames = frames_along(robot, q)
    xyz = np.array(frames.tool)
    for k in np.flatnonzero(there):
        xyz[:, k] = resampled(recording.t, recording.columns["xyz"[k]][:, None], grid)[:, 0]
    y = torque.decimate(xyz - frames.tool)
    p = frames.tool - frames.tool.mean(axis=0)
    W = np.zeros((len(grid), 3, 6))
    W[:, :, :3] = np.eye(3)
    for i, axis in enumerate(np.eye(3)):
        W[:, :, 3 + i] = np.cross(axis, p)
    # With a measured arm angle the gear has no part in what is left.
    load = np.where(recording.having("qa"), 0.0, torque.signals.load)
    signals = dataclasses.replace(torque.signals, q=q, load=load, frames=frames)
    own = {f.name: getattr(torque, f.name) for f in dataclasses.fields(Regression)}
    own |= {"channels": ("x", "y", "z"), "units": ("m",) * 3, "y": y, "measured": y - y.mean(axis=0),
            "W": torque.decimate(W), "use": np.tile(there, (len(y), 1)), "signals": signals, "domain": TCP_POSITION,
            "noise_floor": noise_in_band(y, torque), "absent": frozenset(int(i) for i in np.flatnonzero(~there))}
    return ToolRegression(**own)


def measured_axes(recording: Recording) -> np.ndarray:
    """Which of ``x y z`` the recording has without gaps ``(3,)``."""
    return np.array([axis in recording.columns and bool(np.all(np.isfinite(recording.columns[axis])))
                     for axis in "xyz"])
