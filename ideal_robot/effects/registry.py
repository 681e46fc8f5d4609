"""The library of effects: one table, and the way in for effects of other packages.

To add an effect, write its class (``ideal_robot.effects.base.Effect``) in a file of its own and a line in the table. A
package outside calls ``register(MyEffect())``, or has an entry point that is found without being imported by anybody:

    [project.entry-points."ideal_robot.effects"]
    "my_effect/tau" = "my_package.my_effect:MyEffect"

The effect is then looked for by ``diagnose``, found in model files, and stands in the tables.
"""

from __future__ import annotations

from ideal_robot.effects.base import Effect
from ideal_robot.errors import InputError
from ideal_robot.registry import Registry

_HERE = "ideal_robot.effects."
_TABLE = {
    "viscous/tau": "torque.viscous:Viscous",
    "coulomb/tau": "torque.coulomb:Coulomb",
    "degressive/tau": "torque.degressive:Degressive",
    "stribeck/tau": "torque.stribeck:Stribeck",
    "stribeck/tau_bell": "torque.bell_stribeck:BellStribeck",
    "asymmetric_friction/tau": "torque.asymmetric_friction:AsymmetricFriction",
    "load_dependent_friction/tau": "torque.load_dependent_friction:LoadDependentFriction",
    "load_direction_friction/tau": "torque.load_direction_friction:LoadDirectionFriction",
    "thermal_drift/tau": "torque.thermal_drift:ThermalDrift",
    "presliding_hysteresis/tau": "torque.presliding_hysteresis:PreslidingHysteresis",
    "torque_ripple/tau": "torque.torque_ripple:TorqueRipple",
    "current_offset/tau": "torque.current_offset:CurrentOffset",
    "drive_gain/tau": "torque.drive_gain:DriveGain",
    "rotor_inertia/tau": "torque.rotor_inertia:RotorInertia",
    "gravity_spring/tau": "torque.gravity_spring:GravitySpring",
    "cable_spring/tau": "torque.cable_spring:CableSpring",
    "payload/tau": "torque.payload:Payload",
    "link_load/tau": "torque.link_load:LinkLoad",
    "zero_error/tau": "torque.zero_error:ZeroError",
    "base_tilt/tau": "torque.base_tilt:BaseTilt",
    "torque_filter/tau": "torque.torque_filter:TorqueFilter",
    "axis_coupling/tau": "torque.axis_coupling:AxisCoupling",
    "dead_time/tau": "torque.dead_time:DeadTime",
    "dead_time/q": "torque.position_dead_time:PositionDeadTime",
    "joint_elasticity/tau": "torque.joint_elasticity:JointElasticity",
    "joint_elasticity/tau_resonance": "torque.gear_resonance:GearResonance",
    "backlash/tau": "torque.backlash:Backlash",
    "backlash/tau_flight": "torque.backlash_in_flight:BacklashInFlight",
    "dead_time/qa": "arm.dead_time:ArmDeadTime",
    "dead_time/qa_all": "arm.common_dead_time:CommonArmDeadTime",
    "joint_elasticity/qa": "arm.joint_elasticity:ArmElasticity",
    "transmission_error/qa": "arm.transmission_error:TransmissionError",
    "backlash/qa": "arm.backlash:ArmBacklash",
    "backlash/qa_load": "arm.backlash_by_load:ArmBacklashByLoad",
    "dead_time/tcp": "tcp.dead_time:ToolDeadTime",
    "joint_elasticity/tcp": "tcp.joint_elasticity:ToolElasticity",
    "backlash/tcp": "tcp.backlash:ToolBacklash",
    "backlash/tcp_load": "tcp.backlash_by_load:ToolBacklashByLoad",
    "transmission_error/tcp": "tcp.transmission_error:ToolTransmissionError",
    "kinematic_error/tcp": "tcp.kinematic_error:KinematicError",
    "thermal_growth/tcp": "tcp.thermal_growth:ThermalGrowth",
    "force_bias/force": "sensor.force_bias:ForceBias",
    "force_compliance/force_contact": "sensor.force_compliance:ForceCompliance",
    "camera_latency/line": "sensor.camera_latency:CameraLatency",
    "camera_scale/line": "sensor.camera_scale:CameraScale",
    "camera_offset/line": "sensor.camera_offset:CameraOffset",
    "lens_distortion/line": "sensor.lens_distortion:LensDistortion",
    "clock_drift/line": "sensor.clock_drift:ClockDrift",
}
"""Name of the cause and prefix of its channel → class, in the order in which effects are tried and listed."""

EFFECTS: Registry[Effect | type[Effect]] = Registry(
    "effect", "ideal_robot.effects", {key: _HERE + place for key, place in _TABLE.items()})
_made: dict[str, Effect] = {}


def register(effect: Effect) -> None:
    """Adds an effect of another package.

    Raises:
        InputError: there is one of that name in that channel already.
    """
    EFFECTS.register(effect.key, effect)


def unregister(effect: Effect) -> None:
    """Takes out what ``register`` added."""
    EFFECTS.unregister(effect.key)
    _made.pop(effect.key, None)


def library() -> tuple[Effect, ...]:
    """All effects; the same cause may stand there several times, once for each place where it shows."""
    return tuple(_effect(key) for key in EFFECTS.names())


def names() -> tuple[str, ...]:
    """Names of all causes, each once."""
    return tuple(dict.fromkeys(key.partition("/")[0] for key in EFFECTS.names()))


def find(name: str, prefix: str) -> Effect:
    """The effect of a name in the channels of a prefix.

    Raises:
        InputError: there is none.
    """
    key = f"{name}/{prefix}"
    if key not in EFFECTS:
        raise InputError(f"no such effect in a channel {prefix!r}; known are {', '.join(names())}", field="effects",
                         value=name)
    return _effect(key)


def _effect(key: str) -> Effect:
    """The one object of an effect; searches tell effects apart by it."""
    if key not in _made:
        found = EFFECTS.get(key)
        _made[key] = found() if isinstance(found, type) else found
    return _made[key]
