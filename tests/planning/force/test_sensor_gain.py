"""The gain of a force sensor is what it was made with, within its standard deviation; sound ones are believed."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.arrays import GRAVITY
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from planning.force.felt_by_motors import Hearing
from planning.force.sensor_gain import (
    LOSSES,
    UNKNOWN,
    GainByMotors,
    SensorGain,
    best_known,
    block_cycles,
    gain_by_weight,
)
from planning.path.kinematics import InverseKinematics
from scenes.arms import shipped_model
from sensing.force.force_calibration import identify_tool

GAINS = (0.5, 0.7, 1.5)
BLOCK = 17
DISTANCE = np.full(2, 2.5e-4)


def pressed(gain: float, rng: np.random.Generator, *, slower: bool) -> SensorGain:
    """Motors heard in the air and while 28 N are pressed with, the second half of it at another speed or not.

    Torques scatter by 10 N m from cycle to cycle; friction beside the model's is of some newton metres.
    """
    noise, beside, lever = np.array([10.0, 5.0]), np.array([5.4, 3.1]), np.array([-0.81, -0.29])
    losses = 1.0 + 0.03 * rng.standard_normal()
    motors, friction = GainByMotors(beside, DISTANCE, BLOCK), 10.0 * rng.standard_normal(2)
    way, begun, change, speed = np.full(2, 2e-3), np.zeros(2), np.zeros(2), 1e-3
    true = np.concatenate([np.zeros(16 * BLOCK), np.linspace(0.0, 28.0, 40 * BLOCK)])
    for cycle, force in enumerate(true):
        if slower and cycle == len(true) // 2:
            change, begun, speed = beside * rng.standard_normal(2), way, 1e-4
        # Another speed has another friction, to which it comes over the presliding distance.
        beside_now = friction + change * (1.0 - np.exp(-(way - begun) / DISTANCE))
        rest = beside_now - losses * lever * force + noise * rng.standard_normal(2)
        way = way + speed * 0.012
        motors.add(rest, lever * gain * force, way, speed)
    assert motors.told is not None
    return motors.told


@pytest.mark.parametrize("slower", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_motors_tell_a_sensors_gain(slower: bool) -> None:
    rng = np.random.default_rng(11)
    sound = [pressed(1.0, rng, slower=slower) for _ in range(60)]
    assert not any(gain.wrong for gain in sound)
    z = [(gain.inverse - 1.0) / gain.sigma for gain in sound]
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.3
    # Where friction changes meanwhile less is known, and said to be known.
    for gain, noticed in ((0.5, 0.0 if slower else 1.0), (0.7, 0.0 if slower else 0.6), (1.5, 0.0)):
        faulty = [pressed(gain, rng, slower=slower) for _ in range(20)]
        assert np.mean([told.wrong for told in faulty]) >= noticed
        assert np.mean([told.value for told in faulty]) == pytest.approx(gain, rel=0.1)


@pytest.mark.parametrize("drifts", [0.0, 0.8])
def test_friction_that_drifts_from_block_to_block_is_no_gain(drifts: float) -> None:
    """σ is true at every look, also where a third of what blocks scatter by is alike in ten of them."""
    rng, z = np.random.default_rng(6), list[float]()
    noise, lever = np.array([10.0, 5.0]), np.array([-0.81, -0.29])
    true = np.concatenate([np.zeros(120 * BLOCK), np.linspace(0.0, 20.0, 60 * BLOCK)])
    for _ in range(25):
        motors, slow, looks = GainByMotors(np.array([5.4, 3.1]), DISTANCE, BLOCK), np.zeros(2), list[float]()
        for cycle, force in enumerate(true):
            if cycle % BLOCK == 0:
                slow = 0.9 * slow + 0.436 * drifts * noise / np.sqrt(BLOCK) * rng.standard_normal(2)
            rest = slow - lever * force + noise * rng.standard_normal(2)
            motors.add(rest, lever * force, np.full(2, 2e-3), 1e-3)
            if cycle >= 118 * BLOCK and cycle % (5 * BLOCK) == 0 and motors.told is not None:
                looks.append((motors.told.inverse - 1.0) / motors.told.sigma)
        z += looks
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.3


@pytest.mark.parametrize("stiffness", [4e3, pytest.param(1e5, marks=pytest.mark.slow), 3e5])
def test_pressed_as_slowly_as_it_takes_the_motors_tell_a_gain_as_well_as_gears_let_them(stiffness: float) -> None:
    """On 100 N/mm pressing took half a second, and a gain of 0.5 was told by nobody."""
    robot, model, up, most = Robot.load("kr6"), Model.load(shipped_model("kr6")), np.eye(3)[2], 28.0
    kinematics, noise = InverseKinematics(robot), 2.0 * model.noise_std
    hearing, T = Hearing(model, robot, kinematics, robot.home, up, noise, most), robot.t_ipo
    way, speed = hearing.quickest(stiffness)
    seconds = most / (stiffness * speed)
    assert (way / speed + seconds) < 180.0
    lever, distance = kinematics.torque(robot.home, up), model.friction.distance
    rates = np.abs(kinematics.away(robot.home, 1e-3 * up)) / 1e-3
    rng, told = np.random.default_rng(4), list[SensorGain]()
    for gain in (1.0, 0.5):
        beside, friction = model.noise_std + model.friction.dry, 10.0 * noise
        motors, air = GainByMotors(beside, distance, block_cycles(T, way / speed)), round((way / speed + 0.5) / T)
        for cycle in range(air + round(seconds / T)):
            force = max(cycle - air, 0) * T * speed * stiffness
            rest = friction - lever * force + noise * rng.standard_normal(robot.n)
            motors.add(rest, gain * lever * force, cycle * T * speed * rates, speed)
        assert motors.told is not None
        assert motors.told.sigma < 2.0 * LOSSES / gain
        assert abs(motors.told.inverse - 1.0 / gain) < 4.0 * motors.told.sigma
        told.append(motors.told)
    assert [gain.wrong for gain in told] == [False, True]


def test_a_gain_that_nobody_has_measured_may_be_a_half() -> None:
    known = [SensorGain(1.1, 0.1, ""), SensorGain(1.0, 0.03, "")]
    assert best_known([]) is UNKNOWN
    assert UNKNOWN.at_most == 2.0
    assert best_known(known).at_most == pytest.approx(1.06)


def test_what_would_pass_is_noticed_in_half_of_the_cases() -> None:
    rng, sigma = np.random.default_rng(3), 0.08
    for gain in SensorGain(1.0, sigma, "").passes:
        told = [SensorGain(1.0 / gain + sigma * rng.standard_normal(), sigma, "").wrong for _ in range(2000)]
        assert 0.45 < np.mean(told) < 0.55


def test_joints_that_turned_round_are_not_heard_and_silent_motors_tell_nothing() -> None:
    motors = GainByMotors(np.ones(2), DISTANCE, BLOCK)
    for cycle in range(20 * BLOCK):
        motors.add(np.full(2, float(cycle)), np.full(2, 0.01 * cycle), np.zeros(2), 1e-3)
    assert motors.told is None
    for _ in range(20 * BLOCK):
        motors.add(np.full(2, np.nan), np.ones(2), np.ones(2), 1e-3)
    assert motors.told is None


@pytest.mark.parametrize("mass", [0.5, 0.8, 3.0])
def test_a_stated_weight_tells_a_sensors_gain(mass: float) -> None:
    """Weighed in postures that gears and links leave within a degree of where they are believed."""
    rng, com = np.random.default_rng(5), np.array([0.0, 0.01, -0.08])

    def weighed(gain: float) -> SensorGain:
        wrenches, rotations = [], []
        for turn, bend in ((0.0, 0.0), (0.0, 0.4), (0.0, -0.4), (0.5, 0.3), (1.0, 0.5), (-0.5, 0.4), (-1.0, -0.3)):
            axis = np.array([np.sin(turn), np.cos(turn), 0.0])
            rotation, true = (_turned(axis, np.pi + bend + error) for error in (0.0, 0.01 * rng.standard_normal()))
            force = mass * true.T @ GRAVITY
            wrench = np.concatenate([force, np.cross(com, force)])
            wrenches.append(3.0 + gain * wrench + 0.03 * rng.standard_normal(6))
            rotations.append(rotation)
        return gain_by_weight(identify_tool(np.array(wrenches), rotations), mass)

    assert not any(weighed(1.0).wrong for _ in range(200))
    for gain in GAINS:
        told = [weighed(gain) for _ in range(20)]
        assert all(one.wrong for one in told)
        assert np.mean([one.value for one in told]) == pytest.approx(gain, rel=0.02)


def _turned(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
