"""The controller's gains from a simulated cascade, and impulse responses of the closed loop."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.identification.cascade_fit import _Channel, _JointCascade, commands_in_force, fit_controller
from ideal_robot.identification.controller import identify_controller
from ideal_robot.identification.linear_loop_fit import identify_linear_loop
from ideal_robot.loop.from_model import cascade_gains
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from sim.arm.arm import SimulatedArm
from sim.arm.world import World
from tests.sources import DATA

EMPS = DATA / "emps" / "emps_estimation.parquet"

K_P, K_D, K_I = 5000.0, 200.0, 0.2
T = 0.012


def closed_loop(integrator: bool, rng: np.random.Generator, noise: float = 0.5) -> Recording:
    """One axis under the controller of [G] (16), (17), at 0.5 ms, with inertia and friction, logged every 2 ms."""
    dt, inertia = 0.0005, 8.0
    t = np.arange(0.0, 12.0, dt)
    q_d = 0.4 * np.sin(2 * np.pi * 0.31 * t) ** 3 + 0.1 * np.sin(2 * np.pi * 1.7 * t) * np.sin(np.pi * t / 12.0)
    q = v = integral = direction = 0.0
    rows = np.empty((len(t), 2))
    before = q_d[0] - q
    for k in range(len(t)):
        e = q_d[k] - q
        u = K_P * e + K_D * (e - before) / dt - 30.0 * v
        before = e
        integral += integrator * K_I / T * u * dt
        tau = u + integral
        rows[k] = q, tau
        direction += (np.sign(v) - direction) * (1.0 - np.exp(-abs(v) * dt / 2e-4))
        v += dt * (tau - 12.0 * direction - 6.0 * v) / inertia
        q += dt * v
    every = 4
    tau = np.convolve(rows[:, 1], np.ones(every) / every)[: len(t)] + noise * rng.normal(size=len(t))
    return Recording.from_arrays(t[::every], q_c=q_d[::every, None], q=rows[::every, :1], tau=tau[::every, None])


def test_gains_as_in_the_paper() -> None:
    """PD gains from a recording without integrator, the integral gain by simulation from one with it."""
    rng = np.random.default_rng(2)
    fit = identify_controller([closed_loop(True, rng)], T, without_integrator=[closed_loop(False, rng)])
    assert fit.model.k_p[0] == pytest.approx(K_P, rel=0.05)
    assert fit.model.k_d[0] == pytest.approx(K_D, rel=0.05)
    assert fit.model.k_i[0] == pytest.approx(K_I, rel=0.2)
    assert fit.error_percent[0] < 10.0
    assert fit.simulated.shape == fit.drifting.shape == fit.measured.shape


def test_one_step_estimate_drifts_more_than_the_simulated_one() -> None:
    rng = np.random.default_rng(3)
    fit = identify_controller([closed_loop(True, rng, noise=5.0)], T, without_integrator=[closed_loop(False, rng)])
    error = np.linalg.norm(fit.simulated - fit.measured)
    assert np.linalg.norm(fit.drifting - fit.measured) > error


def test_gains_scatter_as_far_as_their_standard_deviations_say() -> None:
    """k_p and k_I come from the same data and fall and rise together; k_1 follows the delay of the command."""
    models = [identify_controller([closed_loop(True, np.random.default_rng(seed), noise=5.0)], T).model
              for seed in range(8)]
    for name in ("k_p", "k_d", "k_1", "k_2", "k_i"):
        scatter = np.std([getattr(model, name)[0] for model in models], ddof=1)
        std = np.mean([model.std[name][0] for model in models])
        # The scatter of eight is itself uncertain by a quarter.
        assert 0.5 < std / scatter < 2.0


def test_four_recordings_tell_the_gains_twice_as_well() -> None:
    recording = closed_loop(True, np.random.default_rng(4))
    single, four = (identify_controller([recording] * count, T).model.std for count in (1, 4))
    for name, std in single.items():
        assert four[name][0] == pytest.approx(0.5 * std[0], rel=0.02)


def test_commands_are_needed() -> None:
    recording = closed_loop(True, np.random.default_rng(0))
    bare = Recording({k: v for k, v in recording.columns.items() if k != "q_c_1"})
    with pytest.raises(InputError, match="q_d_1"):
        identify_controller([bare], T)
    with pytest.raises(InputError, match="divide the cycle"):
        identify_controller([recording], 0.005)


def response(degree: int, rng: np.random.Generator) -> tuple[Recording, np.ndarray]:
    t = np.arange(1500) * T
    q_d = 0.4 * np.sin(np.pi * t) + 0.1 * np.sin(4.2 * np.pi * t) + 0.02 * np.sin(10.6 * np.pi * t)
    g = np.zeros(26)
    g[degree:] = 0.5 ** np.arange(26 - degree)
    g /= g.sum()
    q = np.convolve(q_d, g)[: len(t)] + 1e-5 * rng.normal(size=len(t))
    return Recording.from_arrays(t, q_c=q_d[:, None], q=q[:, None]), g


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_impulse_response_and_relative_degree(degree: int) -> None:
    recording, g = response(degree, np.random.default_rng(degree))
    fit = identify_linear_loop([recording], T)
    assert fit.relative_degree == (degree,)
    np.testing.assert_allclose(fit.loop.g[:, 0], g, atol=0.06)
    assert fit.error_percent[0] < 0.1
    predicted = fit.loop.predict(recording.joints("q_c"))
    np.testing.assert_allclose(predicted[30:], recording.joints("q")[30:], atol=2e-4)


def test_recordings_shorter_than_the_response_tell_nothing_of_it() -> None:
    recording, _ = response(1, np.random.default_rng(1))
    short = Recording({name: values[:20] for name, values in recording.columns.items()})
    np.testing.assert_array_equal(identify_linear_loop([short, recording], T).loop.g,
                                  identify_linear_loop([recording], T).loop.g)
    with pytest.raises(InputError, match="too short"):
        identify_linear_loop([short], T)


# The cascade found from commands, motor angles and torques of a simulated arm.

ROBOT = Robot.load("kr15")


def recorded(joint: int, seconds: float = 9.0, **keys: Any) -> Recording:
    """One joint of the default world's arm through slow and quick sinusoids; the columns of that joint only."""
    world = dataclasses.replace(World.default("kr15"), **keys)
    t = world.t_ipo * np.arange(round(seconds / world.t_ipo))
    fade = np.clip(np.minimum(t, seconds - t), 0, 1) ** 2
    wave = 0.25 * np.sin(1.5 * t) + 0.08 * np.sin(4.1 * t + 1) + 0.02 * np.sin(12 * t + 2)
    with SimulatedArm(ROBOT, world, np.random.default_rng(4)) as arm:
        for k in range(len(t)):
            q_c = ROBOT.home.copy()
            q_c[joint] += fade[k] * wave[k]
            arm.cycle(q_c)
        whole = arm.recording()
    columns = {"t": whole.t.copy()}
    for prefix in ("q_c", "q", "tau"):
        columns[f"{prefix}_1"] = whole.columns[f"{prefix}_{joint + 1}"].copy()
    return Recording(columns, whole.meta)


@pytest.mark.parametrize("joint", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_finds_the_cascade_behind_encoder_steps_and_current_noise(joint):
    world = World.default("kr15")
    fit = fit_controller(recorded(joint), ROBOT)
    true = {name: world.per_joint(name, 6)[joint]
            for name in ("position_gain", "velocity_feedforward", "velocity_gain", "integral_time")}
    k_v, k_ff, k_p, k_i = (float(values[0]) for values in cascade_gains(fit.controller))
    # What is left of the torque is the noise of the current below 12 Hz. The log has the mean current since the sample
    # before; taken for the present one, a softer position loop with a quicker integrator comes out (0.8 and 1.3 times).
    assert fit.error_percent[0] < 3.0
    assert k_p == pytest.approx(true["velocity_gain"], rel=0.03)
    assert k_v == pytest.approx(true["position_gain"], rel=0.05)
    assert k_ff == pytest.approx(true["velocity_feedforward"], abs=0.01)
    assert k_p / k_i == pytest.approx(true["integral_time"], rel=0.05)


@pytest.mark.slow
def test_friction_that_the_drive_compensates_is_found_beside_the_cascade() -> None:
    """Half of the dry friction, in the direction of the command; a drive that does not has none."""
    world = World.default("kr15")
    fit = fit_controller(recorded(1, friction_compensation=0.5), ROBOT)
    assert fit.controller.compensation is not None
    assert fit.controller.compensation[0] == pytest.approx(0.5 * world.per_joint("coulomb", 6)[1], rel=0.15)
    assert cascade_gains(fit.controller)[2][0] == pytest.approx(world.per_joint("velocity_gain", 6)[1], rel=0.1)
    assert fit_controller(recorded(1), ROBOT).controller.compensation is None


def all_joints(world: World) -> Recording:
    """Twelve seconds in which all joints move, so that the inertia of the first two changes by tens of per cent."""
    t = world.t_ipo * np.arange(round(12.0 / world.t_ipo))
    fade = np.clip(np.minimum(t, 12.0 - t), 0, 1) ** 2
    rates = np.array([0.9, 0.7, 1.1, 2.1, 1.7, 2.9])
    wave = 0.35 * np.sin(np.outer(t, rates)) + 0.04 * np.sin(np.outer(t, 4.3 * rates) + 1.0)
    with SimulatedArm(ROBOT, world, np.random.default_rng(4)) as arm:
        for row in ROBOT.home + fade[:, None] * wave:
            arm.cycle(row)
        return arm.recording()


@pytest.mark.slow
def test_gains_that_follow_the_inertia_are_found_beside_the_cascade() -> None:
    """Of the first two joints, whose inertia changes most."""
    whole = all_joints(dataclasses.replace(World.default("kr15"), gain_schedule=0.6))
    with_inertia, without = (fit_controller(whole, ROBOT, rotors) for rotors in (ROBOT.rotor_inertia, None))
    assert with_inertia.controller.schedule == pytest.approx(0.6, abs=0.15)
    assert with_inertia.controller.compensation is None
    assert np.all(with_inertia.error_percent[:2] < 0.5 * without.error_percent[:2])


@pytest.mark.slow
def test_impedance_control_that_compensates_bodies_is_found() -> None:
    """Without an integrator, and with gravity and Coriolis torques of the data sheet."""
    world = dataclasses.replace(World.default("kr15"), controller="impedance")
    fit = fit_controller(all_joints(world), ROBOT, ROBOT.rotor_inertia)
    assert fit.controller.bodies is not None
    np.testing.assert_allclose(fit.controller.bodies[:3], 1.0, atol=0.05)
    k_v, _, k_p, k_i = cascade_gains(fit.controller)
    np.testing.assert_allclose(k_v, world.per_joint("position_gain", 6), rtol=0.1)
    np.testing.assert_allclose(k_p, world.per_joint("velocity_gain", 6), rtol=0.1)
    np.testing.assert_array_equal(k_i, 0.0)


@pytest.mark.slow
def test_pid_control_and_how_its_rates_lag_are_found() -> None:
    """The integrator gets the position alone, and the command's rate passes a lag of 10 ms."""
    world = dataclasses.replace(World.default("kr15"), controller="pid")
    fit = fit_controller(all_joints(world), ROBOT, ROBOT.rotor_inertia)
    assert fit.controller.integrated == 0.0
    assert fit.controller.rate_filter == pytest.approx(0.01, rel=0.5)
    k_v, k_ff, k_p, _ = cascade_gains(fit.controller)
    np.testing.assert_allclose(k_v[:3], world.per_joint("position_gain", 6)[:3], rtol=0.1)
    np.testing.assert_allclose(k_ff, 1.0, atol=0.05)
    np.testing.assert_allclose(k_p[:3], world.per_joint("velocity_gain", 6)[:3], rtol=0.1)
    assert np.all(fit.error_percent < 5.0)


@pytest.mark.slow
def test_inverse_dynamics_is_found_with_what_its_bodies_are_too_heavy_by() -> None:
    """Accelerations are asked for, and a mass matrix makes torques of them, 10 % too heavy."""
    world = dataclasses.replace(World.default("kr15"), controller="inverse_dynamics")
    fit = fit_controller(all_joints(world), ROBOT, ROBOT.rotor_inertia)
    assert fit.controller.coupled
    assert fit.controller.bodies is not None
    np.testing.assert_allclose(fit.controller.bodies[:3], 1.1, atol=0.05)
    # 1.4 K_v of velocities and K_v² of positions, by 1.1 J_0: the ratio is K_v / 1.4.
    k_v, _, k_p, k_i = cascade_gains(fit.controller)
    stiff = 1.1 * world.per_joint("position_gain", 6) ** 2 * fit.controller.scheduled_at
    np.testing.assert_allclose((k_v * k_p)[:3], stiff[:3], rtol=0.15)
    np.testing.assert_array_equal(k_i, 0.0)
    assert np.all(fit.error_percent < 5.0)


@pytest.mark.slow
def test_torques_that_are_logged_as_they_are_tell_the_same_gains() -> None:
    """A cascade of the module's own equation before a sine: present torques, and means since the last sample."""
    t, cycle, every = 0.002 * np.arange(6000), 0.002, 4
    q_c = 0.3 * np.sin(2.0 * t) + 0.05 * np.sin(9.0 * t + 1.0)
    q = np.interp(t - 0.012, t, q_c) + 2e-3 * np.sin(5.0 * t)
    true = k_v, k_ff, k_p, k_i = 18.0, 0.92, 500.0, 9000.0
    for averaged in (False, True):
        blank = _JointCascade(q_c, q, np.zeros(len(t)), cycle, cycle / every, averaged)
        blank._smoothed = np.asarray  # type: ignore[method-assign]
        tau = blank.columns(np.array([0.002, 0.001])) @ np.outer([k_p, k_i], [k_v, k_ff, 1.0]).ravel()
        recording = Recording.from_arrays(t, q_c=q_c[:, None], q=q[:, None], tau=tau[:, None])
        gains = [float(values[0]) for values in cascade_gains(fit_controller(recording, ROBOT).controller)]
        np.testing.assert_allclose(gains, true, rtol=0.04)


@pytest.mark.parametrize("named", [True, False])
def test_set_points_that_are_logged_finely_are_in_force_whoever_names_the_cycle(named: bool) -> None:
    data = ROBOT.data if named else {name: table for name, table in ROBOT.data.items() if name != "controller"}
    arm, t = dataclasses.replace(ROBOT, data=data), ROBOT.t_position * np.arange(500)
    q_c = np.sin(3.0 * t)[:, None]
    np.testing.assert_array_equal(commands_in_force(Recording.from_arrays(t, q_c=q_c, q=q_c), arm), q_c)


@pytest.mark.parametrize("cycles", [2, 4, 6])
def test_gains_are_found_from_a_log_of_commands_as_they_were_handed_over(cycles: int) -> None:
    """At the interpolation cycle, several of the position loop's: set points in force are lines a cycle later."""
    fine, step = ROBOT.t_position, cycles * ROBOT.t_position
    arm = dataclasses.replace(ROBOT, t_ipo=step)
    t = fine * np.arange(5400 // cycles * cycles + 1)
    handed = 0.3 * np.sin(2.0 * t) + 0.05 * np.sin(9.0 * t + 1.0) + 0.01 * np.sin(21.0 * t)
    in_force = np.interp(t - step, t[::cycles], handed[::cycles])
    q = np.interp(t - 0.012, t, handed) + 2e-3 * np.sin(5.0 * t)
    k_v, k_ff, k_p, k_i = 18.0, 0.92, 500.0, 9000.0
    blank = _JointCascade(in_force, q, np.zeros(len(t)), fine, ROBOT.t_velocity)
    blank._smoothed = np.asarray  # type: ignore[method-assign]
    tau = blank.columns(np.array([0.002, 0.001])) @ np.outer([k_p, k_i], [k_v, k_ff, 1.0]).ravel()
    # A log without noise tells channels apart by the spline between its rows.
    tau += 0.01 * np.std(tau) * np.random.default_rng(cycles).standard_normal(len(tau))
    recording = Recording.from_arrays(t[::cycles], q_c=handed[::cycles, None], q=q[::cycles, None],
                                      tau=tau[::cycles, None])
    np.testing.assert_allclose(commands_in_force(recording, arm)[:, 0], in_force, atol=1e-12)
    fit = fit_controller(recording, arm)
    found = [float(values[0]) for values in cascade_gains(fit.controller)]
    # With so slow a motion the position's and the integral's gain are told by their product.
    np.testing.assert_allclose([*found[1:3], found[0] * found[3]], [k_ff, k_p, k_v * k_i], rtol=0.06)
    assert fit.controller.delay < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.02, 0.0437, 0.1])
def test_commands_that_reach_the_cascade_late_are_told_from_its_feedforward(late: float) -> None:
    """A cascade of the module's own equation before a sine: lateness and gains come out, not a low-pass for both."""
    t, cycle = 0.002 * np.arange(2500), 0.002
    q_c = 0.3 * np.sin(2.0 * t) + 0.05 * np.sin(9.0 * t + 1.0) + 0.01 * np.sin(21.0 * t)
    q = np.interp(t - late - 0.012, t, q_c) + 2e-3 * np.sin(5.0 * t)
    k_v, k_ff, k_p, k_i = 18.0, 0.92, 500.0, 9000.0
    blank = _JointCascade(q_c, q, np.zeros(len(t)), cycle, 0.0005)
    blank._smoothed = np.asarray  # type: ignore[method-assign]
    tau = blank.columns(np.array([0.002, 0.001]), _Channel(late=late)) @ np.outer([k_p, k_i], [k_v, k_ff, 1.0]).ravel()
    recording = Recording.from_arrays(t, q_c=q_c[:, None], q=q[:, None], tau=tau[:, None])
    fit = fit_controller(recording, ROBOT)
    found = [float(values[0]) for values in cascade_gains(fit.controller)]
    # So short a low-pass delays, and one joint's motion does not tell which of the two it is.
    delayed = fit.controller.delay + fit.controller.filter_order * fit.controller.filter_time[0]
    assert fit.controller.delay > 0.75 * late
    assert delayed == pytest.approx(late + 0.004, abs=2.5e-3)
    assert found[1] == pytest.approx(k_ff, abs=0.05)
    # A low-pass alone has no feedforward, and leaves several per cent of the torque.
    assert fit.error_percent[0] < 1.0


def test_refuses_slow_sampling_and_joints_at_rest():
    recording = recorded(3, 3.0)
    slow = Recording({name: values[::12].copy() for name, values in recording.columns.items()})
    with pytest.raises(InputError, match=r"samples every 20\.8 ms"):
        fit_controller(slow, ROBOT)
    still = Recording({name: (values if name == "t" else np.zeros_like(values))
                       for name, values in recording.columns.items()})
    with pytest.raises(InputError, match="hardly moves"):
        fit_controller(still, ROBOT)


@pytest.mark.parametrize("off", [2e-4, -2e-4])
def test_a_logged_cycle_that_is_no_whole_number_of_the_controllers_is_read(off: float) -> None:
    """By parts in ten thousand, over minutes, the steps within the cycles come to one more or less than the rows."""
    t = np.arange(12_000)
    q_c, cycle = 0.1 * np.sin(2e-3 * t), 0.001 * (1.0 + off)
    joint = _JointCascade(q_c, q_c, np.cos(2e-3 * t), cycle, 0.0005)
    assert joint.columns(np.array([0.002, 0.001])).shape == (len(joint.tau), 6)


@pytest.mark.skipif(not EMPS.exists(), reason="measured data (../shared/data/emps) are not there")
def test_the_published_gains_of_a_measured_cascade_without_integrator_are_found() -> None:
    """EMPS: position gain 160.18 1/s, velocity gain 243.45 V/(m/s) at 35.15 N/V, no integrator; commands are q_d."""
    recording = Recording.read(EMPS)
    commanded = Recording({**recording.columns, "q_c_1": recording.columns["q_d_1"]}, recording.meta, "emps")
    fit = fit_controller(commanded, Robot.load(EMPS.parent / "emps.urdf"))
    k_v, _, k_p, k_i = (float(values[0]) for values in cascade_gains(fit.controller))
    assert fit.error_percent[0] < 1.0
    assert k_v == pytest.approx(160.18, rel=0.02)
    assert k_p == pytest.approx(243.45 * 35.15, rel=0.02)
    assert k_i < 0.01 * k_p * k_v


def without(recording: Recording, rows: slice | np.ndarray) -> Recording:
    return Recording({name: np.delete(values, rows) for name, values in recording.columns.items()}, recording.meta)


@pytest.mark.parametrize("lost", [
    *(pytest.param(lost, marks=pytest.mark.slow) for lost in (2001, slice(1500, 2700))), np.arange(40, 4500, 97)])
def test_lost_rows_and_pauses_leave_the_closed_loop_what_it_is(lost: int | slice | np.ndarray) -> None:
    """Counted by rows, all that follows a lost one belongs to other instants: gains changed by a third and more."""
    whole = recorded(1)
    cut = without(whole, lost)
    expected, fitted = (np.array(cascade_gains(fit_controller(run, ROBOT).controller))[:, 0] for run in (whole, cut))
    np.testing.assert_allclose(fitted, expected, rtol=0.05)
    expected, fitted = (identify_controller([run], T).model.k_p for run in (whole, cut))
    np.testing.assert_allclose(fitted, expected, rtol=0.1)
    expected, fitted = (identify_linear_loop([run], T).loop.predict(whole.joints("q_c")[::6]) for run in (whole, cut))
    np.testing.assert_allclose(fitted, expected, atol=2e-4)


def test_of_stretches_that_are_too_short_nothing_is_told() -> None:
    torn = without(recorded(1, 3.0), np.arange(1500) % 100 < 20)
    for identify in (lambda: identify_linear_loop([torn], T), lambda: fit_controller(torn, ROBOT)):
        with pytest.raises(InputError, match="without a gap"):
            identify()


@pytest.mark.parametrize(("column", "says"), [("q_c_1", "q_c_1: never changes"), ("tau_1", "tau_1: never changes")])
def test_what_never_changes_tells_no_controller(column: str, says: str) -> None:
    recording = closed_loop(True, np.random.default_rng(0))
    dead = Recording({**recording.columns, column: np.full(len(recording.t), 5.0)})
    for identify in (lambda: identify_controller([dead], T), lambda: fit_controller(dead, ROBOT)):
        with pytest.raises(InputError, match=says):
            identify()


def test_a_measured_position_is_no_command() -> None:
    """Whatever the torque, a controller without an error to act on needs a gain without bound."""
    recording = closed_loop(True, np.random.default_rng(0))
    copied = Recording({**recording.columns, "q_c_1": np.round(recording.columns["q_1"], 7)})
    for identify in (lambda: identify_controller([copied], T), lambda: fit_controller(copied, ROBOT),
                     lambda: identify_linear_loop([copied], T)):
        with pytest.raises(InputError, match="q_c_1: is q_1 itself"):
            identify()
