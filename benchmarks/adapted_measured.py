"""What adaptation learns of friction on measured arms, judged on motion that comes after it.

    python -m benchmarks.adapted_measured DATA [--arms panda,ur5,ur10e,emps]

DATA is the folder of the public recordings. A model is identified as in ``measured_arms.py``; adaptation is told the
first half of what that leaves for judging, once an interpolation cycle, and what it has learned then is judged on the
second half: std(residual) / std(torque) per joint [%], with the model alone, with two factors per joint, with the curve
over speed besides. These recordings hold no commands, so no controller is known; adaptation needs one for the unit of
apparent inertias alone, and is given a usual one.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from benchmarks.measured_arms import ARMS, Arm, halves, recordings_of, row
from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import inverse_dynamics
from ideal_robot.feedforward.friction_adaptation import FrictionAdaptation, FrictionFactors
from ideal_robot.identification.checks import checked
from ideal_robot.identification.idim import identify
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.model.controller_model import ControllerModel
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import lowpass, preprocess
from ideal_robot.signals.recording import Recording


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--arms", default="panda,ur5,ur10e,emps")
    options = parser.parse_args()
    print("| arm | residual over torque, per joint [%] |\n| --- | --- |")
    for name in options.arms.split(","):
        for line in played(name, ARMS[name], options.data):
            print(line, flush=True)


def played(name: str, arm: Arm, data: Path) -> list[str]:
    """The lines of one arm: model alone, two factors, curve."""
    robot = Robot.load(data / arm.urdf)
    estimation, validation = recordings_of(arm, data)
    (validation,), _ = checked([validation], robot)
    before, after = halves(validation)
    model = identify([estimation], robot).model
    loop = loop_model(replace(model, controller=usual_controller(robot, before.joints("q")[0])), robot)
    tool = np.array(robot.pinocchio.frames[robot.tool_id].placement.translation)
    lines = []
    for title, curve in (("model alone", None), ("two factors", False), ("and a curve", True)):
        adaptation = FrictionAdaptation(loop, tool=tool, curve=bool(curve), noise_std=model.noise_std)
        known = adaptation.init() if curve is None else adaptation.learned(before)
        lines.append(row(f"{name}, {title}", judged(model, loop, adaptation, known, after, arm.band), arm))
    return lines


def usual_controller(robot: Robot, q: Array) -> ControllerModel:
    """A cascade whose velocity loop takes away 0.3 of an error in a cycle, at a posture ``(n,)``."""
    inertia = np.diag(pin.crba(robot.pinocchio, robot.pinocchio.createData(), q))
    gain, zero = 0.3 * inertia / robot.t_ipo, np.zeros(robot.n)
    return ControllerModel(robot.t_ipo, 15.0 * gain, gain, zero, zero, np.full(robot.n, 0.2), zero)


def judged(model: Model, loop: LoopModel, adaptation: FrictionAdaptation, known: FrictionFactors, recording: Recording,
           band: tuple[float, float]) -> Array:
    """std(residual) / std(torque) per joint ``(n,)`` [%], positions and torques below the band's limits [Hz]."""
    s = preprocess(recording, cutoff=band[0])
    learned = adaptation.friction(known)["friction_torque"] - loop.friction_torque
    sliding, more = model.friction.sliding(s.q, s.qd), np.empty_like(s.q)
    turned = np.where(np.isnan(sliding), np.sign(s.qd), sliding)
    for i in range(model.n):
        forward, backward = (np.interp(np.abs(s.qd[:, i]), loop.friction_velocity[:, i], side[:, i])
                             for side in learned)
        more[:, i] = turned[:, i] * np.where(s.qd[:, i] > 0.0, forward, backward)
    carried = adaptation.carried(known.mass)
    if carried is not None:
        more += inverse_dynamics(carried, s.q, s.qd, s.qdd)
    predicted = model.inverse_dynamics(s.q, s.qd, s.qdd, t=s.t - s.t[0]) + more
    measured, predicted = (lowpass(values, s.dt, band[1]) for values in (s.tau, predicted))
    inside = slice(round(1.0 / (s.dt * band[1])), -round(1.0 / (s.dt * band[1])))
    return np.asarray(100.0 * np.std((measured - predicted)[inside], axis=0) / np.std(measured[inside], axis=0))


if __name__ == "__main__":
    main()
