"""The library of effects: causes of a residual that identification and diagnosis share."""

from __future__ import annotations

from ideal_robot.effects.base import (
    ARM_POSITION,
    DOMAINS,
    MOTOR_TORQUE,
    SENSOR,
    TCP_POSITION,
    Domain,
    Effect,
    EffectParameter,
)
from ideal_robot.effects.fitted import FittedEffect
from ideal_robot.effects.loop_change import LoopChange
from ideal_robot.effects.registry import library, names, register, unregister
from ideal_robot.effects.signals import Frames, Signals

__all__ = ["ARM_POSITION", "DOMAINS", "MOTOR_TORQUE", "SENSOR", "TCP_POSITION", "Domain", "Effect", "EffectParameter",
           "FittedEffect", "Frames", "LoopChange", "Signals", "library", "names", "register", "unregister"]
