"""The force sensor's tool and the contact are calibrated by moving the real arm ([L] 4.4)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.elasticity.deflection import GearDeflection
from planning.path.kinematics import InverseKinematics
from planning.planning_error import OutOfReachError
from scenes.follow.live_arm import LiveArm, moves
from scenes.follow.live_force import LiveForce
from scenes.force.known import START_HEIGHT, Known
from scenes.scene_error import SceneError
from sensing.force.force_calibration import ContactElasticity, ToolLoad, identify_elasticity, identify_tool

LIFT = 0.15
"""How far away from the surface the tool is turned [m]."""
TURNS = ((0.0, 0.0), (0.0, 0.4), (0.0, -0.4), (0.5, 0.3), (1.0, 0.5), (-0.5, 0.4), (-1.0, -0.3))
"""Turns of the joints before the last two [rad]."""
REST, USED = 0.6, 0.35
"""Rest in each posture, and the end of it that counts [s]."""
_FAST, _SLOW, _JERKY = 0.03, 0.01, 0.5
"""Speeds of the approach and of pressing [m/s], and their change [m/s²]."""
_FELT = 3.0
"""Force from which on it is pressed slowly [N]."""
_LONGEST = 12.0
_MARGIN = 0.05
"""Distance from the joints' limits that turned postures keep [rad]."""


def tool_by_turning(known: Known, start: Array, arm: LiveArm, force: LiveForce) -> ToolLoad:
    """Bias and weight of the tool, turned in the air.

    Args:
        known: what is known of the scene.
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        arm: connected.
        force: what it feels.

    Raises:
        SceneError: no readings, or the arm cannot be turned there.
    """
    robot, T = known.robot, known.robot.t_ipo
    up = known.reference.frames(np.zeros(1)).up[0]
    fk = robot.fk()
    here = fk(start)
    try:
        lifted = InverseKinematics(robot).search(pin.SE3(here.rotation, here.translation + LIFT * up), start)
    except OutOfReachError as error:
        raise SceneError(f"the tool cannot be lifted to be turned: {error}") from error
    postures = []
    for turn, bend in TURNS:
        q = lifted.copy()
        q[-3] += turn
        q[-2] += bend
        if ((q > robot.q_min + _MARGIN) & (q < robot.q_max - _MARGIN)).all():
            postures.append(q)
    wrenches, rotations = [], []
    arm.begin()
    force.begin()
    last = start
    for q in postures:
        arm.lead(moves(robot, [last, q], REST))
        felt = [sample.wrench for sample in force.arrived(arm.t) if sample.t > arm.t - USED]
        if len(felt) < 5:
            raise SceneError(f"the force sensor is silent: {force.why_silent()}")
        wrenches.append(np.mean(felt, axis=0))
        rotations.append(fk(q).rotation)
        last = q
    arm.lead(moves(robot, [last, lifted, start], 2 * T))
    return identify_tool(np.array(wrenches), rotations)


def elasticity_by_pressing(known: Known, start: Array, arm: LiveArm, force: LiveForce, tool: ToolLoad
                           ) -> ContactElasticity:
    """E by moving: the tip is pressed slowly into the surface at the start of the path and drawn back.

    Args:
        known: what is known of the scene.
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        arm: connected.
        force: what it feels.
        tool: bias and weight.

    Raises:
        SceneError: nothing is felt, or too much.
    """
    robot, T = known.robot, known.robot.t_ipo
    kinematics, deflection = InverseKinematics(robot), GearDeflection(known.model, T)
    frames = known.reference.frames(np.zeros(1))
    up, origin, rotation = frames.up[0], frames.position[0], known.reference.rotation(0.0)
    limit, wanted = known.scene.emergency.force, known.scene.force
    q, height, speed, target = start.copy(), START_HEIGHT, 0.0, -_FAST
    times, places, stamps, forces = [], [], [], []
    arm.begin()
    force.begin()
    for _ in range(int(_LONGEST / T)):
        arm.check(arm.t)
        speed += float(np.clip(target - speed, -_JERKY * T, _JERKY * T))
        height += speed * T
        if height >= START_HEIGHT and target > 0:
            break
        q = kinematics.refine([pin.SE3(rotation, origin + height * up)], q[None])[0]
        arm.q_d = q
        state = arm.cycle(q)
        times.append(arm.t)
        places.append(kinematics.fk(state.q - deflection.at(np.tile(q, (3, 1)))).translation - origin)
        for sample in force.arrived(arm.t):
            stamps.append(sample.t)
            forces.append(rotation @ tool.contact(sample.wrench, rotation)[:3])
        recent = float(np.mean(forces[-5:], axis=0) @ up) if forces else 0.0
        if force.silent(arm.t) > 0.3 or not abs(recent) < limit:
            raise SceneError(f"pressing was stopped: {recent:.1f} N felt of {limit:.0f} N allowed; sensor: "
                             f"{force.why_silent()}")
        if target < 0 and recent > _FELT:
            target = -_SLOW
        if target < 0 and recent > 1.6 * wanted:
            target = _SLOW
        if target > 0 and recent < 1.0:
            target = _FAST
    arm.lead(moves(robot, [q, start], 2 * T))
    felt, way = np.array(forces), np.array(places)
    pressed = felt @ up > 0.5 * wanted if len(felt) else np.zeros(0, dtype=bool)
    if not pressed.any():
        raise SceneError(f"pressed {1e3 * (START_HEIGHT - float((way @ up).min())):.0f} mm down and "
                         "felt no surface; look whether it is where it should be")
    # The surface need not be square to the nominal normal: its own is where the force points.
    normal = felt[pressed].mean(axis=0)
    normal = normal / np.linalg.norm(normal)
    return identify_elasticity(np.interp(stamps, times, way @ normal), felt @ normal)
