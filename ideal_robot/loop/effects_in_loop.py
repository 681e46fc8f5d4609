"""Found effects in the simulation of the identified loop, where the loop has a place for them.

Each effect says what it changes in its joint's drive (``Effect.drive_change``). Effects without such a place (springs,
delays of the measurement, learned terms) act in ``Model.inverse_dynamics`` only.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects import DriveChange, FittedEffect, Signals
from ideal_robot.loop.loop_model import LoopModel


def with_effects(loop: LoopModel, effects: tuple[FittedEffect, ...]) -> LoopModel:
    """The loop with the effects added that it can hold."""
    torque, load, bend = loop.friction_torque.copy(), loop.friction_load.copy(), loop.friction_bend.copy()
    offset, rotor = loop.offset.copy(), loop.rotor_inertia.copy()
    compliance = loop.compliance.copy()
    ripples = [loop.ripple] if len(loop.ripple) else []
    changes = _changes(effects)
    from_arm_angle = {effect.joint for effect, change in changes if change.from_arm_angle}
    for effect, change in changes:
        j = effect.joint - 1
        if change.friction_curve:
            for side, sense in enumerate((1.0, -1.0)):
                torque[side] += sense * _curve(effect, sense * loop.friction_velocity)
        load[j] += change.friction_per_load
        bend[j] = max(bend[j], change.presliding)
        offset[j] += change.offset
        if change.rotor_inertia:
            rotor[j] = max(rotor[j] + change.rotor_inertia, 0.0)
        if change.ripple is not None:
            row = np.zeros((1, 3, len(offset)))
            row[0, :, j] = change.ripple
            ripples.append(row)
        if effect.joint in from_arm_angle and not change.from_arm_angle:
            continue
        if change.gear_compliance is not None:
            compliance[j] = change.gear_compliance
        if change.further_compliance is not None:
            compliance[j] = max(compliance[j] + change.further_compliance, 0.0)
    with np.errstate(divide="ignore"):
        stiffness = np.where(compliance > 0.0, 1.0 / np.maximum(compliance, 1e-300), np.inf)
    ripple = np.concatenate(ripples) if ripples else np.zeros((0, 3, len(offset)))
    return loop.replace(friction_torque=np.maximum(torque, 0.0), friction_load=np.maximum(load, 0.0),
                        friction_bend=bend, offset=offset, rotor_inertia=rotor, stiffness=stiffness, ripple=ripple)


def _changes(effects: tuple[FittedEffect, ...]) -> list[tuple[FittedEffect, DriveChange]]:
    """Effects of single joints for which the loop has a place, with what they change."""
    result = []
    for effect in effects:
        change = effect.effect.drive_change(effect.coefficients, effect.theta) if effect.joint > 0 else None
        if change is not None:
            result.append((effect, change))
    return result


def _curve(effect: FittedEffect, speeds: Array) -> Array:
    """The effect's torque at constant speeds ``(m, n)``; at speed zero the limit from the side that was asked for."""
    sense = 1.0 if float(speeds.sum()) >= 0.0 else -1.0
    qd = np.where(speeds == 0.0, sense * 1e-9, speeds)
    still = np.zeros_like(qd)
    return effect.contribution(Signals(np.arange(float(len(qd))), still, qd, still, still, still, still))
