"""The library of effects: causes of a residual that identification and diagnosis share."""

from __future__ import annotations

from functools import cache

from ideal_robot.effects.base import (
    ARM_POSITION,
    MOTOR_TORQUE,
    SENSOR,
    TCP_POSITION,
    Effect,
    EffectParameter,
    FittedEffect,
    Signals,
)

__all__ = ["ARM_POSITION", "MOTOR_TORQUE", "SENSOR", "TCP_POSITION", "Effect", "EffectParameter", "FittedEffect",
           "Signals", "effect_of", "library", "names"]


@cache
def library() -> tuple[Effect, ...]:
    """All effects; the same cause may stand there several times, once for each place where it shows."""
    from ideal_robot.effects.arm.dead_time import ArmDeadTime
    from ideal_robot.effects.arm.transmission_error import TransmissionError
    from ideal_robot.effects.sensor.camera_latency import CameraLatency
    from ideal_robot.effects.sensor.camera_offset import CameraOffset
    from ideal_robot.effects.sensor.camera_scale import CameraScale
    from ideal_robot.effects.sensor.clock_drift import ClockDrift
    from ideal_robot.effects.sensor.force_bias import ForceBias
    from ideal_robot.effects.sensor.force_compliance import ForceCompliance
    from ideal_robot.effects.sensor.lens_distortion import LensDistortion
    from ideal_robot.effects.tcp.tcp import AtTool, KinematicError, ThermalGrowth, ToolDeadTime, ToolTransmissionError
    from ideal_robot.effects.torque.asymmetric_friction import AsymmetricFriction
    from ideal_robot.effects.torque.axis_coupling import AxisCoupling
    from ideal_robot.effects.torque.backlash import ArmBacklash, ArmBacklashByLoad, Backlash
    from ideal_robot.effects.torque.cable_spring import CableSpring
    from ideal_robot.effects.torque.coulomb import Coulomb
    from ideal_robot.effects.torque.current_offset import CurrentOffset
    from ideal_robot.effects.torque.dead_time import DeadTime, PositionDeadTime
    from ideal_robot.effects.torque.degressive import Degressive
    from ideal_robot.effects.torque.drive_gain import DriveGain
    from ideal_robot.effects.torque.gravity_spring import GravitySpring
    from ideal_robot.effects.torque.joint_elasticity import ArmElasticity, JointElasticity
    from ideal_robot.effects.torque.load_dependent_friction import LoadDependentFriction
    from ideal_robot.effects.torque.payload import Payload
    from ideal_robot.effects.torque.presliding_hysteresis import PreslidingHysteresis
    from ideal_robot.effects.torque.rotor_inertia import RotorInertia
    from ideal_robot.effects.torque.stribeck import Stribeck
    from ideal_robot.effects.torque.thermal_drift import ThermalDrift
    from ideal_robot.effects.torque.torque_ripple import TorqueRipple
    from ideal_robot.effects.torque.viscous import Viscous

    return (Viscous(), Coulomb(), Degressive(), Stribeck(), AsymmetricFriction(), LoadDependentFriction(),
            ThermalDrift(), PreslidingHysteresis(), TorqueRipple(), CurrentOffset(), DriveGain(), RotorInertia(),
            GravitySpring(), CableSpring(), Payload(), AxisCoupling(), DeadTime(), PositionDeadTime(),
            JointElasticity(), Backlash(), ArmDeadTime(), ArmElasticity(), TransmissionError(), ArmBacklash(),
            ArmBacklashByLoad(), ToolDeadTime(), AtTool(ArmElasticity()),
            AtTool(ArmBacklash()), AtTool(ArmBacklashByLoad()), ToolTransmissionError(),
            KinematicError(), ThermalGrowth(), ForceBias(), ForceCompliance(), CameraLatency(),
            CameraScale(), CameraOffset(), LensDistortion(), ClockDrift())


def names() -> tuple[str, ...]:
    """Names of all effects, each once."""
    return tuple(dict.fromkeys(effect.name for effect in library()))


def effect_of(fitted: FittedEffect) -> Effect:
    """The library's effect behind a fitted one, by its name and the channel it was found in.

    Raises:
        InputError: a model file names an effect that this version does not know.
    """
    from ideal_robot.effects.learned import Unknown
    from ideal_robot.errors import InputError

    if fitted.name == "unknown":
        return Unknown.from_data(dict(fitted.data))
    for effect in library():
        if effect.name == fitted.name and effect.acts_on(fitted.channel):
            return effect
    raise InputError(f"unknown effect in channel {fitted.channel!r}; known are {', '.join(names())}", field="effects",
                     value=fitted.name)
