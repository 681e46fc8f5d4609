"""The force sensor's tool and the contact are calibrated by moving the real arm ([L] 4.4), which is watched meanwhile.

Nothing comes near the surface before the sensor has felt the tool's weight turn with it. Then the tip goes down slowly,
no deeper than the surface can be, and three witnesses have to agree: the force sensor, whose signs of life are looked
at; the motors; and what contact is, a push along the surface's normal.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.robots.interface import RobotState
from planning import OutOfReachError
from planning.force.contact import LEAP, ContactSettings, most_force
from planning.force.felt_by_motors import FeltByMotors
from planning.path.kinematics import InverseKinematics
from scenes.online.force_known import START_HEIGHT, Known
from scenes.online.live_arm import LiveArm, moves
from scenes.online.live_sensors import LiveForce
from scenes.placing import shapes_about
from scenes.scene_files.scene import SceneError
from sensing.force.force_calibration import (
    ContactElasticity,
    ToolLoad,
    identify_elasticity,
    identify_tool,
    require_gravity,
)
from sensing.force.sensors import WrenchSample

LIFT = 0.15
"""How far away from the surface the tool is turned [m]."""
TURNS = ((0.0, 0.0), (0.0, 0.4), (0.0, -0.4), (0.5, 0.3), (1.0, 0.5), (-0.5, 0.4), (-1.0, -0.3))
"""Turns of the joints before the last two [rad]."""
LEAST = 3
"""Postures that tell bias and weight apart."""
REST, USED = 0.6, 0.35
"""Rest in each posture, and the end of it that counts [s]."""
ABOVE = 0.01
"""How far above the start of a path pressing begins [m]: so far it is air, and the motors are heard in it."""
_UP, _SLOW, _JERKY = 0.03, 0.01, 0.5
"""Speeds away from the surface and towards it [m/s], and their change [m/s²]."""
_HARD = 1.4
"""Times the wanted force to which it is pressed."""
_FELT, _GONE = 3.0, 1.0
"""Forces from which on there is contact, and none any more [N]."""
_MOTORS = 0.75
"""Share of the wanted force that the motors may feel beyond what the sensor feels."""
_RECENT = 5
"""Readings whose mean is what is felt now."""
_MARGIN = 0.05
"""Distance from the joints' limits that turned postures keep [rad]."""


def tool_by_turning(known: Known, start: Array, arm: LiveArm, force: LiveForce) -> ToolLoad:
    """Bias and weight of the tool, turned in the air; the sensor's noise goes into its signs of life.

    Args:
        known: what is known of the scene.
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        arm: connected.
        force: what it feels.

    Raises:
        SceneError: no readings, or the arm cannot be turned there.
        SensingError: what is felt does not turn as a weight does.
    """
    robot, fk = known.robot, known.robot.fk()
    postures = arm.meanwhile(lambda: postures_to_weigh(known, start))
    rests, times = [], []
    arm.begin()
    force.begin()
    force.reach = np.inf
    samples: list[WrenchSample] = []
    for last, q in zip([start, *postures], postures, strict=False):
        with arm.doing(lambda: samples.extend(force.arrived(arm.t))):
            arm.lead(moves(robot, [last, q], REST))
        felt = [sample.wrench for sample in samples if sample.t > arm.t - USED]
        samples.clear()
        if len(felt) < _RECENT or force.signs.fault is not None:
            raise SceneError(force.trouble(arm.t) or f"the force sensor is silent: {force.why_silent()}")
        rests.append(np.array(felt))
        times.append(arm.t)
    force.signs.learn(rests)
    wrenches, rotations = np.array([rest.mean(axis=0) for rest in rests]), [fk(q).rotation for q in postures]
    sigma = force.signs.noise[:3] / np.sqrt(min(len(rest) for rest in rests))  # type: ignore[index]
    arm.meanwhile(lambda: require_gravity(wrenches, rotations, np.array(times), sigma))
    arm.lead(moves(robot, [postures[-1], postures[0], start], 2 * robot.t_ipo))
    return arm.meanwhile(lambda: identify_tool(wrenches, rotations))


def postures_to_weigh(known: Known, start: Array) -> list[Array]:
    """Postures above the start, the first not turned; each can be reached from the one before and the first.

    Raises:
        SceneError: what stands in the cell leaves too few of them.
    """
    robot, here, shapes = known.robot, known.robot.fk()(start), shapes_about(known.scene, known.robot)
    up = known.reference.frames(np.zeros(1)).up[0]
    try:
        lifted = InverseKinematics(robot).search(pin.SE3(here.rotation, here.translation + LIFT * up), start)
    except OutOfReachError as error:
        raise SceneError(f"the tool cannot be lifted to be turned: {error}") from error
    hit = shapes.touch_between(start, lifted)
    postures = [] if hit else [lifted]
    for turn, bend in TURNS[1:] if postures else ():
        q = lifted.copy()
        q[-3] += turn
        q[-2] += bend
        if ((q > robot.q_min + _MARGIN) & (q < robot.q_max - _MARGIN)).all():
            touch = shapes.touch_between(postures[-1], q) or shapes.touch_between(q, lifted)
            hit = touch or hit
            if touch is None:
                postures.append(q)
    if hit is not None and len(postures) < LEAST:
        raise SceneError(f"the tool cannot be turned {1e3 * LIFT:.0f} mm above the start of the path: {hit}; move what "
                         "is in the way, or let the path start elsewhere")
    return postures


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
        SceneError: nothing is felt, or too much, or the witnesses do not agree. The tip has been drawn back then.
    """
    press = arm.meanwhile(lambda: _Press(known, start, arm, force, tool))
    arm.begin()
    force.begin()
    force.reach = LEAP * known.scene.force
    back = 2 * known.robot.t_ipo
    try:
        press.down_and_up()
    except SceneError:
        arm.lead(moves(known.robot, [press.q, start], back))
        raise
    arm.lead(moves(known.robot, [press.q, start], back))
    return arm.meanwhile(press.elasticity)


class _Press:
    """One time down and up.

    Args:
        known: what is known of the scene.
        start: joint angles at ``START_HEIGHT`` ``(n,)`` [rad].
        arm: connected.
        force: what it feels.
        tool: bias and weight.
    """

    def __init__(self, known: Known, start: Array, arm: LiveArm, force: LiveForce, tool: ToolLoad) -> None:
        self._known, self._arm, self._force, self._tool = known, arm, force, tool
        self._kinematics = InverseKinematics(known.robot)
        self._deflection = GearDeflection(known.model, known.robot.t_ipo)
        frames = known.reference.frames(np.zeros(1))
        self._up, self._origin, self._rotation = frames.up[0], frames.position[0], known.reference.rotation(0.0)
        self._motors = FeltByMotors(known.model, known.robot, self._kinematics, self._up)
        self._height, self._speed = START_HEIGHT, 0.0
        self.q = self._joint_angles(start)
        # Once before anything moves: what is compiled is loaded here, not in a cycle.
        self._where(self.q, self.q)
        self._times: list[float] = []
        self._places: list[Array] = []
        self._stamps: list[float] = []
        self._felt: list[Array] = []

    def down_and_up(self) -> None:
        """Raises ``SceneError`` where it cannot go on."""
        self._go(_UP, self._high)
        self._go(0.0, lambda: self._speed == 0.0)
        pressed = _HARD * self._known.scene.force
        self._go(-_SLOW, lambda: float(self._recent() @ self._up) > pressed, heard=True)
        self._go(_SLOW, lambda: float(self._recent() @ self._up) < _GONE or self._high())
        self._go(_UP, lambda: self._height >= START_HEIGHT)

    def elasticity(self) -> ContactElasticity:
        """From what was felt where."""
        felt, way = np.array(self._felt), np.array(self._places)
        pressed = felt @ self._up > 0.5 * self._known.scene.force
        # The surface need not be square to the nominal normal: its own is where the force points.
        normal = felt[pressed].mean(axis=0)
        normal = normal / np.linalg.norm(normal)
        return identify_elasticity(np.interp(self._stamps, self._times, way @ normal), felt @ normal)

    def _go(self, target: float, done: Callable[[], bool], heard: bool = False) -> None:
        """Moves along the normal with a speed [m/s] until it is done, cycle by cycle, and looks at every witness.

        Args:
            target: speed away from the surface [m/s].
            done: whether it is.
            heard: whether the motors are, which takes long: no answer waits for it.
        """
        arm, T = self._arm, self._known.robot.t_ipo
        told: list[tuple[Array, RobotState]] = []
        with arm.doing(lambda: self._hear(told)):
            while not done():
                arm.check(arm.t)
                self._speed += float(np.clip(target - self._speed, -_JERKY * T, _JERKY * T))
                self._height += self._speed * T
                self.q = arm.q_d = self._joint_angles(self.q)
                state = arm.cycle(self.q)
                if heard:
                    told.append((self.q, state))
                self._times.append(arm.t)
                self._places.append(self._where(state.q, self.q))
                for sample in self._force.arrived(arm.t):
                    self._stamps.append(sample.t)
                    self._felt.append(self._rotation @ self._tool.contact(sample.wrench, self._rotation)[:3])
                self._check(self._motors.force if heard else float("nan"))

    def _hear(self, told: list[tuple[Array, RobotState]]) -> None:
        """Lets the motors tell of cycles: commanded joint angles ``(n,)`` [rad], and the state at the end."""
        while told:
            q_c, state = told.pop(0)
            self._motors.add(q_c, state.q, state.tau)

    def _joint_angles(self, near: Array) -> Array:
        """Joint angles ``(n,)`` [rad] at the present height, near others ``(n,)`` [rad]."""
        return self._kinematics.refine([pin.SE3(self._rotation, self._origin + self._height * self._up)], near[None])[0]

    def _where(self, q: Array, q_c: Array) -> Array:
        """The tip, behind gears that bend, against the start of the path ``(3,)`` [m].

        Args:
            q: motor angles ``(n,)`` [rad].
            q_c: commanded ones ``(n,)`` [rad].
        """
        return np.asarray(self._kinematics.fk(q - self._deflection.at(np.tile(q_c, (3, 1)))).translation - self._origin)

    def _high(self) -> bool:
        """Whether the tip is as high as pressing begins."""
        return self._height >= START_HEIGHT + ABOVE

    def _recent(self) -> Array:
        """The force felt now ``(3,)`` [N, base frame]."""
        return np.mean(self._felt[-_RECENT:], axis=0) if self._felt else np.zeros(3)

    def _check(self, by_motors: float) -> None:
        """Raises ``SceneError`` where the witnesses do not agree, or the surface is not where it can be.

        Args:
            by_motors: the force as they feel it [N]; NaN where they are not heard.
        """
        if (trouble := self._force.trouble(self._arm.t)) is not None:
            raise SceneError(f"pressing was stopped: {trouble}")
        scene, felt = self._known.scene, self._recent()
        normal = float(felt @ self._up)
        sideways = float(np.linalg.norm(felt - normal * self._up))
        if not abs(normal) < most_force(scene.force):
            raise SceneError(f"pressing was stopped: {normal:.1f} N felt of {most_force(scene.force):.0f} N allowed")
        if normal < -_FELT or sideways > max(_FELT, abs(normal)):
            raise SceneError(f"pressing was stopped: {normal:.1f} N felt along the surface's normal and {sideways:.1f} "
                             "N across it, which is no push; check the force sensor's sign, axes and bias")
        if self._height > START_HEIGHT and normal > _FELT:
            raise SceneError(f"pressing was stopped: {normal:.1f} N felt in the air; look whether the force sensor's "
                             "bias has leapt, or something stands in the way")
        if by_motors - normal > _MOTORS * scene.force:
            raise SceneError(f"pressing was stopped: the motors feel {by_motors:.0f} N and the force sensor "
                             f"{normal:.1f} N; look whether it is alive")
        deepest = START_HEIGHT - ContactSettings.reach
        if self._height < deepest and normal < _FELT:
            raise SceneError(f"pressed {-1e3 * deepest:.0f} mm below where the surface should be and felt none; look "
                             "whether it is there, or move the surface in the scene")
