"""What a run along a line tells of the arm itself: its gears and its friction.

The seen points say nothing of them. What does is how well the tool keeps to what the follower wanted. A run along a
line turns hardly a joint round, so what is to be found is found in a motion about the line. The arm's geometry stays as
drawn: a camera that rides on the arm sees the line by the same wrong geometry with which the arm then goes there, and
what one line shows of it would bend everything off that line.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.diagnosis import Diagnosis
from ideal_robot.diagnosis.channels.arm import arm_angles, deflection
from ideal_robot.diagnosis.channels.motor_torque import torque_regression
from ideal_robot.diagnosis.validation.final_fit import beside_held_model
from ideal_robot.effects import MOTOR_TORQUE, SENSOR, FittedEffect
from ideal_robot.execution.play import play
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.feedforward.training import training_motion
from ideal_robot.identification.checks import checked
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.line.cell import Cell
from scenes.metrics import path_errors
from sim.arm.arm import SimulatedArm


def motion_about(cell: Cell) -> Recording:
    """What the controller logs in a motion about the reference path, to and fro at full and at a third of the speed.

    Args:
        cell: arm and path.

    Raises:
        ExecutionError: the arm cannot play it.
    """
    t_ipo = cell.known.robot.t_ipo
    fast = training_motion(cell.known.follower.q_reference, t_ipo)
    at = np.arange(0.0, len(fast) - 1, 1.0 / 3.0)
    slow = np.column_stack([np.interp(at, np.arange(len(fast)), q) for q in fast.T])
    s = np.linspace(0.0, 1.0, 80)[:, None]
    back = fast[-1] + (slow[0] - fast[-1]) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    with SimulatedArm(cell.known.robot, cell.world, cell.noise, fast[0]) as arm:
        played = play(arm, PassThrough(t_ipo), np.concatenate([fast, back, slow]))
        if played.error is not None:
            raise played.error
        return arm.recording(external=True)


def effects_of_arm(found: Diagnosis, run: Recording, robot: Robot, model: Model) -> tuple[FittedEffect, ...]:
    """Effects of the arm that a diagnosis found and that act; those of the torque beside the model as it is.

    What currents say of a gear is left out: arm angles say it better, and without them nothing shows it.

    Args:
        found: what the diagnosis found with that model.
        run: the recording it was found in, as far as it was measured.
        robot: the arm.
        model: that was known.
    """
    effects = [one.fitted for one in (*found.effects, *found.unknown) if one.fitted.domain != SENSOR]
    regression = torque_regression(checked([run], robot)[0][0], robot, model, payload=True)
    sized = beside_held_model(regression, model, effects)
    return tuple(effect for effect in (*sized, *(one for one in effects if one.domain != MOTOR_TORQUE))
                 if _acts(effect))


def acting(effects: tuple[tuple[str, int], ...]) -> tuple[tuple[str, int], ...]:
    """Of names and joints those that are looked for along a line: not the arm's geometry."""
    return tuple((name, joint) for name, joint in effects if name != "kinematic_error")


def _acts(effect: FittedEffect) -> bool:
    change = effect.effect.loop_change(effect.coefficients, effect.theta)
    if change.nowhere or change.zero or change.geometry is not None:
        return False
    return effect.domain != MOTOR_TORQUE or not (change.gear_compliance is not None or change.half_gap)


def kept(recording: Recording, robot: Robot, known: Model) -> float:
    """How far the tool was from where the follower wanted it, ``E_car`` aligned, as far as it was measured [m].

    Args:
        recording: of a run along a line, with the desired angles.
        robot: kinematics as drawn.
        known: the model of before; where arm angles are not measured they are those of the motors less its gears' give.
    """
    (recording,), _ = checked([recording], robot)
    pose = robot.fk()
    if all(axis in recording.columns for axis in "xyz"):
        t, x = recording.t, np.column_stack([recording.columns[axis] for axis in "xyz"])
    else:
        torque = torque_regression(recording, robot, known)
        t = torque.filtered.t
        q = arm_angles(recording, torque, torque.signals.q + deflection(torque, known.stiffness))
        x = np.array([pose(row).translation for row in q])
    q_d = np.column_stack([np.interp(t, recording.t, recording.columns[f"q_d_{j + 1}"]) for j in range(robot.n)])
    moving = np.flatnonzero(np.abs(np.diff(q_d, axis=0)).max(axis=1) > 1e-8)
    if len(moving) < 8:
        return float("inf")
    counts = np.arange(moving[0], moving[-1], max(1, round(0.004 / float(np.median(np.diff(t))))))
    wanted = np.array([pose(row).translation for row in q_d[counts]])
    return path_errors(t[counts], wanted, t, x).aligned.E_car
