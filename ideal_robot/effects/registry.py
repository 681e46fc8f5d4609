"""The library of effects: one table, and the registration of effects from other packages.

The class to write is ``ideal_robot.effects.base.Effect``; an entry point of another package is

    [project.entry-points."ideal_robot.effects"]
    "my_effect/tau" = "my_package.my_effect:MyEffect"
"""

from __future__ import annotations

from ideal_robot.effects.base import Effect
from ideal_robot.errors import InputError
from ideal_robot.registry import Registry
from ideal_robot.signals.recording import expect

_HERE = "ideal_robot.effects."
_TABLE = {
    "viscous/tau": "friction:Viscous",
    "coulomb/tau": "friction:Coulomb",
    "degressive/tau": "friction:Degressive",
    "stribeck/tau": "friction:Stribeck",
    "stribeck/tau_bell": "friction:BellStribeck",
    "asymmetric_friction/tau": "friction:AsymmetricFriction",
    "load_dependent_friction/tau": "friction:LoadDependentFriction",
    "load_direction_friction/tau": "friction:LoadDirectionFriction",
    "warmth/tau": "friction:Warmth",
    "thermal_drift/tau": "friction:ThermalDrift",
    "presliding_hysteresis/tau": "friction:PreslidingHysteresis",
    "torque_ripple/tau": "ripple:TorqueRipple",
    "current_offset/tau": "drive:CurrentOffset",
    "drive_gain/tau": "drive:DriveGain",
    "rotor_inertia/tau": "drive:RotorInertia",
    "gravity_spring/tau": "loads:GravitySpring",
    "cable_spring/tau": "loads:CableSpring",
    "cable_spring/tau_taut": "loads:SlackCable",
    "payload/tau": "loads:Payload",
    "link_load/tau": "loads:LinkLoad",
    "zero_error/tau": "kinematics:ZeroError",
    "base_tilt/tau": "loads:BaseTilt",
    "common_delay/tau": "drive:CommonDelay",
    "torque_filter/tau": "drive:TorqueFilter",
    "axis_coupling/tau": "drive:AxisCoupling",
    "dead_time/tau": "drive:LateTorque",
    "dead_time/q": "drive:LatePosition",
    "joint_elasticity/tau": "elasticity:JointElasticity",
    "joint_elasticity/tau_further": "elasticity:FurtherElasticity",
    "joint_elasticity/tau_resonance": "elasticity:GearResonance",
    "backlash/tau": "backlash:Backlash",
    "backlash/tau_flight": "backlash:BacklashInFlight",
    "dead_time/qa": "drive:LateMeasurement",
    "dead_time/qa_all": "drive:LateMeasurement",
    "joint_elasticity/qa": "elasticity:ElasticityAtArm",
    "encoder_offset/qa": "drive:EncoderOffset",
    "transmission_error/qa": "ripple:TransmissionError",
    "backlash/qa": "backlash:BacklashByMotion",
    "backlash/qa_load": "backlash:Backlash",
    "dead_time/tcp": "drive:LateMeasurement",
    "joint_elasticity/tcp": "elasticity:JointElasticity",
    "backlash/tcp": "backlash:BacklashByMotion",
    "backlash/tcp_load": "backlash:Backlash",
    "transmission_error/tcp": "ripple:TransmissionError",
    "kinematic_error/tcp": "kinematics:KinematicError",
    "thermal_growth/tcp": "kinematics:ThermalGrowth",
    "force_bias/force": "force:ForceBias",
    "force_compliance/force_contact": "force:ForceCompliance",
    "camera_latency/line": "camera:CameraLatency",
    "camera_scale/line": "camera:CameraScale",
    "camera_offset/line": "camera:CameraOffset",
    "lens_distortion/line": "camera:LensDistortion",
    "clock_drift/line": "camera:ClockDrift",
}
"""Name of the cause and prefix of its channel → class, in the order in which effects are tried and listed."""

EFFECTS: Registry[Effect | type[Effect]] = Registry(
    "effect", "ideal_robot.effects", {key: _HERE + place for key, place in _TABLE.items()})
_made: dict[str, Effect] = {}


def register(effect: Effect) -> None:
    """Adds an effect of another package; raises InputError for a class, or a name that its channel has already."""
    expect(effect, Effect, "effect", "make one of the class: register(MyEffect())")
    EFFECTS.register(effect.key, effect)


def unregister(effect: Effect) -> None:
    """Removes an effect that ``register`` added."""
    EFFECTS.unregister(effect.key)
    _made.pop(effect.key, None)


def library() -> tuple[Effect, ...]:
    """All effects; a cause occurs once for each place where it shows."""
    return tuple(_effect(key) for key in EFFECTS.names())


def names() -> tuple[str, ...]:
    """Names of all causes, each once."""
    return tuple(dict.fromkeys(key.partition("/")[0] for key in EFFECTS.names()))


def find(name: str, prefix: str) -> Effect:
    """The effect of a name in the channels of a prefix; raises InputError where there is none."""
    key = f"{name}/{prefix}"
    if key not in EFFECTS:
        raise InputError(f"no such effect in a channel {prefix!r}; known are {', '.join(names())}", field="effects",
                         value=name)
    return _effect(key)


def _effect(key: str) -> Effect:
    """The one object of an effect; searches distinguish effects by it."""
    if key not in _made:
        entry = EFFECTS.get(key)
        effect = entry.seen_in(key.partition("/")[2]) if isinstance(entry, type) else entry
        if effect.key != key:
            raise InputError(f"{type(effect).__name__} is {effect.key!r}; register it by that name",
                             field="effects", value=key)
        _made[key] = effect
    return _made[key]
