"""Contact: what is wanted of it and felt of it, reasons to stop, following a contour, motors as a witness."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from ideal_robot.arrays import Array
from ideal_robot.elasticity.observer import ArmObserver
from ideal_robot.errors import InputError
from ideal_robot.friction.presliding import sliding_direction
from ideal_robot.model.model import Model
from ideal_robot.robots.interface import RobotState
from ideal_robot.robots.robot import Robot
from planning.force.contact import (
    BEGUN,
    CLEAR,
    FORCE_ERRORS,
    GENTLEST,
    LONGEST,
    NOTICED,
    SHARE,
    SLOPE,
    STAMPS,
    UNSEEN,
    ContactSettings,
    EmergencyStopError,
    StopConditions,
    StopLimits,
    Tare,
    dry_run,
    most_force,
)
from planning.force.contour import ContourFollower, ContourSettings
from planning.force.felt_by_motors import BEHIND, BeyondSensor, FeltByMotors, settle_and_air, soonest
from planning.force.surface_forecast import FeltArm
from planning.path.kinematics import InverseKinematics
from planning.path.reference import ReferencePath
from scenes.force.cell import set_up
from scenes.models import shipped_model
from scenes.scene_file import load_scene
from tests.planning.cell import T, kr6


def test_a_slope_that_was_not_felt_yet_costs_no_more_force_on_a_stiff_contact() -> None:
    """From rest with constant jerk: way j t³/6, times slope and stiffness; full acceleration costs 11 N at 50 N/mm."""
    for stiffness in (1e4, 2e4, 3e4, 5e4):
        distance = ContactSettings(elasticity=stiffness).jerk(0.3, 40.0) * UNSEEN**3 / 6.0
        assert distance * SLOPE * stiffness < BEGUN * (1 + 1e-9)


def test_a_soft_contact_begins_as_it_is_told() -> None:
    assert ContactSettings(elasticity=4e3).jerk(0.3, 40.0) == 40.0


def test_no_contact_is_so_stiff_that_the_travel_does_not_begin() -> None:
    np.testing.assert_equal(ContactSettings(elasticity=1e9).jerk(0.3, 40.0), GENTLEST)


def test_the_stiffer_a_tip_the_less_its_damping_delays_the_force() -> None:
    """A tip of 8 N s/m at 50 N/mm is 0.16 ms late; left free within 2 ms, the estimate wandered by 2 ms."""
    soft, stiff = (ContactSettings(elasticity=k).lateness for k in (4e3, 5e4))
    assert soft == FORCE_ERRORS[1]
    assert STAMPS < stiff < 0.6e-3


def test_the_largest_force_is_half_as_much_again_as_wanted_and_what_a_hand_bears_below() -> None:
    assert [most_force(wanted) for wanted in (1.0, 20.0, 26.0, 30.0, 50.0)] == [40.0, 40.0, 40.0, 45.0, 75.0]


# The motion above a path before the job: it keeps away, rests at both ends, and keeps the joints' speeds.

ROBOT = Robot.load("kr6")
REFERENCE = ReferencePath(np.column_stack([np.full(60, 0.95), np.linspace(-0.3, 0.3, 60), np.full(60, 0.4)]),
                          turning=1.0)


def planned(speed: float, robot: Robot = ROBOT) -> Array:
    return dry_run(robot, REFERENCE, speed, InverseKinematics(robot).search(REFERENCE.pose(0.0), robot.home))


def test_it_goes_along_the_path_and_back_without_coming_near_the_surface() -> None:
    q = planned(0.2)
    where = ROBOT.tool_places(q)
    assert where[:, 2].min() > 0.4 + CLEAR - 1e-6
    np.testing.assert_allclose(where[0], where[-1], atol=1e-6)
    assert np.ptp(where[:, 1]) > 0.55
    # Slow at both ends, at the speed of the job in between.
    along = np.abs(np.diff(where[:, 1])) / ROBOT.t_ipo
    assert along[0] < 0.01
    assert along[-1] < 0.01
    np.testing.assert_allclose(along.max(), 0.2, rtol=0.02)


def test_joints_that_carry_the_height_turn_round_again_and_again() -> None:
    v = np.diff(planned(0.2), axis=0)
    assert np.all(np.sum(np.diff(np.sign(v[:, [1, 2, 4]]), axis=0) != 0, axis=0) >= 3)


def test_a_long_path_takes_no_longer_and_slow_joints_take_their_time() -> None:
    assert len(planned(0.02)) * ROBOT.t_ipo <= LONGEST + ROBOT.t_ipo
    slow = replace(ROBOT, v_max=ROBOT.v_max / 20.0)
    v = np.abs(np.diff(planned(0.2, slow), axis=0)) / ROBOT.t_ipo
    assert np.all(v <= SHARE * slow.v_max * (1.0 + 1e-9))


# Every reason to stop is noticed and said with value, limit and remedy.

@pytest.fixture
def watch() -> StopConditions:
    return StopConditions(Robot.load("kr6"), StopLimits(force=50.0, lost=0.1))


def motion(robot: Robot, speed: float, acceleration: float = 0.0, joint: int = 1) -> np.ndarray:
    t = robot.t_ipo * np.arange(12)
    q = np.tile(robot.home, (12, 1))
    q[:, joint] += speed * t + 0.5 * acceleration * t * (t - t[-1])
    return q


def test_what_is_allowed_passes(watch: StopConditions) -> None:
    watch.force(1.0, 49.0)
    watch.contact(1.0, 0.95)
    watch.approach(1.0, 0.01, 0.05)
    watch.command(1.0, motion(Robot.load("kr6"), 0.5))


@pytest.mark.parametrize(("call", "cause", "text"), [
    (lambda w, r: w.force(1.0, 51.0), "force", "51.0 N is above the limit 50.0 N"),
    (lambda w, r: w.force(1.0, float("nan")), "force", "nan N is above the limit 50.0 N"),
    (lambda w, r: w.contact(1.0, 0.85), "contact", "150 ms ago, allowed are 100 ms"),
    (lambda w, r: w.approach(1.0, 0.06, 0.05), "contact", "no contact within 50 mm"),
    (lambda w, r: w.command(1.0, motion(r, 1.1 * r.v_max[1])), "velocity", "joint 2 would need velocity"),
    (lambda w, r: w.command(1.0, motion(r, 0.0, 1.1 * r.a_max[1])), "acceleration", "joint 2 would need acceleration"),
    (lambda w, r: w.command(1.0, np.tile(r.q_max + 0.01, (5, 1))), "position", "would need position"),
])
def test_what_is_not_allowed_stops(watch: StopConditions, call: object, cause: str, text: str) -> None:
    with pytest.raises(EmergencyStopError, match=text.replace(".", r"\.")) as caught:
        call(watch, Robot.load("kr6"))  # type: ignore[operator]
    assert caught.value.cause == cause
    assert "stopped at t = 1.000 s" in str(caught.value)


@pytest.mark.parametrize("share", [1.0, 0.4])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("joint", range(6))
def test_joints_may_use_their_share_of_the_limits_and_no_thousandth_more(joint: int, sign: float, share: float) -> None:
    robot = Robot.load("kr6")
    watch = StopConditions(robot, StopLimits(share=share))
    speed, acceleration = sign * share * robot.v_max[joint], sign * share * robot.a_max[joint]
    for q_d, cause in ((lambda k: motion(robot, k * speed, joint=joint), "velocity"),
                       (lambda k: motion(robot, 0.0, k * acceleration, joint), "acceleration")):
        watch.command(1.0, q_d(0.999))
        with pytest.raises(EmergencyStopError) as caught:
            watch.command(1.0, q_d(1.001))
        assert caught.value.cause == cause
    limit = (robot.q_max if sign > 0 else robot.q_min)[joint]
    q = np.tile(robot.home, (5, 1))
    q[:, joint] = limit - 1e-4 * sign
    watch.command(1.0, q)
    q[3, joint] = limit + 1e-4 * sign
    with pytest.raises(EmergencyStopError, match="position"):
        watch.command(1.0, q)


def test_limits_have_to_make_sense() -> None:
    with pytest.raises(InputError, match="positive"):
        StopLimits(force=0.0)


# The arm behind its gears, once the forces that bent them are known.

def test_late_forces_give_what_an_observer_gives_that_knew_them_at_once() -> None:
    robot = kr6()
    model = Model.load(shipped_model("kr6"))
    rng = np.random.default_rng(2)
    force = np.array([0.0, 0.0, 1.0]) * (20.0 + 10.0 * rng.standard_normal((30, 1)))

    def torque(q: np.ndarray, f: np.ndarray) -> np.ndarray:
        data = robot.pinocchio.createData()
        jacobian = pin.computeFrameJacobian(robot.pinocchio, data, q, robot.tool_id, pin.LOCAL_WORLD_ALIGNED)
        return np.asarray(jacobian[:3].T @ f)

    felt, knew = FeltArm(ArmObserver(model, T), robot.home, torque), ArmObserver(model, T)
    state = knew.init(robot.home)
    revised: dict[int, np.ndarray] = {}
    truth: dict[int, np.ndarray] = {}
    for k in range(30):
        q = robot.home + 0.01 * np.sin(0.3 * k)
        felt.step(k * T, q, torque(robot.home, np.array([0.0, 0.0, 20.0])))
        state = knew.step(state, q, torque(state.q_a, force[k]))
        truth[k] = state.q_a
        if k >= 2:
            changed = felt.feel(np.array([(k - 2) * T - 0.004]), force[k - 2][None])
            revised.update((round(t / T), q_a) for t, q_a in changed)
    for k in range(5, 28):
        np.testing.assert_allclose(revised[k], truth[k], atol=5e-6)


def test_an_arm_unheard_of_for_some_cycles_is_where_it_would_be_had_it_been_heard() -> None:
    """Without the steps between, what it moved in five cycles was the speed of one, and it swung by millimetres."""
    robot, model = kr6(), Model.load(shipped_model("kr6"))
    felt, knew = (FeltArm(ArmObserver(model, T), robot.home, lambda q, f: np.zeros(6)) for _ in range(2))
    rate, still = np.array([0.2, 0.05, -0.1, 0.02, 0.3, 0.1]), np.zeros(6)
    for k in range(1, 60):
        angles = robot.home + rate * T * max(k - 20, 0)
        q_a = knew.step(k * T, angles, still)
        if not 40 <= k < 44:
            q_felt = felt.step(k * T, angles, still, 5 if k == 44 else 1)
            np.testing.assert_allclose(q_felt, q_a, atol=1e-12)


def test_drift_of_the_bias_shows_in_the_air_and_a_touch_does_not() -> None:
    tare, t = Tare(), np.arange(0.0, 0.3, 0.004)
    drift = np.array([0.1, -0.1, 0.3])
    touching = np.where(t > 0.26, 50.0 * (t - 0.26), 0.0)[:, None] * np.array([0.0, 0.0, 1.0])
    for instant, force in zip(t, drift + touching, strict=True):
        tare.add(np.array([instant]), force[None])
    np.testing.assert_allclose(tare.force, drift, atol=1e-12)


# A contour followed without a reference path, by an arm that goes where it is told.

TURNED = np.radians(15.0)
"""Of the wall against the direction that it is looked for in."""


def test_the_felt_path_tells_the_normal_whatever_friction_pulls_at_the_tip() -> None:
    """Friction of 0.4 turns the force by 22°; by the force alone the normal would be as far off."""
    robot = Robot.load("kr6")
    start = robot.fk()(robot.home)
    towards, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    settings = ContourSettings(friction=0.0, length=0.1)
    axes = np.stack([towards, np.cross(up, towards)])
    follower = ContourFollower(robot, start, axes, robot.home, 20, settings)
    out = np.array([-np.cos(TURNED), np.sin(TURNED)])
    along = np.array([out[1], -out[0]])
    fk, late, pressed = robot.fk(), None, []
    for k in range(1, 400):
        t = k * robot.t_ipo
        if late is not None:
            follower.measured(np.array([late[0]]), late[1][None])
        q = follower.horizon(t)[0]
        follower.observe(t, q)
        tip = fk(q)
        here = axes @ (tip.translation - start.translation)
        depth = -(here - [0.005, 0.0]) @ out
        push = settings.elasticity * max(float(depth), 0.0)
        force = push * out - (0.4 * push * along if follower.moving else 0.0)
        late = (t, tip.rotation.T @ (axes.T @ force))
        if follower.travelled > 0.075:
            pressed.append((push, follower._normal @ out))
        if follower.travelled >= settings.length - 1e-5:
            break
    force, aligned = np.array(pressed).T
    assert np.degrees(np.arccos(aligned.min())) < 2.0
    assert np.abs(force - settings.force).max() < 2.0


@examples(max_examples=50, deadline=None)
@given(st.tuples(st.floats(-4.0, 1.0), st.floats(-3.0, 0.0), st.floats(-1.0, 1.0)))
def test_a_contour_is_passed_within_speed_and_acceleration_however_short(powers: tuple[float, ...]) -> None:
    length, speed, acceleration = (10.0**power for power in powers)
    contour = ContourSettings(length=length, speed=speed, acceleration=acceleration)
    follower = ContourFollower(kr6(), pin.SE3.Identity(), np.eye(3)[:2], kr6().home, 20, contour)
    follower._moving_from = 0.0
    t = np.linspace(-0.1, 1.1, 601) * (length / speed + 2.0 * speed / acceleration)
    s = np.array([follower.s_at(instant) for instant in t])
    v, slack = np.diff(s) / (t[1] - t[0]), 1e-9 * speed
    assert s[0] == 0.0
    assert s[-1] == pytest.approx(length)
    assert np.all((v >= -slack) & (v <= speed + slack))
    assert np.abs(np.diff(v)).max() <= acceleration * (t[1] - t[0]) + slack


# The motors as a witness along a path.

CYCLE, UP = 0.004, np.eye(3)[2]


@cache
def known() -> tuple[Robot, Model]:
    cell = set_up(load_scene("force_wave")).known
    return cell.robot, cell.model


def heard(way: Array, unfelt: float, currents: bool = True, speed: float = 0.2) -> float:
    """What is heard of a force that the sensor does not tell [N], the joints swinging so far ``(n,)`` [rad]."""
    (robot, model), rng = known(), np.random.default_rng(1)
    motors, kinematics = BeyondSensor(model, CYCLE), InverseKinematics(robot)
    t = CYCLE * np.arange(800)[:, None]
    q, v, a = (robot.home + way * np.sin(3 * t), 3 * way * np.cos(3 * t), -9 * way * np.sin(3 * t))
    for k in range(len(t)):
        torque = kinematics.torque(q[k], UP)
        tau = model.inverse_dynamics(q[k], v[k], a[k])[0] - torque * (20.0 + unfelt)
        tau = tau + model.noise_std * rng.standard_normal(robot.n)
        motors.hear(RobotState(CYCLE * k, q[k], tau if currents else np.full(robot.n, np.nan)), torque, 20.0, speed)
        motors.weigh()
    return motors.excess


@pytest.mark.parametrize("unfelt", [pytest.param(0.0, marks=pytest.mark.slow), 25.0])
def test_friction_of_slow_joints_that_no_model_knows_is_no_force(unfelt: float) -> None:
    """5 to 30 mrad/s, friction beside the model's as large as its residual; it turns round over the presliding way."""
    robot, model = known()
    motors, kinematics, excess = BeyondSensor(model, robot.t_ipo), InverseKinematics(robot), []
    distance = np.array([float(law.shape[-1, 0]) for law in model.friction.laws])
    t, rate = robot.t_ipo * np.arange(2000)[:, None], 0.05 * np.arange(1.0, 7.0)
    q, v = robot.home + 0.1 * np.sin(rate * t + 1.0), 0.1 * rate * np.cos(rate * t + 1.0)
    slides = sliding_direction(q, v, distance)
    for k in range(len(t)):
        torque = kinematics.torque(q[k], UP)
        tau = model.inverse_dynamics(q[k], v[k], 0.0 * v[k], direction=slides[k][None])[0] + model.noise_std * slides[k]
        motors.hear(RobotState(t[k, 0], q[k], tau - torque * (20.0 + unfelt)), torque, 20.0, 0.01)
        motors.weigh()
        excess.append(motors.excess)
    assert motors.excess == pytest.approx(unfelt, abs=2.0)
    assert unfelt or max(np.abs(excess)) < 4.0


@pytest.mark.parametrize("unfelt", [10.0, pytest.param(-6.0, marks=pytest.mark.slow)])
def test_a_force_that_the_sensor_does_not_tell_is_found(unfelt: float) -> None:
    assert heard(np.full(6, 0.1), unfelt) == pytest.approx(unfelt, abs=1.0)


def test_joints_at_rest_a_tip_at_rest_and_controllers_without_currents_say_nothing() -> None:
    assert abs(heard(np.zeros(6), 10.0)) < 1.0
    assert heard(np.full(6, 0.1), 10.0, speed=0.0) == 0.0
    assert heard(np.full(6, 0.1), 10.0, currents=False) == 0.0


def test_motions_before_and_after_lost_cycles_are_no_acceleration() -> None:
    """A follower that was not let run for 50 ms took what the arm had moved meanwhile for one cycle's: 79 N."""
    robot, model = known()
    motors, torque = BeyondSensor(model, CYCLE), InverseKinematics(robot).torque(robot.home, UP)
    rate, lost, t = np.array([0.2, 0.05, -0.1, 0.02, 0.3, 0.1]), 5, 0.0
    for k in range(400):
        gap = k % 50 == 49
        t += CYCLE * (lost if gap else 1)
        tau = model.inverse_dynamics(robot.home + rate * t, rate, 0.0 * rate)[0] - 20.0 * torque
        state = RobotState(CYCLE * k, robot.home + rate * t, np.full(robot.n, np.nan) if gap else tau)
        motors.hear(state, torque, 20.0, 0.2)
        motors.weigh()
    assert abs(motors.excess) < 0.5


def test_motions_before_and_after_a_standstill_are_no_force() -> None:
    """An arm that was paused on a contour was stopped when it went on: 27 N that the motors felt beyond the sensor."""
    robot, model = known()
    motors, torque = BeyondSensor(model, CYCLE), InverseKinematics(robot).torque(robot.home, UP)
    rate = np.array([0.2, 0.05, -0.1, 0.02, 0.3, 0.1])
    for stretch in range(4):
        # Meanwhile the arm has gone elsewhere, its joints rest, and friction is another one.
        place, other = robot.home + 0.05 * stretch, model.noise_std * (-1.0) ** stretch
        for k in range(200):
            tau = model.inverse_dynamics(place + rate * CYCLE * k, rate, 0.0 * rate)[0] - 20.0 * torque + other
            motors.hear(RobotState(CYCLE * k, place + rate * CYCLE * k, tau), torque, 20.0, 0.2)
            motors.weigh()
            assert abs(motors.excess) < 5.0
        motors.stood()


@pytest.mark.parametrize(("cycle", "needed"), [(0.012, 3), (0.004, 7)])
@pytest.mark.parametrize(("sense", "speed"), [(1.0, 0.3), (-1.0, -0.1)])
def test_the_first_word_of_the_motors_is_what_a_random_walk_lets_expect(cycle: float, needed: int, sense: float,
                                                                       speed: float) -> None:
    """Joints that slide on: the weights of the joints, the prior, and the instant whose motion counts."""
    robot, model = known()
    motors, torque = BeyondSensor(model, cycle), InverseKinematics(robot).torque(robot.home, UP)
    rate, rest = sense * np.array([0.2, 0.05, -0.1, 0.02, 0.3, 0.1]), np.array([90.0, -120.0, 60.0, 3.0, -6.0, 3.0])
    q = robot.home + rate * cycle * np.arange(needed)[:, None]
    distance = np.array([float(law.shape[-1, 0]) for law in model.friction.laws])
    for k in range(needed):
        assert motors.excess == 0.0
        turned = 1.0 - np.exp(-k * np.abs(rate) * cycle / distance)
        tau = model.inverse_dynamics(q[k], rate, 0.0 * rate, direction=(np.sign(rate) * turned)[None])[0]
        motors.hear(RobotState(cycle * k, q[k], tau - 20.0 * torque + rest), torque, 20.0, speed)
        motors.weigh()
    middle = needed // 2
    unturned = np.exp(-middle * np.abs(rate) * cycle / distance)
    friction = model.friction.torque(np.abs(rate)[None], None, None, np.ones((1, 6)))[0]
    waited = needed * cycle
    beside = ((1.0 - unturned) * model.noise_std) ** 2
    lasts = 0.5 + 0.004 / np.abs(rate)
    unknown = np.diag(beside + 2.0 * (model.noise_std + unturned * friction) ** 2 * lasts / waited)
    prior = 35.0**2 * abs(speed) * waited
    expected = -prior * torque @ np.linalg.solve(prior * np.outer(torque, torque) + unknown, rest)
    assert motors.excess == pytest.approx(expected, rel=1e-6)
    assert abs(expected) > 0.1


@pytest.mark.parametrize("force", [0.0, 15.0, -8.0])
@pytest.mark.parametrize("offset", [0.0, 2.0])
def test_a_force_since_the_air_is_found_whatever_friction_the_model_has_wrong(force: float, offset: float) -> None:
    """A straight slow motion: in the air first, then touching; the torque that no model knows stays the same."""
    (robot, model), rng = known(), np.random.default_rng(2)
    kinematics = InverseKinematics(robot)
    felt = FeltByMotors(model, robot, kinematics, UP, settle=0.4)
    T, late = robot.t_ipo, round(BEHIND / robot.t_ipo)
    half_a = 0.1 * np.array([0.02, 0.05, -0.04, 0.03, 0.06, -0.02])
    t = T * np.arange(round(2.0 / T))[:, None]
    q, v, a = robot.home + half_a * t * t, 2.0 * half_a * t, np.tile(2.0 * half_a, (len(t), 1))
    for k in range(late, len(t)):
        tau = model.inverse_dynamics(q[k - late], v[k - late], a[k - late])[0] + offset
        if t[k, 0] > 1.2:
            tau = tau - force * kinematics.torque(q[k - late], UP)
        felt.add(q[k], q[k - late], tau + 0.1 * model.noise_std * rng.standard_normal(robot.n))
        # Known once the air was averaged: 0.4 s after friction has settled.
        assert np.isnan(felt.force) == (k - late < round(0.4 / T) + round(0.4 / T) - 2)
    assert felt.force == pytest.approx(force, abs=0.7)


@pytest.mark.parametrize("pace", [0.1e-3, 0.24e-3, 1e-3, 3e-3, 10e-3])
def test_the_air_is_heard_when_friction_has_come_to_that_of_the_speed(pace: float) -> None:
    """Friction of another speed comes over a way. Behind 0.4 s at 0.24 mm/s half of it was still to come: 5 N too
    little were taken for air, and a sound sensor was refused for it (``force_wave``, seed 103)."""
    (robot, model), way = known(), max(3e-3, pace * 0.8)
    kinematics = InverseKinematics(robot)
    rates = np.abs(kinematics.away(robot.home, 1e-3 * UP)) / 1e-3
    joints = np.abs(kinematics.torque(robot.home, UP)) > 0.1
    distance = (np.array([float(law.shape[-1, 0]) for law in model.friction.laws]) / np.maximum(rates, 1e-9))[joints]
    settle, air = settle_and_air(way, pace)
    assert (settle + air) * pace <= way * (1.0 + 1e-9)
    x = pace * np.linspace(settle, settle + air, 100)[:, None]
    assert (np.exp(-x / distance).mean(axis=0) - np.exp(-way / distance) < 0.1).all()


@pytest.mark.parametrize("scatter", [1.0, 5.0, 11.0])
def test_motors_notice_a_force_that_no_sensor_tells_before_it_is_too_large(scatter: float) -> None:
    """A rigid contact that is met by a sensor that has died: the force that it has come to when the arm lets go."""
    T, least, most, air, rng = 0.012, 15.0, 36.0, 2.0, np.random.default_rng(4)
    alert = soonest(scatter, least, most, T, air)
    assert alert is not None
    assert alert.force >= least
    reached = []
    for _ in range(200):
        force = np.r_[np.zeros(100), alert.rate * T * np.arange(200.0)]
        heard = force + scatter * rng.standard_normal(300)
        mean = np.convolve(heard, np.full(alert.cycles, 1.0 / alert.cycles))[:300]
        noticed = int(np.argmax(mean - scatter * np.sqrt(T / air) * rng.standard_normal() > alert.force))
        assert noticed >= 100
        reached.append(force[noticed] + alert.rate * NOTICED)
    assert np.mean(reached) <= most + 1.5 * alert.rate * T
    assert np.percentile(reached, 95) <= most / 0.9 + 1.5 * alert.rate * T


def test_motors_that_scatter_by_more_than_may_be_borne_are_no_witness() -> None:
    assert soonest(200.0, 15.0, 36.0, 0.012, 2.0) is None
    assert soonest(5.0, 40.0, 36.0, 0.012, 2.0) is None
    # The less they scatter and the more may be borne, the faster it may rise.
    rates = [soonest(scatter, 5.0, most, 0.012, 2.0).rate for scatter, most in ((10.0, 30.0), (5.0, 30.0), (5.0, 60.0))]
    assert rates == sorted(rates)
