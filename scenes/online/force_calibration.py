"""Calibrates the force sensor's tool and the contact by moving the real arm ([L] 4.4) under the guard's watch.

The tool stays away from the surface until the sensor has shown the tool's weight turning with it. Then the tip descends
slowly, no deeper than the surface can be, and three checks have to agree: the force sensor with its health; the motor
torques; and the force's direction along the surface's normal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import GearDeflection
from ideal_robot.robots.interface import RobotState
from planning import OutOfReachError
from planning.force.contact import LEAP, NOTICED, ContactSettings, most_force
from planning.force.felt_by_motors import (
    AIR,
    SETTLES,
    SURELY,
    WINDOW,
    Alert,
    FeltByMotors,
    Hearing,
    settle_and_air,
    soonest,
)
from planning.force.sensor_gain import ALIKE, LOSSES, SensorGain, best_known, wrong_gain
from planning.path.kinematics import InverseKinematics
from scenes.line_way import shapes_about
from scenes.online.felt_force import SAFE, ZEROED, FeltForce
from scenes.online.force_known import KnownSurface
from scenes.online.live_arm import LiveArm, moves
from scenes.online.live_sensors import LiveForce
from scenes.scene_files.scene import SceneError
from sensing import SensingError
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
"""Postures that distinguish bias and weight."""
REST, USED = 0.6, 0.35
"""Rest in each posture, and the end of it that counts [s]."""
ABOVE = 0.01
"""How far above the start of a path pressing begins [m]: so far it is air, and the motors are heard in it."""
LATE = 0.1
"""How late a sensor's first reading may be [s]."""
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
_SLOWLY = 0.003
"""Way through air on which the motors are heard before there can be a touch [m], at least."""
_EVEN = 0.01
"""Share of the speed of pressing by which it may differ where it counts as even."""
_STEADY = 0.1
"""Time without a change of speed after which a sensor's gain is heard [s]."""
_STEEPER = 2.0
"""Times by which a contact may be stiffer at the force that is pressed with than on the whole way to it."""
_SPARE = 0.7
"""Share of the force that may be felt beyond that one which may come to it."""
_LONGEST = 180.0
"""Time for which the motors are listened to at most [s]; who would take longer is no witness."""
_SHOWS = 100
"""Newest readings from which it is told how stiff a contact is while it is pressed."""
_MARGIN = 0.05
"""Distance from the joints' limits that turned postures keep [rad]."""


def tool_by_turning(known: KnownSurface, start: Array, arm: LiveArm, force: LiveForce) -> tuple[ToolLoad, Array]:
    """Bias and weight of the tool from turning it in the air; the sensor's noise is learned for its health check.

    The motion leads upwards from where the arm rests, as the tool may not come near the surface before it was weighed.

    Args:
        known: the scene's data that are known beforehand.
        start: of the path ``(n,)`` [rad].
        arm: connected, near the start.
        force: its force sensor.

    Returns the tool, and the posture above the start ``(n,)`` [rad] in which the arm is left.

    Raises:
        SceneError: no readings, or the arm cannot be turned there.
        SensingError: the force does not turn as a weight does.
        FollowStoppedError: something was touched, or the arm or the sensor is not to be relied on.
    """
    robot, fk, here = known.robot, known.robot.fk(), arm.q_d
    postures = arm.meanwhile(lambda: postures_to_weigh(known, start))
    rests, times = [], []
    arm.begin()
    force.reach = np.inf
    # The sensor is read at rest before the arm moves.
    arm.lead(np.tile(here, (round(ZEROED / robot.t_ipo) + round(LATE / robot.t_ipo), 1)))
    for last, q in zip([here, *postures], postures, strict=False):
        force.arrived(arm.t)
        arm.lead(moves(robot, [last, q], REST))
        felt = [sample.wrench for sample in force.arrived(arm.t) if sample.t > arm.t - USED]
        if len(felt) < _RECENT or force.signs.fault is not None:
            raise SceneError(force.trouble(arm.t) or f"the force sensor is silent: {force.why_silent()}")
        rests.append(np.array(felt))
        times.append(arm.t)
    force.signs.learn(rests)
    wrenches, rotations = np.array([rest.mean(axis=0) for rest in rests]), [fk(q).rotation for q in postures]
    sigma = force.signs.noise[:3] / np.sqrt(min(len(rest) for rest in rests))  # type: ignore[index]
    arm.meanwhile(lambda: require_gravity(wrenches, rotations, np.array(times), sigma))
    arm.lead(moves(robot, [postures[-1], postures[0]], 2 * robot.t_ipo))
    return arm.meanwhile(lambda: identify_tool(wrenches, rotations)), postures[0]


def postures_to_weigh(known: KnownSurface, start: Array) -> list[Array]:
    """Postures for weighing the tool above the start, the first not turned; each is reachable from its neighbours.

    Raises:
        SceneError: obstacles in the cell leave too few of them.
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


def elasticity_by_pressing(known: KnownSurface, start: Array, arm: LiveArm, force: LiveForce, felt: FeltForce,
                           gains: Sequence[SensorGain] = ()) -> tuple[ContactElasticity, SensorGain | None]:
    """The elasticity E of the contact: the tip is pressed slowly into the surface at the path's start and retracted.

    Where the force rises too quickly for the motors to measure the sensor's gain, the tip is pressed a second time:
    more slowly, and from so far above that all joints slide when it touches.

    Args:
        known: the scene's data that are known beforehand.
        start: where the arm is, and is again afterwards ``(n,)`` [rad].
        arm: connected.
        force: its force sensor.
        felt: the guard's watch over it, with the tool's bias and weight; it gets the surface and the bounds of the
            sensor's gain.
        gains: of the sensor, as other witnesses know it.

    Returns it, and the sensor's gain by the motors; None where they are not heard.

    Raises:
        SceneError: there is no contact, or the checks do not agree. The tip is then retracted.
        FollowStoppedError: the force is too large, or the arm or the sensor is not reliable; the tip is then retracted.
    """
    press = arm.meanwhile(lambda: _Press(known, start, arm, force, felt, gains))
    arm.begin()
    force.reach = LEAP * known.scene.force
    felt.wanted = known.scene.force
    with arm.motion():
        press.down_and_up()
    felt.wanted = 0.0
    elasticity = arm.meanwhile(press.elasticity)
    felt.found(elasticity.touch, elasticity.stiffness)
    arm.lead(moves(known.robot, [press.q, start], 2 * known.robot.t_ipo))
    return elasticity, press.gain


class Pressed:
    """Positions of the tip along the normal while it is pressed, and the forces measured there.

    Args:
        known: the scene's data that are known beforehand.
        tool: bias and weight.
        start: joint angles where the approach begins ``(n,)`` [rad].

    Attributes:
        up: unit normal away from the surface ``(3,)``.
        begins, height: of the tip above the start of the path, at first and now [m].
        q: commanded joint angles ``(n,)`` [rad].
    """

    def __init__(self, known: KnownSurface, tool: ToolLoad, start: Array) -> None:
        self._tool = tool
        self.kinematics = InverseKinematics(known.robot)
        self._deflection = GearDeflection(known.model, known.robot.t_ipo)
        frames = known.reference.frames(np.zeros(1))
        self.up, self._origin, self._rotation = frames.up[0], frames.position[0], known.reference.rotation(0.0)
        self.begins, self.height, self.q = known.start_height, known.start_height, start
        self._times: list[float] = []
        self._places: list[Array] = []
        self._stamps: list[float] = []
        self._felt: list[Array] = []

    def go(self, way: float) -> Array:
        """Command ``(n,)`` [rad] of the posture that is ``way`` [m] farther from the surface than the last one."""
        self.height += way
        self.q = self.kinematics.refine([pin.SE3(self._rotation, self._origin + self.height * self.up)],
                                        self.q[None])[0]
        return self.q

    def hear(self, state: RobotState, samples: Iterable[WrenchSample]) -> None:
        """Stores the state at the end of a cycle, and the force samples of it."""
        self._times.append(state.t)
        self._places.append(self.where(state.q))
        for sample in samples:
            self._stamps.append(sample.t)
            self._felt.append(self._rotation @ self._tool.contact(sample.wrench, self._rotation)[:3])

    def where(self, q: Array) -> Array:
        """Position of the tip, behind gears that deflect, relative to the path's start ``(3,)`` [m]; ``q`` [rad]."""
        bent = self._deflection.at(np.tile(self.q, (3, 1)))
        return np.asarray(self.kinematics.fk(q - bent).translation - self._origin)

    def recent(self) -> Array:
        """The newest force ``(3,)`` [N, base frame]."""
        return np.mean(self._felt[-_RECENT:], axis=0) if self._felt else np.zeros(3)

    def elasticity(self, newest: int = 0) -> ContactElasticity:
        """Elasticity of the contact by all readings, or by the newest ones."""
        felt, places = np.array(self._felt[-newest:]), np.array(self._places[-newest:])
        stamps, times = self._stamps[-newest:], self._times[-newest:]
        # The surface need not be perpendicular to the nominal normal: the force points along its own.
        normal = felt[felt @ self.up > 0.5 * np.max(felt @ self.up)].mean(axis=0)
        normal = normal / np.linalg.norm(normal)
        return identify_elasticity(np.interp(stamps, times, places @ normal), felt @ normal)


_Heard = tuple[Array, RobotState, Array | None, float]
"""A cycle: commanded angles ``(n,)`` [rad], the state at its end, the force felt where the motion is even ``(3,)`` [N],
speed [m/s]."""


@dataclass(frozen=True)
class _Slower:
    """How a contact of a stiffness [N/m] has to be pressed for the motors to measure the sensor's gain.

    After a ``way`` through air [m] with a ``speed`` [m/s], where that is ``needed``.
    """

    stiffness: float
    way: float
    speed: float
    needed: bool


class _StoodError(Exception):
    """The arm stood while it was to press: what was heard of friction belongs to no motion that goes on."""


class _Press(Pressed):
    """Down and up with a connected arm, as fast as what gives way under the tip allows."""

    def __init__(self, known: KnownSurface, start: Array, arm: LiveArm, force: LiveForce, felt: FeltForce,
                 gains: Sequence[SensorGain]) -> None:
        assert felt.tool is not None
        super().__init__(known, felt.tool, start)
        self._known, self._arm, self._force, self._watch, self._speed = known, arm, force, felt, 0.0
        self._gains, self.gain = gains, None
        self._most = min(most_force(known.scene.force), known.scene.emergency.force)
        self._pressed = min(_HARD * known.scene.force, 0.5 * (known.scene.force + self._most))
        self._touched: float | None = None
        self._evenly = 0.0
        self._alert: Alert | None = None
        self._through_air(0.0)
        # A first call before the motion loads compiled code, so that it does not delay a cycle.
        self.where(self.go(0.0))

    gain: SensorGain | None

    def _through_air(self, pace: float, settle: float = SETTLES, air: float = WINDOW) -> None:
        """Compares motors and sensor from now on, at ``pace`` [m/s]; friction turns round within ``settle`` [s]."""
        self._pace, self._paced_at, self._slower = pace, self.height, None
        self._motors = FeltByMotors(self._known.model, self._known.robot, self.kinematics, self.up, settle, air)

    def _search(self) -> None:
        """Approaches from now on so slowly that the force stays allowed if the sensor fails.

        Until it has felt something nobody knows that it lives. The motors notice later, and with the speed at which the
        air was heard: it is that of pressing, whatever gives way under the tip.
        """
        stiffest, T = self._watch.stiffness, self._known.robot.t_ipo
        pace, scatter = self._pressing(stiffest), self._motors.scatter
        if scatter is not None:
            _, air = settle_and_air(self._before_touch, pace)
            self._alert = soonest(scatter, self._unfelt, SAFE * self._most, T, air)
            if self._alert is not None:
                pace = min(pace, self._alert.rate / stiffest)
        self._through_air(pace, *settle_and_air(self._before_touch, pace))

    def _pressing(self, stiffness: float) -> float:
        """Speed at which a contact of a stiffness [N/m] is pressed on [m/s].

        What has grown beyond the force to be pressed with when that is answered is borne.
        """
        return min(_SPARE * (self._most - self._pressed) / (stiffness * NOTICED), self._watch.nearing, _SLOW)

    @property
    def _before_touch(self) -> float:
        """Way through air before there can be a touch [m]."""
        return max(_SLOWLY, self._pressing(self._watch.stiffness) * (SETTLES + WINDOW))

    @property
    def _unfelt(self) -> float:
        """Force that the motors may feel beyond the sensor, as they are no better known [N]."""
        return _MOTORS * self._known.scene.force

    _pace: float
    _paced_at: float
    _slower: _Slower | None

    def down_and_up(self) -> None:
        """Begins once more where the arm was paused on the way. Raises ``SceneError`` where it cannot go on."""
        while True:
            with suppress(_StoodError):
                self._once()
                return
            self.q, self._speed = self._arm.q_d, 0.0
            self.height = float((self.kinematics.fk(self.q).translation - self._origin) @ self.up)
            for heard in (self._times, self._places, self._stamps, self._felt):
                heard.clear()

    def _once(self) -> None:
        """Down and up; raises ``_StoodError`` where the arm was paused on the way, and rests."""
        self._go(lambda: _UP, self._high, heard=True)
        self._go(lambda: 0.0, lambda: self._speed == 0.0)
        # Fast while there is certainly no contact, until friction has reversed; the motor torques are compared later.
        self._go(lambda: -_SLOW, lambda: self.height < self._watch.within + self._before_touch, heard=True)
        self._search()
        self._go(lambda: -self._down(), lambda: self._hard() or self._too_quick(), heard=True)
        if (slower := self._slower) is not None and self._too_quick() and self._touched is not None:
            # Before the touch the joints slide, and the motor torques in the air are known.
            top = self._touched + slower.way + slower.speed * (AIR + _STEADY) + self._pace * NOTICED
            self._go(lambda: _SLOW, lambda: self._high() or (
                self.height >= top and float(self.recent() @ self.up) < _GONE))
            self._go(lambda: 0.0, lambda: self._speed == 0.0)
            self._through_air(slower.speed, slower.way / slower.speed, AIR)
            self._go(lambda: -slower.speed, self._hard, heard=True)
        self._go(lambda: _SLOW, lambda: float(self.recent() @ self.up) < _GONE or self._high())
        self._go(lambda: _UP, lambda: self.height >= self.begins)

    def _too_quick(self) -> bool:
        """Whether this way down is too quick for the motors to measure the sensor's gain."""
        felt, scatter = float(self.recent() @ self.up), self._motors.gain.scatter
        if self._slower is None and felt > 2.0 * _FELT and scatter is not None:
            known, here = self._known, self._paced_at - self.height
            hearing = Hearing(known.model, known.robot, self.kinematics, self.q, self.up, scatter, self._pressed)
            with suppress(SensingError):
                stiffness = self.elasticity(_SHOWS).stiffness
                way, speed = hearing.quickest(stiffness)
                needed = self._pace > hearing.fastest(stiffness, here) * (1.0 + ALIKE)
                lasts = (way + self._pressed / stiffness) / speed
                self._slower = _Slower(stiffness, way, speed, needed and lasts < _LONGEST)
        return self._slower is not None and self._slower.needed

    def _hard(self) -> bool:
        """Whether it is pressed hard enough, or as hard as may be by what is known of the sensor's gain."""
        felt = float(self.recent() @ self.up)
        grows = 0.0 if self._slower is None else -self._speed * self._slower.stiffness * NOTICED
        return felt > self._pressed or self._watch.ratio * (felt + max(grows, 0.0)) > SAFE * self._most

    def _down(self) -> float:
        """Speed towards the surface [m/s]: what has grown beyond the force to be pressed with when it is answered.

        How stiff the contact is at most follows from how little was felt how deep.
        """
        felt = float(self.recent() @ self.up)
        if felt < _FELT:
            self._touched = None
            return self._pace
        self._touched = self.height if self._touched is None else self._touched
        stiffness = self._watch.stiffness
        if (depth := self._touched - self.height) > 0.0:
            stiffness = min(stiffness, _STEEPER * felt / depth)
        return min(self._pressing(stiffness), self._pace)

    def _go(self, target: Callable[[], float], done: Callable[[], bool], heard: bool = False) -> None:
        """Moves away from the surface with a speed [m/s] until it is done, and looks at every witness in each cycle.

        To hear the motors takes long: no answer waits for it.
        """
        arm, T = self._arm, self._known.robot.t_ipo
        states: list[_Heard] = []
        with arm.doing(lambda: self._hear(states)):
            while not done():
                if arm.guard.held is not None and arm.guard.reason is None:
                    self._wait()
                arm.check(arm.t)
                before = self._speed
                self._speed += float(np.clip(target() - self._speed, -_JERKY * T, _JERKY * T))
                arm.q_d = self.go(self._speed * T)
                state = arm.cycle(self.q)
                self.hear(state, self._force.arrived(arm.t))
                # Friction changes with the speed: motor torques are compared only at the speed of their reference in
                # the air, and the sensor's gain is measured only at constant speed.
                at_air = abs(self._speed + self._pace) < _EVEN * self._pace
                self._evenly = self._evenly + T if abs(self._speed - before) <= _EVEN * abs(before) else 0.0
                if heard:
                    felt = self.recent() if self._evenly > _STEADY else None
                    states.append((self.q, state, felt, abs(self._speed)))
                self._check(heard and at_air)

    def _wait(self) -> None:
        """Waits for an arm that stands, its commands where it is; raises ``_StoodError`` when it may be tried again."""
        for q_c in self._arm.guard.waiting():
            self._arm.q_d = q_c
            self._arm.cycle(q_c)
        self._arm.check(self._arm.t)
        raise _StoodError

    def _hear(self, states: list[_Heard]) -> None:
        """Hands cycles to the estimate by the motors."""
        while states:
            q_c, state, felt, speed = states.pop(0)
            self._motors.add(q_c, state.q, state.tau, felt, speed)
            if felt is not None and (gain := self._motors.gain.told) is not None:
                self.gain = gain
                self._watch.ratio = best_known([*self._gains, gain]).at_most

    @property
    def _by_motors(self) -> list[tuple[int, float]]:
        """Over how many cycles the motors are heard, and by how much they may then feel more than the sensor [N]."""
        slowly = round(WINDOW / self._known.robot.t_ipo), self._unfelt
        return [slowly] if self._alert is None else [slowly, (self._alert.cycles, self._alert.force)]

    def _high(self) -> bool:
        """Whether the tip is as high as pressing begins."""
        return self.height >= self.begins + ABOVE

    def _check(self, heard: bool) -> None:
        """Raises ``SceneError`` where the witnesses do not agree, or the surface is not where it can be.

        ``heard``: whether the motors are a witness now.
        """
        felt = self.recent()
        normal = float(felt @ self.up)
        if self.gain is not None and self.gain.wrong:
            raise SceneError(f"pressing was stopped: {wrong_gain(self.gain)}")
        sideways = float(np.linalg.norm(felt - normal * self.up))
        if normal < -_FELT or sideways > max(_FELT, abs(normal)):
            raise SceneError(f"pressing was stopped: {normal:.1f} N measured along the surface's normal and "
                             f"{sideways:.1f} N across it, which is not a contact force; check the force sensor's "
                             "sign, axes and bias")
        if self.height > self.begins and normal > _FELT:
            raise SceneError(f"pressing was stopped: {normal:.1f} N measured in the air; check whether the force "
                             "sensor's bias has jumped, or an obstacle is in the way")
        for cycles, least in self._by_motors if heard else ():
            by_motors = self._motors.lately(cycles) if self._evenly > cycles * self._known.robot.t_ipo else np.nan
            if by_motors - normal > np.hypot(least, SURELY * LOSSES * normal):
                raise SceneError(f"pressing was stopped: the motor torques show {by_motors:.0f} N and the force sensor "
                                 f"{normal:.1f} N; check that the sensor works")
        deepest = self.begins - ContactSettings.reach
        if self.height < deepest and normal < _FELT:
            raise SceneError(f"pressed {-1e3 * deepest:.0f} mm below the expected surface without contact; "
                             "check whether it is there, or move the surface in the scene")
