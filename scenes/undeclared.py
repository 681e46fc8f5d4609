"""Differences between a scene's world and its model, and worlds for which ``close-loop`` is refused."""

from __future__ import annotations

from typing import Any

import numpy as np

from ideal_robot.errors import InputError, found_in
from scenes.closing.drives import DRIVES
from scenes.scene_files.scene import BENCH, Scene
from sim.arm.world import World

EFFECTS_OF_KEY: dict[str, tuple[str, ...]] = {
    "stribeck": ("stribeck",), "stribeck_velocity": ("stribeck",), "presliding": ("presliding_hysteresis",),
    "stiffness": ("joint_elasticity",), "viscous": ("viscous",), "coulomb": ("coulomb",),
    "friction_asymmetry": ("asymmetric_friction", "current_offset"), "friction_scale": ("coulomb", "viscous"),
    "backlash": ("backlash",), "degressive": ("degressive",), "degressive_velocity": ("degressive",),
    "load_friction": ("load_dependent_friction",), "extra_rotor_inertia": ("rotor_inertia",),
    "torque_ripple": ("torque_ripple",), "transmission_error": ("transmission_error",),
    "payload_mass": ("payload",), "kinematic_error": ("kinematic_error",), "zero_error": ("kinematic_error",),
    "twist_error": ("kinematic_error",), "drive_gain_error": ("drive_gain",),
    "stiffness_scale": ("joint_elasticity",), "balancer": ("gravity_spring",), "hose": ("cable_spring",),
}
"""What a key of the scene's world is called in the effect library."""
GEOMETRY = ("kinematic_error", "zero_error", "twist_error")
"""Keys of an arm whose geometry is not that of its drawings."""
_OF_ALL_JOINTS = (*GEOMETRY, "drive_gain_error")
_SETTINGS = ("individual", "correction_delay", "quantisation", "encoder_increments", "current_noise", "log_cycle",
             "external_position_noise", "external_rotation_noise")
"""Keys that say which arm it is and how it is measured; they hold nothing that a model could lack."""
_WARMTH = "friction that changes with warmth does not act in the loop; play method adapted"
OF_CONTROLLERS = ("velocity_feedforward", "position_gain", "velocity_gain", "integral_time", "friction_compensation",
                  "gain_schedule", "controller", "command_late", "command_smoothing", "command_time")
"""Keys of joint controllers that are not those of the model, and are found anew from a motion."""
_CONTROLLER = 'what a controller has there is identified, not diagnosed; give the scene model = "own"'
_TWIN = "a twin of measured recordings: what it holds beyond the model has no name"
_SWITCH = "it switches off what the model holds; nothing is left to be found"
_REASONS = {
    **dict.fromkeys(("thermal", "start_temperature", "ambient_temperature", "thermal_resistance",
                     "thermal_time_constant", "viscosity_temperature", "dry_temperature", "reference_temperature",
                     "lubrication", "lubrication_time", "time_compression"), _WARMTH),
    **dict.fromkeys(("low_pass", "t_ipo", "t_position", "t_velocity", "velocity_filter", "current_lag",
                     "notch_frequency"), _CONTROLLER),
    **dict.fromkeys(("ideal", "elasticity", "friction", "torque_limits"), _SWITCH),
    **dict.fromkeys(("body", "geometry", "residual", "spread"), _TWIN),
    **dict.fromkeys(("cell", "transmission_once", "transmission_twice", "hysteresis", "link_bending",
                     "column_stiffness", "column_frequency", "column_damping", "thermal_expansion", "hose_friction"),
                    "what gears and links of a cell have beyond the library's effects is learned from runs of a line"),
    "damping": "no effect of the library is a gear's damping",
    "inertia_tolerance": 'all masses at once are no effect; give the scene an individual and model = "own"',
}
"""Why ``close-loop`` refuses a world with this key."""


def undeclared_effects(scene: Scene, n: int) -> tuple[tuple[str, int], ...]:
    """Effects by which the scene's world differs from the default one, with their joints (0: all ``n``).

    Raises InputError, with key and reason, for a world that ``close-loop`` refuses or that has no such effect.
    """
    result = effects_of_world(scene, n)
    if not result:
        raise InputError("the scene's world has no effect that the model does not have; set one of "
                         f"{', '.join((*EFFECTS_OF_KEY, *OF_CONTROLLERS))}", file=scene.source, field="world")
    return result


def effects_of_world(scene: Scene, n: int) -> tuple[tuple[str, int], ...]:
    """Effects of a world as in ``undeclared_effects``, possibly none."""
    default, file = World.default(scene.robot), scene.source
    world = World.from_table(scene.robot, scene.arm_world, file)
    for key, value in scene.arm_world.items():
        if key in _REASONS and _differs(default, key, value):
            raise InputError(f"a world with this key cannot be closed: {_REASONS[key]}", file=file,
                             field=f"world.{key}", value=value)
    result: list[tuple[str, int]] = [DRIVES] if of_controllers(scene) else []
    for key, effects in EFFECTS_OF_KEY.items():
        if key not in scene.arm_world or not _differs(default, key, scene.arm_world[key]):
            continue
        if key == "payload_mass":
            joints = [0]
        elif key == "balancer":
            joints = [2]
        elif key in _OF_ALL_JOINTS:
            joints = list(range(1, n + 1))
        else:
            with found_in(file):
                own = world.per_joint(key, n)
            joints = [int(j) + 1 for j in np.flatnonzero(own != default.per_joint(key, n))]
        result += [(effect, joint) for effect in effects for joint in joints if (effect, joint) not in result]
    return tuple(result)


def keys_of_arm(scene: Scene) -> tuple[str, ...]:
    """Keys of the scene's world by which the arm differs from its model, beyond the defaults of its kind of world."""
    default, usual = World.default(scene.robot), scene.usual(scene.world.get("base", BENCH)).get("world", {})
    return tuple(key for key, value in scene.arm_world.items() if key in EFFECTS_OF_KEY and value != usual.get(key)
                 and _differs(default, key, value))


def of_controllers(scene: Scene) -> tuple[str, ...]:
    """Keys of the scene's world by which the arm's joint controllers differ from the model's."""
    default = World.default(scene.robot)
    usual = scene.usual(scene.world.get("base", BENCH)).get("world", {})
    return tuple(key for key, value in scene.arm_world.items() if key in OF_CONTROLLERS and value != usual.get(key)
                 and _differs(default, key, value))


def declared_world(scene: Scene) -> dict[str, Any]:
    """The world in which the arm's own model is identified: without the undeclared effects."""
    return {key: value for key, value in scene.arm_world.items() if key in _SETTINGS}


def _differs(default: World, key: str, value: Any) -> bool:
    own, usual = np.asarray(value), np.asarray(getattr(default, key, False))
    return (bool(own.ndim and usual.ndim) and own.shape != usual.shape) or bool(np.any(own != usual))
