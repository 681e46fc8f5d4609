"""The parts the feedforwards are made of: smoothing, command inverse, TCP errors, training, the paper's equations."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from ideal_robot.arrays import eased
from ideal_robot.effects import FittedEffect
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import PassThrough
from ideal_robot.feedforward.command_path import command_path_inverse
from ideal_robot.feedforward.inverse import AHEAD, PRINTED, Inverse
from ideal_robot.feedforward.joint_errors import AXES, joint_errors, pose_errors
from ideal_robot.feedforward.linear_inverse import LinearInverse
from ideal_robot.feedforward.path_operators import spline_operators
from ideal_robot.feedforward.smoothed_window import CYCLES, Smoothed, Window, noted, smoothed
from ideal_robot.feedforward.training import train
from ideal_robot.loop.from_model import cascade_gains, loop_model
from ideal_robot.loop.impulse_response import LinearLoop
from ideal_robot.loop.simulation import interpolated, low_passed, simulate
from ideal_robot.model.model import Model
from tests.arms import ROBOT, T, commands, motion, off, plant, rms
from tests.ideal_robot.feedforward.test_laws import nominal_model


def test_smoothing_is_exact_on_cubics():
    t = T * np.arange(-6, 13, dtype=float)
    instants = np.linspace(0.0, 0.08, 7)
    value, first, second = spline_operators(t, instants, T, cutoff=14.0)
    cubic = np.polynomial.Polynomial([0.3, -1.0, 4.0, 20.0])
    np.testing.assert_allclose(value @ cubic(t), cubic(instants), atol=1e-9)
    np.testing.assert_allclose(first @ cubic(t), cubic.deriv()(instants), atol=1e-7)
    np.testing.assert_allclose(second @ cubic(t), cubic.deriv(2)(instants), atol=1e-5)


def test_smoothing_passes_slow_and_stops_fast():
    t = T * np.arange(-30, 31, dtype=float)
    value = spline_operators(t, np.zeros(1), T, cutoff=14.0, orders=1)[0]
    gain = {f: float((value @ np.cos(2 * np.pi * f * t))[0]) for f in (3.0, 14.0, 35.0)}
    assert gain[3.0] == pytest.approx(1.0, abs=1e-4)
    assert gain[14.0] == pytest.approx(0.5, abs=0.1)
    assert abs(gain[35.0]) < 0.02


@pytest.mark.parametrize("delay", [0, 1])
def test_command_inverse_undoes_interpolation_and_low_pass(delay):
    loop = plant(delay=delay)
    inverse = command_path_inverse(loop, 7)
    t = np.arange(0.0, 2.0, loop.path.t_position)
    desired = 0.2 * np.sin(2 * np.pi * 1.5 * np.clip(t - 0.3, 0, None)) ** 2
    rate = np.diff(desired, prepend=desired[0]) / loop.path.t_position
    signal = loop.cascade.k_v[0] * desired + loop.cascade.k_ff[0] * rate
    past = np.zeros(inverse.n_past)
    q_c: list[float] = []
    for k in range(140):
        start = (k + delay) * loop.steps_ipo
        q_c.append(inverse.wanted[0] @ signal[start : start + inverse.wanted.shape[1]] + inverse.past[0] @ past)
        past = np.append(past[1:], q_c[-1])
    commands_ = np.tile(np.array(q_c)[:, None], (1, 6))
    filtered = low_passed(interpolated(commands_, np.zeros(6), loop), np.zeros(6), loop.path.command_filter)[:, 0]
    # A linear interpolation over a cycle cannot be closer to a curve than its chord's sagitta, ẍ T²/8.
    sagitta = 0.1 * (2 * np.pi * 3.0) ** 2 * T**2 / 8
    assert np.max(np.abs(filtered - desired[: len(filtered)])) < sagitta


def test_command_inverse_is_exact_at_rest():
    inverse = command_path_inverse(plant(), 7)
    still = plant().cascade.k_v[:, None] * np.ones((6, inverse.wanted.shape[1]))
    total = np.sum(inverse.wanted * still, axis=1) + np.sum(inverse.past, axis=1)
    np.testing.assert_allclose(total, 1.0, atol=1e-12)


def off_postures(seed, count):
    """Desired postures, how far the joints are off, and the poses."""
    rng = np.random.default_rng(seed)
    q_d = ROBOT.home + rng.uniform(-0.2, 0.2, size=(count, 6))
    true = rng.normal(scale=5e-4, size=q_d.shape)
    fk = ROBOT.fk()
    return q_d, true, pose_errors([fk(q) for q in q_d], [fk(q - dq) for q, dq in zip(q_d, true, strict=True)])


def test_all_six_degrees_of_freedom_give_the_joint_errors_back():
    q_d, true, error = off_postures(0, 20)
    np.testing.assert_allclose(joint_errors(ROBOT, q_d, error, noise=1e-7), true, atol=2e-6)


def test_two_degrees_of_freedom_give_the_likeliest_joint_errors():
    """[L] 3.3: they must explain what was measured, and be closer to the truth than knowing nothing."""
    q_d, true, error = off_postures(1, 30)
    rows = [AXES.index("y"), AXES.index("z")]
    estimate = joint_errors(ROBOT, q_d, error[:, rows], axes=("y", "z"), prior=5e-4, noise=1e-6)
    data = ROBOT.pinocchio.createData()
    for q, dq, measured in zip(q_d, estimate, error[:, rows], strict=True):
        J = pin.computeFrameJacobian(ROBOT.pinocchio, data, q, ROBOT.tool_id, pin.LOCAL_WORLD_ALIGNED)[rows]
        np.testing.assert_allclose(J @ dq, measured, atol=1e-5)
    assert rms(estimate - true) < rms(true)


def test_unknown_axes_are_refused():
    with pytest.raises(InputError, match="expected errors"):
        joint_errors(ROBOT, np.zeros((3, 6)), np.zeros((3, 1)), axes=("w",))


def test_training_carries_over_to_another_motion():
    """Trained where learning got it right, used on a motion of other size and duration, as [G] 4.2.2 wants it."""
    loop, q_d, other = plant(), motion(), motion(amplitude=-0.15, duration=1.9)
    learned = commands(Inverse(loop), q_d)
    for chain, factor in ((None, 0.2), (loop.chain, 0.1)):
        trained = train([(q_d, learned)], T, chain=chain)
        assert off(loop, trained, other, 0) < factor * off(loop, PassThrough(T), other, 0)


def test_training_wants_matching_paths():
    fits, differs = (np.zeros((10, 6)), np.zeros((10, 6))), (np.zeros((10, 6)), np.zeros((9, 6)))
    for pairs, says in (([differs], "same shape"), ([], "at least one pair"), ([fits, differs], "same shape")):
        with pytest.raises(InputError, match=says):
            train(pairs, T)


def test_precorrection_is_the_equations_of_the_paper():
    """[G] (18)–(20) cycle by cycle on a motion of constant acceleration, where the smoothing is exact."""
    model = dataclasses.replace(nominal_model(), gears=None)
    own = model.controller
    k_p, k_d, k_1, k_2, k_i = own.k_p, own.k_d, own.k_1, own.k_2, own.k_i * T / own.t_cycle
    t = T * np.arange(60)
    q_d = ROBOT.home + 0.4 * t[:, None] ** 2 / 2
    feedforward = Inverse.of(model, ROBOT, None, delay=0, options=PRINTED)
    state = feedforward.init(q_d[0])
    for k in range(40):
        before = state
        q_c, state = feedforward.step(state, q_d[k : k + 10])
        if k < 10:
            continue
        qd, qdd = np.full(6, 0.4 * t[k]), np.full(6, 0.4)
        tau = model.inverse_dynamics(q_d[k], qd, qdd)[0]
        np.testing.assert_allclose(state.planned.tau, tau, rtol=1e-5, atol=1e-6)
        u = (state.planned.tau - before.planned.tau + before.planned.u) / (1 + k_i)
        dq = (u + k_d * (before.q_c[-1] - before.q_m) / T - k_1 * qd - k_2 * qdd) / (k_p + k_d / T)
        np.testing.assert_allclose(q_c, q_d[k] + dq, atol=1e-8)


@pytest.mark.parametrize("speed", [-0.0005, 0.0005, 0.4])
def test_friction_of_load_that_is_driven_counts_from_the_least_power_on(speed):
    model = dataclasses.replace(nominal_model(), gears=None)
    driven = model.with_effects([FittedEffect("load_direction_friction", 2, "tau_2", (0.05,))])
    q_d = ROBOT.home + np.array([0.0, speed, 0.0, 0.0, 0.0, 0.0]) * (T * np.arange(80))[:, None]
    torques = []
    for arm in (model, driven):
        feedforward = Inverse.of(arm, ROBOT, None, delay=0, options=PRINTED)
        state = feedforward.init(q_d[0])
        for k in range(60):
            _, state = feedforward.step(state, q_d[k : k + 10])
        torques.append(state.planned.tau[1])
    load = float(pin.computeGeneralizedGravity(ROBOT.pinocchio, ROBOT.pinocchio.createData(), q_d[59])[1])
    expected = 0.05 * abs(load) * np.sign(speed) if load * speed > 0.0 else 0.0
    assert torques[1] - torques[0] == pytest.approx(expected, rel=0.15, abs=1e-9)


@pytest.mark.parametrize("options", [PRINTED, AHEAD])
def test_a_short_horizon_goes_on_straight(options):
    """Where the path is a straight one anyway, rows that are missing at the horizon's end change nothing."""
    feedforward = Inverse.of(nominal_model(), ROBOT, None, delay=1, options=options)
    q_d = ROBOT.home + 0.2 * T * np.arange(60.0)[:, None]
    # Three rows that are left say how the path goes on.
    for missing in (1, feedforward.n_d - 3):
        whole = short = feedforward.init(q_d[0])
        for k in range(40):
            expected, whole = feedforward.step(whole, q_d[k : k + feedforward.n_d])
            command, short = feedforward.step(short, q_d[k : k + feedforward.n_d - missing])
            np.testing.assert_allclose(command, expected, atol=1e-10)


def test_models_without_controller_are_refused():
    for use in (Inverse.of, loop_model):
        with pytest.raises(InputError, match="no controller"):
            use(Model.nominal(ROBOT), ROBOT)


def test_gains_survive_the_way_through_the_papers_form():
    cascade = plant().cascade
    true = cascade.k_v, cascade.k_ff, cascade.k_p, cascade.k_i
    for gain, wanted in zip(cascade_gains(nominal_model().controller), true, strict=True):
        np.testing.assert_allclose(gain, wanted, rtol=1e-9)


# Linear closed loops: identified, predicted, inverted, also where the inverse would be unstable.

def first_order(pole: float, delay: int, n: int = 1, length: int = 40) -> LinearLoop:
    g = np.zeros((length + 1, n))
    g[delay:] = ((1 - pole) * pole ** np.arange(length + 1 - delay))[:, None]
    return LinearLoop(g / g.sum(axis=0), T)


def test_identification_finds_a_known_response():
    true = first_order(0.6, 2)
    rng = np.random.default_rng(1)
    t = np.arange(800) * T
    q_c = (0.3 * np.sin(2 * np.pi * 0.5 * t) + 0.05 * np.sin(2 * np.pi * 4 * t**1.2))[:, None]
    q = true.predict(q_c) + rng.normal(scale=1e-5, size=q_c.shape)
    fit = LinearLoop.identify(q_c, q, T, delay=2, prior=1e-4)
    t_new = np.arange(300) * T
    other = (0.2 * np.sin(2 * np.pi * 1.1 * t_new))[:, None]
    assert rms(fit.predict(other) - true.predict(other)) < 5e-4


def test_identification_refuses_a_joint_at_rest_and_short_motions():
    for count, says in ((100, "hardly moves"), (10, "more than")):
        with pytest.raises(InputError, match=says):
            LinearLoop.identify(np.zeros((count, 1)), np.zeros((count, 1)), T)


def test_linearised_loop_predicts_the_loop_without_friction():
    loop = plant(friction=0.0)
    q_d = motion(amplitude=0.01)
    linear = LinearLoop.of(loop, q_d[len(q_d) // 2])
    done = simulate(loop, q_d).q_a[:-1]
    moved = done - done[0]
    predicted = linear.predict(q_d) - q_d[0]
    assert rms(predicted - moved) < 0.02 * rms(moved)


def test_matrix_is_the_response_written_out():
    linear = first_order(0.5, 1)
    q_c = np.random.default_rng(0).normal(size=(30, 1))
    q_c[0] = 0.0
    np.testing.assert_allclose(linear.matrix(0, 30, 30) @ q_c[:, 0], linear.predict(q_c)[:, 0], atol=1e-12)


@pytest.mark.parametrize("zero", [0.5, 1.8])
def test_the_inverse_is_bounded_and_right_for_any_phase(zero):
    """A zero outside the unit circle (1.8) makes the causal inverse grow by 1.8 every cycle."""
    g = np.convolve(first_order(0.6, 1).g[:, 0], [1.0, -zero])[:41]
    linear = LinearLoop((g / g.sum())[:, None], T)
    t = np.arange(200) * T
    ramp = np.clip(t - 0.4, 0, 1.2) / 1.2
    q_d = (0.4 * eased(ramp))[:, None]
    q_c = commands(LinearInverse(linear, 30), q_d)
    assert np.max(np.abs(q_c)) < 1.0
    assert rms(linear.predict(q_c) - q_d) < 0.05 * rms(linear.predict(q_d) - q_d)


def test_it_takes_the_lag_off_the_arm():
    loop, q_d = plant(), motion()
    inverse = LinearInverse(LinearLoop.of(loop, ROBOT.home))
    assert off(loop, inverse, q_d, 0) < 0.3 * off(loop, PassThrough(T), q_d, 0)


# Motion and torque smoothed alike: they keep to each other whatever the frequency.

def seen(loop, q, tau, force=None):
    """Motion and torque in the middle of measurements ``(CYCLES, n)``; presliding as they say, or of a state."""
    measured = np.stack([q, tau, np.zeros_like(q)], axis=1)
    window = noted(Window.empty(loop.n), measured, loop.drives, loop.friction, np.zeros(loop.n), T)
    assert window.rows == CYCLES
    if force is not None:
        window.force[:] = force
    return Smoothed(*(values[0] for values in smoothed(window, loop.drives, T)))


AT = T * (np.arange(CYCLES) - CYCLES // 2)[:, None]


@pytest.mark.parametrize("frequency", [1.0, 4.0, 8.0])
def test_inertia_is_the_same_at_every_frequency(frequency):
    """The second derivative of a cubic through nine positions lacks a tenth at 4 Hz."""
    loop, omega = plant(elastic=False), 2.0 * np.pi * frequency
    q = 0.01 * np.cos(omega * AT) * np.ones(loop.n)
    middle = seen(loop, q, -loop.drives.rotor_inertia * omega**2 * q)
    np.testing.assert_allclose(middle.tau, loop.drives.rotor_inertia * middle.motor_a, rtol=0.01)
    np.testing.assert_allclose(middle.a, middle.motor_a)


def test_the_arm_lags_behind_its_gears():
    """Arm and motor swing at 2.5 Hz, with 30 kg m² behind each gear."""
    loop, omega, inertia = plant(), 2.0 * np.pi * 2.5, 30.0
    arm = 0.01 * np.cos(omega * AT) * np.ones(loop.n)
    motor = arm * (1.0 - inertia * omega**2 / loop.drives.stiffness)
    tau = -inertia * omega**2 * arm - loop.drives.rotor_inertia * omega**2 * motor
    lagging, rigid = seen(loop, motor, tau, 0.0), seen(plant(elastic=False), arm, tau, 0.0)
    np.testing.assert_allclose(lagging.a, rigid.a, rtol=2e-3)


def test_ripple_is_taken_out_behind_the_gain():
    """It acts on the motor: where more torque is read than acts, of the ripple too."""
    ripple = np.zeros((1, 3, 6))
    ripple[0, :, 1] = 20.0, 3.0, 4.0
    gain = np.full(6, 1.2)
    loop = plant(elastic=False).changed(ripple=ripple, gain=gain)
    q = 0.3 + 0.1 * AT * np.ones(loop.n)
    waves = np.zeros_like(q)
    waves[:, 1] = 3.0 * np.cos(20.0 * q[:, 1]) + 4.0 * np.sin(20.0 * q[:, 1])
    np.testing.assert_allclose(seen(loop, q, gain * (5.0 + waves)).tau, 5.0)


def test_a_hole_starts_the_window_anew():
    loop = plant()
    measured = np.zeros((CYCLES + 2, 3, loop.n))
    measured[3, 1, 2] = np.nan
    window = noted(Window.empty(loop.n), measured, loop.drives, loop.friction, np.zeros(loop.n), T)
    assert window.rows == CYCLES - 2
