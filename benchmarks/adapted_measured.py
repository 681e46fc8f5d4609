"""What adaptation is worth on measured arms: torques predicted before they are seen.

    python -m benchmarks.adapted_measured DATA [--arms panda,ur5,ur10e,emps]

DATA is the folder of the public recordings. A model is identified as in ``measured_arms.py``. Along the motion that was
left for judging adaptation is told positions and torques once an interpolation cycle, and what it knew before a cycle
predicts that cycle's torque. On the second half of the motion counts std(residual) / std(torque) per joint [%]: by the
model alone, with two factors per joint, with the curve over speed besides. These recordings hold no commands, so no
controller is known; adaptation needs one for the unit of apparent inertias alone, and is given a usual one.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from benchmarks.measured_arms import ARMS, Arm, recordings_of, row, share_left
from ideal_robot.arrays import Array
from ideal_robot.dynamics.newton_euler import inverse_dynamics
from ideal_robot.feedforward.friction_adaptation import FrictionAdaptation
from ideal_robot.identification.checks import checked
from ideal_robot.identification.idim import identify
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.loop_model import LoopModel
from ideal_robot.model.model import Model
from ideal_robot.model.parametrisation import ControllerModel
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.preprocess import FilteredSignals, preprocess
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
    model = identify([estimation], robot).model
    loop = loop_model(replace(model, controller=usual_controller(robot, validation.joints("q")[0])), robot)
    s = preprocess(validation, cutoff=arm.band[0])
    alone = model.inverse_dynamics(s.q, s.qd, s.qdd, t=s.t - s.t[0])
    predicted = {"model alone": alone}
    for title, curve in (("two factors", False), ("and a curve", True)):
        adaptation = FrictionAdaptation(loop, tool=robot.tool_place, curve=curve, noise_std=model.noise_std)
        predicted[title] = alone + learned_on_the_way(model, loop, adaptation, validation, s)
    return [row(f"{name}, {title}", share_left(s, torque, arm.band[1], len(s.t) // 2), arm)
            for title, torque in predicted.items()]


def usual_controller(robot: Robot, q: Array) -> ControllerModel:
    """A cascade whose velocity loop takes away 0.3 of an error in a cycle, at a posture ``(n,)``."""
    inertia = np.diag(pin.crba(robot.pinocchio, robot.pinocchio.createData(), q))
    gain, zero = 0.3 * inertia / robot.t_ipo, np.zeros(robot.n)
    return ControllerModel(robot.t_ipo, 15.0 * gain, gain, zero, zero, np.full(robot.n, 0.2), zero)


def learned_on_the_way(model: Model, loop: LoopModel, adaptation: FrictionAdaptation, recording: Recording,
                       s: FilteredSignals) -> Array:
    """Torque beyond the model's that was known before each cycle, between cycles by straight lines ``(N, n)`` [N m]."""
    times = np.arange(recording.t[0], recording.t[-1], loop.t_ipo)
    q, tau = (np.array([np.interp(times, recording.t, column) for column in recording.joints(name).T]).T
              for name in ("q", "tau"))
    moved = [np.array([np.interp(times, s.t, column) for column in values.T]).T
             for values in (s.q, s.qd, s.qdd, model.friction.turned(s.q, s.qd))]
    more, state = np.zeros_like(q), adaptation.init()
    for k, (at, v, a, turned) in enumerate(zip(*moved, strict=True)):
        friction = adaptation.friction(state)["friction_torque"] - loop.friction_torque
        more[k] = [z * np.interp(abs(speed), loop.friction_velocity[:, i], friction[int(speed < 0.0), :, i])
                   for i, (z, speed) in enumerate(zip(turned, v, strict=True))]
        carried = adaptation.carried(state.mass)
        if carried is not None:
            more[k] += inverse_dynamics(carried, at[None], v[None], a[None])[0]
        state = adaptation.update(state, RobotState(float(times[k]), q[k], tau[k]))
    return np.array([np.interp(s.t, times, column) for column in more.T]).T


if __name__ == "__main__":
    main()
