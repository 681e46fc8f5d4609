"""Filtering and synchronising of clamped recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ideal_robot.elasticity.clamped_signals import clamped_signals, lowpass, synchronise
from ideal_robot.elasticity.observer import ArmObserver, GearDeflection
from ideal_robot.elasticity.stiffness import least_squares
from ideal_robot.elasticity.stiffness_analysis import analyse_stiffness
from ideal_robot.errors import InputError
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.models import shipped_model
from sim.arm.arm import SimulatedArm
from sim.arm.world import World

ROBOT, MODEL = Robot.load("kr6"), Model.load(shipped_model("kr6"))
STIFFNESS = np.asarray(MODEL.gears.stiffness)


def behind(stiffness: np.ndarray) -> Model:
    """The arm behind gears of a stiffness ``(n,)`` [N m/rad]."""
    return replace(MODEL, gears=replace(MODEL.gears, stiffness=stiffness))


def test_lowpass_keeps_levels_and_removes_ripple() -> None:
    t = np.arange(0.0, 10.0, 0.002)
    level = 3.0 + 2.0 * (t > 5.0)
    smooth = lowpass(level + np.sin(2 * np.pi * 40 * t), 500.0)
    away = (t > 1) & (t < 4) | (t > 6) & (t < 9)
    np.testing.assert_allclose(smooth[away], level[away], atol=2e-3)


@pytest.mark.parametrize("offset", [-3.21, 0.0, 1.37, 8.4])
def test_clock_of_the_sensor_is_found(offset: float) -> None:
    rng = np.random.default_rng(1)
    drift = 2e-4
    t = np.arange(0.0, 60.0, 0.1)
    steps = np.repeat(rng.uniform(-1, 1, 30), 20)
    q_m = np.outer(np.convolve(steps, np.ones(5) / 5, mode="same"), [1e-3, -4e-4])
    true_time = np.arange(10.0, 50.0, 0.012)
    force = -2e6 * np.interp(true_time, t, q_m[:, 0]) + 3 * rng.standard_normal(len(true_time))
    clock = synchronise(t, q_m, (true_time - offset) / (1 + drift), force[:, None])
    instants = clock.offset + (1 + clock.drift) * (true_time - offset) / (1 + drift)
    assert np.max(np.abs(instants - true_time)) < 0.01


def test_what_cannot_be_used_is_said() -> None:
    robot = Robot.load("kr500")
    t = np.arange(0.0, 8.0, 0.002)
    q = np.zeros((len(t), 6))
    with pytest.raises(InputError, match="neither current_i"):
        clamped_signals(Recording.from_arrays(t, q=q), robot)
    for rows, joints, says in ((slice(None), 5, "5 joints"), (slice(500), 6, "at least 5 s"),
                               (slice(None, None, len(t) // 8), 6, "in 16 rows"), (slice(0), 6, "at least 5 s")):
        with pytest.raises(InputError, match=says):
            clamped_signals(Recording.from_arrays(t[rows], q=q[rows, :joints], tau=q[rows, :joints]), robot)


def test_without_drive_gains_recorded_torques_count_and_amperes_are_said() -> None:
    arm, unknown = ROBOT, replace(ROBOT, drive_gain=np.ones(6))
    t, rng = np.arange(0.0, 60.0, 0.012), np.random.default_rng(0)
    k = np.array([3e5, 3.5e5, 2e5, 3e4, 3e4, 1.3e4])
    tau = np.repeat(rng.uniform(-1, 1, (30, 6)), 167, axis=0)[: len(t)] * 1e-3 * k
    held = {"q": arm.home + tau / k + 1e-6 * rng.standard_normal(tau.shape), "current": tau / arm.drive_gain}
    currents, both = Recording.from_arrays(t, **held), Recording.from_arrays(t, **held, tau=tau)
    for robot, recording in ((arm, currents), (unknown, both)):
        analysis = analyse_stiffness(recording, robot)
        np.testing.assert_allclose([result.stiffness for result in analysis.joints], k, rtol=1e-3)
        assert analysis.warnings == ()
    analysis = analyse_stiffness(currents, unknown)
    np.testing.assert_allclose([result.stiffness for result in analysis.joints], k / arm.drive_gain, rtol=1e-3)
    assert analysis.warnings == (unknown.unknown_drive_gain,)


# Least squares with spreads.

def test_standard_deviations_are_those_of_repeated_experiments() -> None:
    """[J] (15)–(17) on angles that vary by a milliradian about 1.6 rad, as in the paper."""
    rng = np.random.default_rng(0)
    W = np.column_stack([1.62 + 2e-3 * rng.random(200), np.ones(200)])
    true = np.array([6.9e6, -1.1e7])
    fits = [least_squares(W, W @ true + 100 * rng.standard_normal(200)) for _ in range(300)]
    spread = np.std([fit.chi for fit in fits], axis=0)
    np.testing.assert_allclose(np.mean([fit.chi for fit in fits], axis=0), true, rtol=3e-3)
    for covariance in (fits[0].covariance, fits[0].robust):
        np.testing.assert_allclose(np.sqrt(np.diag(covariance)), spread, rtol=0.25)
    np.testing.assert_allclose(fits[0].std_percent, 100 * spread / np.abs(true), rtol=0.25)


def test_correlated_residuals_widen_the_robust_spread() -> None:
    rng = np.random.default_rng(0)
    x = np.linspace(-1, 1, 1000)
    slopes, robust, white = [], [], []
    for _ in range(200):
        noise = np.repeat(rng.standard_normal(25), 40)
        fit = least_squares(np.column_stack([x, np.ones(1000)]), 2 * x + noise, lag=40)
        slopes.append(fit.chi[0])
        robust.append(fit.robust[0, 0])
        white.append(fit.covariance[0, 0])
    assert np.sqrt(np.mean(robust)) == pytest.approx(np.std(slopes), rel=0.3)
    assert np.sqrt(np.mean(white)) < 0.3 * np.std(slopes)


def test_what_cannot_be_determined_is_said() -> None:
    with pytest.raises(InputError, match="2 samples"):
        least_squares(np.ones((2, 2)), np.ones(2))
    with pytest.raises(InputError, match="does not excite"):
        least_squares(np.ones((9, 2)), np.ones(9))


# Gear deflection on a path: all rows at once are what each row alone gives.

def test_a_whole_path_is_its_rows_one_by_one() -> None:
    deflection = GearDeflection(MODEL, 0.012)
    q_d = np.array([0.0, -1.2, 1.8, 0.0, 0.9, 0.0]) + 0.3 * np.sin(np.outer(0.012 * np.arange(40), np.arange(1, 7)))
    one_by_one = [deflection.at(q_d[max(k - 1, 0) : k + 2]) for k in range(len(q_d))]
    np.testing.assert_array_equal(deflection.along(q_d), one_by_one)
    assert np.abs(one_by_one).max() > 1e-5


# The arm angles behind elastic gears, against the simulated arm that the observer does not know.

def lively(world: World) -> tuple[np.ndarray, np.ndarray]:
    """Motor angles (as the controller tells) and true arm angles of a lively motion."""
    frequency = 2 * np.pi * np.array([0.8, 1.1, 1.3, 1.5, 0.9, 1.1])
    motors, arms = [ROBOT.home], []
    with SimulatedArm(ROBOT, world, np.random.default_rng(0)) as arm:
        arms.append(arm.truth.q_a)
        for k in range(250):
            t = 0.012 * k
            swing = np.array([0.1, 0.05, 0.05, 0.1, 0.1, 0.1]) * np.sin(frequency * t) * (1 - np.exp(-((t / 0.3) ** 2)))
            motors.append(arm.cycle(ROBOT.home + swing + 2e-4 * np.sin(2 * np.pi * 7 * t)).q)
            arms.append(arm.truth.q_a)
    return np.array(motors), np.array(arms)


@pytest.fixture(scope="module")
def moved() -> tuple[np.ndarray, np.ndarray]:
    """Of the arm whose gears all give."""
    return lively(World.default("kr6"))


def angles(observer: ArmObserver, q: np.ndarray) -> np.ndarray:
    """Arm angles behind motor angles ``(N, n)``, from rest."""
    states = [observer.init(q[0])]
    for row in q[1:]:
        states.append(observer.step(states[-1], row))
    return np.array([state.q_a for state in states])


def test_observer_removes_most_of_the_deflection(moved: tuple[np.ndarray, np.ndarray]) -> None:
    """Base joints, which carry the tip's error: below 40 % of the deflection is left, sag included below 10 %."""
    q, q_a = moved
    observed = angles(ArmObserver(MODEL, 0.012), q)
    before, after = (q - q_a)[40:, :3], (observed - q_a)[40:, :3]
    assert np.all(np.std(after, axis=0) < 0.4 * np.std(before, axis=0))
    assert np.sqrt(np.mean(after**2)) < 0.1 * np.sqrt(np.mean(before**2))


def test_at_rest_it_is_the_spring_under_weight_and_contact() -> None:
    """[J] (1): k (q − q_a) = G(q_a) − τ_ext, and a long rest does not change it."""
    observer = ArmObserver(MODEL, 0.012)
    tau_ext = np.array([10.0, 20.0, -5.0, 1.0, 2.0, 0.5])
    free, pressed = observer.init(ROBOT.home), observer.init(ROBOT.home, tau_ext)
    np.testing.assert_allclose(pressed.q_a - free.q_a, tau_ext / STIFFNESS, rtol=0.02, atol=1e-6)
    state = pressed
    for _ in range(100):
        state = observer.step(state, ROBOT.home, tau_ext)
    np.testing.assert_allclose(state.q_a, pressed.q_a, atol=2e-7)


def test_rigid_gears_lead_the_arm_and_hold_it() -> None:
    """Only joint 2 gives: the motion of its rigid neighbours deflects it, their weight does not."""
    world, elastic = World.default("kr6"), np.arange(6) == 1
    q, q_a = lively(replace(world, stiffness=np.where(elastic, world.per_joint("stiffness", 6), np.inf)))
    observer = ArmObserver(behind(np.where(elastic, STIFFNESS, np.inf)), 0.012)
    before, after = (q - q_a)[40:, 1], (angles(observer, q) - q_a)[40:, 1]
    assert np.std(after) < 0.15 * np.std(before)
    assert np.sqrt(np.mean(after**2)) < 0.05 * np.sqrt(np.mean(before**2))
    rest = observer.init(ROBOT.home)
    np.testing.assert_allclose(angles(observer, np.tile(ROBOT.home, (400, 1)))[-1], rest.q_a, atol=2e-7)


@pytest.mark.parametrize("joint", range(1, 7))
def test_a_gear_too_stiff_for_the_time_step_is_rigid(joint: int, moved: tuple[np.ndarray, np.ndarray]) -> None:
    """1e12 N m/rad is what the fit finds for a gear that does not bend; the others' angles are those beside a rigid."""
    q, own = moved[0][:60], np.arange(1, 7) == joint
    stiff, rigid = (angles(ArmObserver(behind(np.where(own, k, STIFFNESS)), 0.012), q)
                    for k in (1e12, np.inf))
    np.testing.assert_array_equal(stiff, rigid)


def test_the_stiffer_the_gears_the_less_they_bend(moved: tuple[np.ndarray, np.ndarray]) -> None:
    """Hooke's law up to any stiffness; vibrations may double it."""
    q = moved[0]
    soft, *stiffer = (np.max(np.abs(angles(ArmObserver(behind(factor * STIFFNESS), 0.012), q) - q),
                             axis=0) for factor in 10.0 ** np.arange(0.0, 6.5, 0.5))
    for i, bent in enumerate(stiffer, start=1):
        assert np.all(bent < 2.0 * soft / 10.0 ** (0.5 * i))


def test_without_stiffness_the_motors_are_the_arm() -> None:
    observer = ArmObserver(Model.nominal(ROBOT), 0.012)
    q = np.tile(ROBOT.home, (5, 1)) + 0.01 * np.arange(5)[:, None]
    np.testing.assert_array_equal(angles(observer, q)[1:], q[1:])
