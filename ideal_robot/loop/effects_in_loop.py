"""Found effects in the simulation of the identified loop, where the loop has a place for them.

The loop knows friction as a table over speed, friction by load, bending after reversals, offsets and soft gears.
Effects without such a place (ripple, springs, delays of the measurement, learned terms) act in
``Model.inverse_dynamics`` only.
"""

from __future__ import annotations

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.effects import FittedEffect, Signals
from ideal_robot.loop.loop_model import LoopModel

_CURVES = ("viscous", "coulomb", "degressive", "stribeck", "asymmetric_friction")


def with_effects(loop: LoopModel, effects: tuple[FittedEffect, ...]) -> LoopModel:
    """The loop with the effects added that it can hold."""
    torque, load, bend = loop.friction_torque.copy(), loop.friction_load.copy(), loop.friction_bend.copy()
    offset, rotor = loop.offset.copy(), loop.rotor_inertia.copy()
    compliance = loop.compliance.copy()
    measured_behind = {e.joint for e in effects if e.name == "joint_elasticity" and e.channel.startswith("qa")}
    for effect in effects:
        j = effect.joint - 1
        if j < 0:
            continue
        size = effect.coefficients[0]
        if effect.name in _CURVES and effect.channel.startswith("tau"):
            for side, sense in enumerate((1.0, -1.0)):
                torque[side] += sense * _curve(effect, sense * loop.friction_velocity)
        elif effect.name == "load_dependent_friction":
            load[j] += size
        elif effect.name == "presliding_hysteresis":
            bend[j] = max(bend[j], effect.theta[0])
        elif effect.name == "current_offset":
            offset[j] += size
        elif effect.name == "rotor_inertia":
            rotor[j] = max(rotor[j] + size, 1e-6)
        elif effect.name == "joint_elasticity" and not _weaker(effect, measured_behind):
            # A gear that was known already: the effect is what it gives beyond that.
            compliance[j] = max(compliance[j] + size, 0.0) if effect.channel.startswith(("qa", "tcp")) else size
    with np.errstate(divide="ignore"):
        stiffness = np.where(compliance > 0.0, 1.0 / np.maximum(compliance, 1e-300), np.inf)
    return loop.replace(friction_torque=np.maximum(torque, 0.0), friction_load=np.maximum(load, 0.0),
                        friction_bend=bend, offset=offset, rotor_inertia=rotor, stiffness=stiffness)


def _weaker(effect: FittedEffect, measured_behind: set[int]) -> bool:
    """Whether a better witness of the same gear is there: the measured arm angle beats the torque."""
    return effect.joint in measured_behind and not effect.channel.startswith("qa")


def _curve(effect: FittedEffect, speeds: Array) -> Array:
    """The effect's torque at constant speeds ``(m, n)``; at speed zero the limit from the side that was asked for."""
    sense = 1.0 if float(speeds.sum()) >= 0.0 else -1.0
    qd = np.where(speeds == 0.0, sense * 1e-9, speeds)
    still = np.zeros_like(qd)
    return effect.contribution(Signals(np.arange(float(len(qd))), still, qd, still, still, still, still))
