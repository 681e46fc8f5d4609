"""The command's law recovers known controllers from commands and angles, and its inverse makes the arm follow."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from ideal_robot.arrays import Array
from ideal_robot.command.fit import Stretch, probabilities, tones, variances
from ideal_robot.command.law import PARTS, Column, CommandLaw, JointLaw, Rival, Shape, _weights, error_parts
from ideal_robot.command.motion import Motion
from ideal_robot.command.recorded import command_cycle, moving_at_start, update_instants
from ideal_robot.command.smoothing import SMOOTHINGS
from ideal_robot.command.words import beyond_cascade, described
from ideal_robot.errors import InputError
from ideal_robot.feedforward.command_inverse import CommandInverse
from ideal_robot.friction.laws import Arctan, PerJointFriction
from ideal_robot.identification.angles_alone import identify_arm, identify_from_commands
from ideal_robot.identification.command import identify_command, judged
from ideal_robot.loop.from_model import loop_model
from ideal_robot.loop.simulation import simulate
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from tests.sources import DATA, ROOT

Law = Callable[[Array, Array, Array], Array]
"""What a controller sees of the command beyond its position, of positions, speeds and torques ``(N, n)``."""
DT = 0.002
CYCLE = 0.004
EMPS = DATA / "emps"


def robot(tmp_path: Path) -> Robot:
    """An arm of two joints that swings in a plane."""
    link = ('<inertial><origin xyz="0.2 0 0"/><mass value="{m}"/><inertia ixx="0.05" iyy="0.05" izz="0.05" ixy="0" '
            'ixz="0" iyz="0"/></inertial>')
    joint = ('<joint name="{n}" type="revolute"><parent link="{p}"/><child link="{c}"/><origin xyz="{x} 0 0"/>'
             '<axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="6" effort="500"/></joint>')
    text = ('<robot name="two"><link name="base"/>'
            + "".join(f'<link name="{n}">{link.format(m=m)}</link>' for n, m in (("a", 6.0), ("b", 3.0)))
            + joint.format(n="j1", p="base", c="a", x=0) + joint.format(n="j2", p="a", c="b", x=0.5) + "</robot>")
    path = tmp_path / "two.urdf"
    path.write_text(text)
    return Robot.load(path)


def moved(seed: int, seconds: float = 16.0) -> tuple[Array, Array]:
    """A motion ``(N, 2)`` [rad] of sinusoids from rest to rest, every ``DT`` [s], and its times."""
    rng, t = np.random.default_rng(seed), DT * np.arange(round(seconds / DT))
    share = np.clip(np.minimum(t - 0.5, t[-1] - 0.5 - t) / 1.5, 0.0, 1.0)
    swell = (share**3 * (10 - 15 * share + 6 * share**2))[:, None]
    q = sum(rng.uniform(0.1, 0.4, 2) * np.sin(2 * np.pi * rng.uniform(0.15, 0.9, 2) * t[:, None]
                                              + rng.uniform(0, 6.28, 2)) for _ in range(3))
    return t, np.array([0.3, -0.5]) + swell * q


def high_passed(x: Array, reset: float) -> Array:
    a = np.exp(-DT / reset)
    return x - x[0] - lfilter([0.0, 1 - a], [1.0, -a], x - x[0], axis=0)


def recorded(arm: Robot, law: Law, *, late: float, seed: int, step: float = 1e-6,
             torque: bool = True) -> Recording:
    """The recording of an arm whose controller sees ``q + law(q, qd, tau)``, its commands late."""
    model = Model.nominal(arm)
    t, q = moved(seed)
    qd, qdd = (CubicSpline(t, q)(t, nu=k) for k in (1, 2))
    tau = model.inverse_dynamics(q, qd, qdd)
    seen = CubicSpline(t, q + law(q, qd, tau))
    rng = np.random.default_rng(seed + 100)
    columns = {"q_c": seen(np.minimum(t + late, t[-1])), "q": step * np.round(q / step)}
    if torque:
        columns["tau"] = tau + 0.005 * np.std(tau, axis=0) * rng.standard_normal(tau.shape)
    return Recording.from_arrays(t, **columns)


GAINS = np.array([18.0, 25.0])


@cache
def identified(law: Law, seed: int, late: float = 0.006, torque: bool = True) -> CommandLaw:
    """The law of a recording; several tests look at the same one."""
    with TemporaryDirectory() as folder:
        arm = robot(Path(folder))
        return identify_command([recorded(arm, law, late=late, seed=seed, torque=torque)], Model.nominal(arm),
                                torque=torque)


def cascade(q: Array, qd: Array, tau: Array) -> Array:
    """A P/PI cascade with a reset time of 60 ms."""
    return qd / GAINS + high_passed(tau, 0.06) / (GAINS * np.array([40.0, 10.0]))


def pd(q: Array, qd: Array, tau: Array) -> Array:
    """A PD controller that compensates nothing: it sags."""
    return tau / np.array([900.0, 300.0]) + 0.03 * qd


@cache
def two_links() -> Model:
    """The arm's model as a controller has it."""
    with TemporaryDirectory() as folder:
        return Model.nominal(robot(Path(folder)))


def impedance(q: Array, qd: Array, tau: Array) -> Array:
    """PD control that adds gravity and Coriolis torques; rates are of the last two readings, torques a cycle old."""
    model, still = two_links(), np.zeros_like(q)
    before = np.vstack([qd[:1], qd[:-1]])
    added = model.inverse_dynamics(q, qd, still) - model.friction.torque(qd)
    then = np.vstack([tau[1:], tau[-1:]])
    return (then - added) / np.array([900.0, 300.0]) + 0.03 * 0.5 * (qd + before)


@pytest.mark.parametrize(("law", "share"), [(pd, 0.0), (impedance, 1.0)])
def test_gains_of_a_servo_and_what_it_adds_of_the_bodies_torques_are_recovered(law: Law, share: float) -> None:
    for own, stiffness in zip(identified(law, 1).joints, (900.0, 300.0), strict=True):
        servo = own.servo
        assert servo is not None
        assert abs(servo.stiffness - stiffness) < max(3.0 * servo.stiffness_std, 0.02 * stiffness)
        assert servo.damping + servo.late * stiffness == pytest.approx((0.03 + 0.006) * stiffness, rel=0.03)
        assert abs(servo.gravity - share) < max(3.0 * servo.gravity_std, 0.03)
        assert abs(servo.coriolis - share) < max(3.0 * servo.coriolis_std, 0.03)


def test_a_cascade_with_an_integrator_is_no_servo_and_torques_are_needed_for_one() -> None:
    assert [own.servo for own in identified(cascade, 1).joints] == [None, None]
    assert [own.servo for own in identified(pd, 1, torque=False).joints] == [None, None]


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_a_cascade_s_delay_is_recovered_and_its_commands_are_predicted(seed: int) -> None:
    for own, gain in zip(identified(cascade, seed).joints, GAINS, strict=True):
        total = own.coefficient("velocity") + own.shape.a_1 + own.shape.late + own.shape.filter.delay * own.shape.time
        assert total == pytest.approx(1.0 / gain + 0.006, rel=0.05)
        assert own.residual < 5e-3 * own.deviation


# With seeds 2 and 3 a PID controller behind a lag of 1/k_v is found: its answer is the same, and its pole filters the
# noise of the torque, which is no part of the law's noise.
NOISY_TORQUE = (pytest.mark.slow, pytest.mark.xfail(strict=True, reason="a pole filters the torque's noise"))


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=NOISY_TORQUE) for seed in (2, 3))])
def test_a_cascade_is_named_with_its_reset_time(seed: int) -> None:
    for own in identified(cascade, seed).joints:
        assert own.shape.reset == pytest.approx(0.06, rel=0.25)
        assert "P/PI cascade" in described(own)


@pytest.mark.parametrize(("seed", "time"), [(1, 0.13), *(
    pytest.param(seed, time, marks=pytest.mark.slow) for seed in (2, 3) for time in (0.09, 0.2))])
def test_a_lag_before_a_cascade_is_recovered(tmp_path: Path, seed: int, time: float) -> None:
    """A lag and a position loop are alike in slow motion: each keeps its own time."""
    arm = robot(tmp_path)
    plain = recorded(arm, cascade, late=0.006, seed=seed)
    q_c = plain.joints("q_c")
    shown = Recording.from_arrays(plain.t, q_c=SMOOTHINGS["lag"].before(q_c, DT, time), q=plain.joints("q"),
                                  tau=plain.joints("tau"))
    for own, gain in zip(identify_command([shown], Model.nominal(arm), torque=True).joints, GAINS, strict=True):
        assert own.shape.smoothing == "lag"
        assert own.shape.time == pytest.approx(time, rel=0.1)
        assert own.coefficient("velocity") + own.shape.late == pytest.approx(1.0 / gain + 0.006, rel=0.1)
        assert own.residual < 5e-3 * own.deviation


@pytest.mark.parametrize("seed", [4, pytest.param(5, marks=pytest.mark.slow)])
def test_stiffness_of_an_arm_that_sags_is_recovered(seed: int) -> None:
    for own, stiffness in zip(identified(pd, seed, late=0.0).joints, (900.0, 300.0), strict=True):
        assert own.shape.reset is None or own.shape.reset > 2.0
        assert 1.0 / own.coefficient("torque") == pytest.approx(stiffness, rel=0.05)


@pytest.mark.parametrize(("controller", "torque"), [
    (cascade, True), pytest.param(pd, True, marks=pytest.mark.slow), (pd, False)])
def test_the_inverse_commands_what_the_controller_needs(tmp_path: Path, controller: Law, torque: bool) -> None:
    """On a motion that the law was not fitted to; and its expected error is that which is made."""
    arm = dataclasses.replace(robot(tmp_path), t_ipo=CYCLE)
    law = identified(controller, 1, torque=torque)
    model = dataclasses.replace(Model.nominal(arm), command=dataclasses.replace(law, t_cycle=CYCLE))
    other = recorded(arm, controller, late=0.006, seed=9)
    every = round(CYCLE / DT)
    q, q_c = moved(9)[1][::every], other.joints("q_c")[::every]
    inverse = CommandInverse(model, arm)
    commands = inverse.along(q)
    settled = slice(150, -100)
    plain, left = (np.sqrt(np.mean((x - q_c)[settled] ** 2)) for x in (q, commands))
    assert left < 0.03 * plain
    stepped = np.empty_like(q)
    state = inverse.init(q[0])
    ahead = np.vstack([q, np.tile(q[-1], (inverse.n_d, 1))])
    for k in range(600):
        stepped[k], state = inverse.step(state, ahead[k : k + inverse.n_d])
    assert np.max(np.abs(stepped[:600] - commands[:600])) < 0.02 * plain


@pytest.mark.parametrize(("controller", "torque"), [
    (cascade, True), (pd, False), pytest.param(pd, True, marks=pytest.mark.slow),
    pytest.param(cascade, False, marks=pytest.mark.slow)])
def test_the_error_of_the_plain_path_is_foretold(tmp_path: Path, controller: Law, torque: bool) -> None:
    arm = dataclasses.replace(robot(tmp_path), t_ipo=DT)
    law = identified(controller, 1, torque=torque)
    other = recorded(arm, controller, late=0.006, seed=9)
    q_c, q = (other.joints(name)[:4000] for name in ("q_c", "q"))
    foretold = CommandInverse(dataclasses.replace(Model.nominal(arm), command=law), arm).uncorrected(q_c)
    settled = slice(100, -100)
    measured, off = (np.sqrt(np.mean(x[settled] ** 2, axis=0)) for x in (q_c - q, q_c - q - foretold))
    assert np.all(off < 0.05 * measured)


@pytest.mark.parametrize("noise", [3e-6, 5e-5])
def test_the_noise_of_positions_is_expected_again(tmp_path: Path, noise: float) -> None:
    """White noise of the encoder: what a law leaves of measured positions is never below it."""
    arm = dataclasses.replace(robot(tmp_path), t_ipo=DT)
    recording = recorded(arm, cascade, late=0.006, seed=1, torque=False)
    rng = np.random.default_rng(7)
    columns = {name: values + noise * rng.standard_normal(len(values)) if name.startswith("q_") and name[2] != "c"
               else values for name, values in recording.columns.items()}
    law = identify_command([Recording(columns)], Model.nominal(arm), torque=False)
    inverse = CommandInverse(dataclasses.replace(Model.nominal(arm), command=law), arm)
    expected = np.sqrt(np.mean(inverse.expected(moved(9)[1][:4000]) ** 2, axis=0))
    assert np.all([0.9 * noise < own.noise < 1.1 * noise for own in law.joints])
    assert np.all(expected > 0.9 * noise)


def test_another_law_that_may_be_right_is_in_what_is_expected_where_the_two_go_apart(tmp_path: Path) -> None:
    """A law with another lag: beside the path by speed times the lags' difference, as often as it is right."""
    arm = dataclasses.replace(robot(tmp_path), t_ipo=DT)
    columns, covariance = (Column("velocity"),), np.zeros((1, 1))
    usual = JointLaw(Shape(late=0.006), columns, np.array([0.05]), covariance, np.zeros(PARTS))
    other = Rival(Shape(late=0.010), columns, np.array([0.052]), 0.25)
    q_d = moved(3)[1][:4000]
    expected = []
    for rivals in ((), (other,)):
        joint = dataclasses.replace(usual, rivals=rivals)
        law = CommandLaw((joint,) * 2, DT, np.full(2, 0.01), np.zeros(2), np.ones(2))
        model = dataclasses.replace(Model.nominal(arm), command=law)
        assert CommandLaw.from_dict(law.to_dict()).to_dict() == law.to_dict()
        expected.append(CommandInverse(model, arm).expected(q_d))
    assert np.all(expected[0] == 0.0)
    speed = np.abs(np.gradient(q_d, DT, axis=0))
    # Of what is commanded 4 ms earlier and 2 ms of velocity more, a lag of 50 ms lets slow motions through.
    assert np.sqrt(np.mean(expected[1] ** 2)) == pytest.approx(0.5 * 0.006 * np.sqrt(np.mean(speed**2)), rel=0.05)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_tones_of_a_motion_are_counted_and_tell_laws_apart(count: int) -> None:
    t = 0.01 * np.arange(3000)
    rng, frequencies = np.random.default_rng(count), 0.2 + 0.35 * np.arange(count)
    q = sum(rng.uniform(0.2, 1.0) / f * np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 6.0)) for f in frequencies)
    assert tones([Motion.of(np.asarray(q)[:, None], 0.01, np.array([0.01]))], 0) == count
    alike, twice = probabilities([2e-5, 2e-5], 2 * count), probabilities([2e-5, 1e-5, 8e-5], 2 * count)
    np.testing.assert_allclose(alike, 0.5)
    assert twice.sum() == pytest.approx(1.0)
    assert twice[0] / twice[1] == pytest.approx(0.25**count)
    assert twice[2] < twice[0] < twice[1]


def test_a_law_is_read_as_the_loop_that_answers_its_commands() -> None:
    """``q_c = q + T dq/dt`` a dead time early is a lag behind a dead time."""
    arm, lag, late = Robot.load("kr6"), 0.05, 0.024
    joint = JointLaw(Shape(late=late), (Column("velocity"),), np.array([lag]), np.zeros((1, 1)), np.zeros(6))
    law = CommandLaw((joint,) * 6, arm.t_ipo, np.full(6, 0.01), arm.home, np.ones(6), "none", None)
    model = dataclasses.replace(Model.nominal(arm), command=law)
    assert model.by_law
    g = CommandInverse(model, arm).response(arm.home, 40)
    assert g.sum(axis=0) == pytest.approx(1.0, abs=0.02)
    assert arm.t_ipo * (np.arange(40.0) @ g) / g.sum(axis=0) == pytest.approx(late + lag, abs=0.002)
    t = arm.t_ipo * (np.arange(40) + 0.5) - late
    expected = np.where(t > 0.0, 1.0 - np.exp(-np.maximum(t, 0.0) / lag), 0.0)
    # Rows resolve no corner: the response is smooth over two of them.
    np.testing.assert_allclose(np.cumsum(g, axis=0), np.tile(expected[:, None], 6), atol=0.1)


@pytest.mark.parametrize("row", [0.0, 0.3, 4.7, 8.999, 9.0])
def test_a_row_between_rows_is_the_cubic_splines(row: float) -> None:
    rows = np.random.default_rng(1).standard_normal(10)
    assert _weights(10, row) @ rows == pytest.approx(float(CubicSpline(np.arange(10.0), rows)(row)), abs=1e-12)


@pytest.mark.skipif(not EMPS.exists(), reason="the measured machine's recordings are not here")
@pytest.mark.slow
@pytest.mark.parametrize("torque", [True, False])
@pytest.mark.parametrize("which", ["estimation", "validation"])
def test_a_measured_machine_s_error_is_foretold(which: str, torque: bool) -> None:
    """Of both files from either, with and without its torque."""
    machine = Robot.load(EMPS / "emps.urdf")
    recordings = {name: Recording.read(EMPS / f"emps_{name}.parquet") for name in ("estimation", "validation")}
    columns = {name: x for name, x in recordings[which].columns.items() if torque or not name.startswith("tau")}
    found = identify_arm(Recording(columns), machine)
    law = found.model.command
    assert law is not None
    inverse = CommandInverse(found.model, dataclasses.replace(machine, t_ipo=law.t_cycle))
    for recording in recordings.values():
        desired = recording.joints("q_d")
        foretold, measured = (np.sqrt(np.mean(x**2)) for x in (inverse.uncorrected(desired),
                                                               desired - recording.joints("q")))
        assert foretold == pytest.approx(measured, rel=0.05)


def test_what_a_cascade_does_not_do_is_named() -> None:
    def joint(shape: Shape, **coefficients: float) -> JointLaw:
        names = [name.replace("_of_", "*q_") + ("^1" if "_of_" in name else "") for name in coefficients]
        return JointLaw(shape, tuple(Column.named(name) for name in names), np.array([*coefficients.values()]),
                        np.eye(len(names)), np.zeros(PARTS))

    joints = (joint(Shape(0.05), velocity=0.05, torque=1e-4),
              joint(Shape(0.05, late=0.004, a_1=0.03), velocity=0.01, torque=1e-4),
              joint(Shape(), velocity=0.02, torque=1e-3, gravity=-9e-4),
              joint(Shape(0.05, smoothing="lag", time=0.09), velocity=0.05, torque=1e-4, velocity_of_2=0.01))
    law = CommandLaw(joints, 0.004, np.ones(4), np.zeros(4), np.ones(4), "model")
    assert beyond_cascade(law) == (
        (2, "75 % of the velocity is fed forward"), (2, "commands 4 ms late"), (3, "no integrator"),
        (3, "90 % of gravity is compensated"), (4, "lag of 90 ms"), (4, "gains follow the posture of joint 2"))


def test_a_law_is_read_as_it_was_written(tmp_path: Path) -> None:
    arm = robot(tmp_path)
    model = identify_from_commands(recorded(arm, pd, late=0.01, seed=2, torque=False), arm).model
    assert model.command is not None
    again = Model.load(model.save(tmp_path / "model.json")).command
    assert again is not None
    assert again.to_dict() == model.command.to_dict()
    assert isinstance(again, CommandLaw)


def test_commands_of_a_slower_cycle_are_found_in_a_fast_log() -> None:
    t = 0.001 * np.arange(2000)
    slow = np.sin(0.008 * (np.arange(2000) // 8))[:, None]
    recording = Recording.from_arrays(t, q=slow, q_c=slow)
    assert command_cycle([recording], "q_c") == pytest.approx(0.008)
    assert np.all(np.diff(update_instants(t, slow)) == 8)
    assert command_cycle([Recording.from_arrays(t, q=slow, q_c=np.sin(t)[:, None])], "q_c") == pytest.approx(0.001)


def spoilt(recording: Recording, how: str) -> Recording:
    columns = dict(recording.columns)
    if how == "copied":
        columns |= {"q_c_1": columns["q_1"], "q_c_2": columns["q_2"]}
    elif how == "degrees":
        columns |= {name: np.degrees(columns[name]) for name in ("q_c_1", "q_c_2")}
    elif how == "exchanged":
        columns |= {"q_c_1": columns["q_c_2"], "q_c_2": columns["q_c_1"]}
    elif how == "another run":
        columns |= {f"q_c_{i + 1}": np.ascontiguousarray(moved(77)[1][:, i]) for i in range(2)}
    return Recording(columns)


@pytest.mark.parametrize("how", ["copied", "degrees", "exchanged", "another run"])
@pytest.mark.parametrize("seed", [1, 2])
def test_commands_that_tell_nothing_are_refused(tmp_path: Path, how: str, seed: int) -> None:
    arm = robot(tmp_path)
    with pytest.raises(InputError) as raised:
        identify_from_commands(spoilt(recorded(arm, cascade, late=0.006, seed=seed, torque=False), how), arm)
    assert str(raised.value.field).startswith("q_c")
    assert "\n" not in str(raised.value)


def faulty(recording: Recording, how: str) -> Recording:
    """The recording as a logger spoils it: what the pass that cleans recordings of torques mends."""
    columns = {name: np.array(values) for name, values in recording.columns.items()}
    where = np.random.default_rng(4).integers(500, len(columns["t"]) - 500, 3)
    if how == "wrapped":
        # A counter of one turn that begins a little above where the joint rests.
        columns |= {f"{kind}_{i + 1}": begin + (columns[f"{kind}_{i + 1}"] - begin) % (2 * np.pi)
                    for kind in ("q", "q_c") for i, begin in enumerate((0.5, -0.3))}
    elif how == "stamps":
        columns["t"][where] = columns["t"][where - 1]
    elif how == "spikes":
        columns["q_1"][where] += 1.0
        columns["q_c_2"][where + 1] -= 2.0
    elif how == "no numbers":
        columns["q_2"][where], columns["q_c_1"][where + 7] = np.nan, np.nan
    return Recording(columns)


@pytest.mark.parametrize("how", ["wrapped", "stamps", "spikes", "no numbers"])
def test_commands_and_angles_alone_are_cleaned_as_recordings_with_torques_are(tmp_path: Path, how: str) -> None:
    arm = dataclasses.replace(robot(tmp_path), q_min=np.full(2, -9.0), q_max=np.full(2, 9.0))
    recording = recorded(arm, pd, late=0.006, seed=1, torque=False)
    found = identify_from_commands(faulty(recording, how), arm)
    assert found.warnings
    for joint, whole in zip(found.model.command.joints, identified(pd, 1, torque=False).joints, strict=True):
        assert joint.residual < 2.0 * whole.residual + 1e-5
        assert joint.shape.late == pytest.approx(whole.shape.late, abs=2e-3)


@pytest.mark.parametrize("lacking", ["missing", "no numbers"])
def test_commands_that_one_joint_lacks_are_named(tmp_path: Path, lacking: str) -> None:
    arm = robot(tmp_path)
    columns = dict(recorded(arm, pd, late=0.006, seed=1, torque=False).columns)
    if lacking == "missing":
        del columns["q_c_2"]
    else:
        columns["q_c_2"] = np.full(len(columns["t"]), np.nan)
    with pytest.raises(InputError, match="q_c_2") as raised:
        identify_from_commands(Recording(columns), arm)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("cut", [1.5, 3.0, 7.7])
def test_a_log_that_starts_in_motion_is_refused_with_where_to_cut_it(tmp_path: Path, cut: float) -> None:
    arm = robot(tmp_path)
    first, second = (recorded(arm, cascade, late=0.006, seed=seed, torque=False).columns for seed in (1, 2))
    late = {name: values[round(cut / DT):] for name, values in first.items()}
    with pytest.raises(InputError, match="starts in motion") as raised:
        identify_from_commands(Recording(late), arm)
    assert "\n" not in str(raised.value)
    # Behind it another motion, from rest.
    both = {name: np.concatenate([values, second[name]]) for name, values in late.items()}
    both["t"] = DT * np.arange(len(both["t"]))
    with pytest.raises(InputError, match="where all joints rest") as raised:
        identify_from_commands(Recording(both), arm)
    at = float(str(raised.value).split("t = ")[1].split(" s")[0])
    assert DT * len(late["t"]) - 1.0 < at < DT * len(late["t"]) + 1.0
    cut_there = Recording({name: values[both["t"] >= at - 1e-9] for name, values in both.items()})
    assert identify_from_commands(cut_there, arm).model.command is not None


@pytest.mark.parametrize("rate", [30.0, 125.0, 1000.0])
@pytest.mark.parametrize("before", [0.0, 0.01, 0.3])
def test_an_arm_that_starts_from_rest_with_the_log_does_not_start_in_motion(rate: float, before: float) -> None:
    t = np.arange(0.0, 6.0, 1.0 / rate)
    moved = np.maximum(t - before, 0.0)
    q = np.stack([0.4 * np.minimum(moved / 0.3, 1.0) ** 2 * np.sin(moved), 0.2 * (1.0 - np.cos(3.0 * moved))], axis=1)
    q += 2e-5 * np.random.default_rng(1).standard_normal(q.shape)
    assert moving_at_start(t, q) is None
    after = t > 1.0
    assert moving_at_start(t[after], q[after]) is not None


@pytest.mark.parametrize("logged", ["handed over", "in force, finely"])
def test_the_cascade_is_judged_by_commands_as_they_were_logged(logged: str) -> None:
    """A set-point in force at the end of a cycle is the command of its beginning; a cycle beside, any law is better."""
    arm, model = Robot.load("kr6"), Model.load(ROOT / "scenes" / "models" / "kr6.json")
    loop, rng = loop_model(model, arm), np.random.default_rng(2)
    t = loop.t_ipo * np.arange(400.0)
    swell = np.clip(np.minimum(t, t[-1] - t) / 1.0, 0.0, 1.0)[:, None] ** 2
    q_c = arm.home + swell * sum(rng.uniform(0.03, 0.08, 6) * np.sin(2.0 * np.pi * f * t[:, None]
                                                                     + rng.uniform(0.0, 6.0, 6)) for f in (0.3, 0.7))
    made = simulate(loop, q_c)
    fine = loop.t_ipo if logged == "handed over" else loop.t_ipo / 6.0
    at = np.arange(0.0, t[-1], fine)
    told = CubicSpline(t, q_c)(at if logged == "handed over" else np.maximum(at - loop.t_ipo, 0.0))
    q = CubicSpline(made.t, made.q_m)(at)
    recording = Recording.from_arrays(at, q_c=told, q=q, tau=model.inverse_dynamics(q, 0.0 * q, 0.0 * q))
    # A law that leaves a tenth of a milliradian.
    joint = JointLaw(Shape(late=0.03), (Column("offset"), Column("velocity")), np.array([0.0, 0.05]), 1e-8 * np.eye(2),
                     np.full(PARTS, 1e-4**2 / PARTS), 0.02, 1e-4, "lag")
    law = CommandLaw((joint,) * 6, fine, np.full(6, 0.02), arm.home, np.ones(6))
    found = judged(law, [recording], model, arm)
    assert found.cascade is not None
    assert np.all(found.cascade < 1e-4)
    assert not found.leads


@pytest.mark.parametrize(("cycle", "steepness", "shape"), [
    (1e-3, 300.0, Shape()), (1e-3, 30.0, Shape(reset=0.08)), (1e-3, 300.0, Shape(smoothing="second_order", time=0.03)),
    (4e-3, 300.0, Shape())])
def test_no_command_leaps_where_friction_turns_however_short_the_cycle(tmp_path: Path, cycle: float, steepness: float,
                                                                       shape: Shape) -> None:
    arm = dataclasses.replace(robot(tmp_path), t_ipo=cycle, a_max=np.full(2, 10.0))
    friction = PerJointFriction([Arctan(np.array([[0.1], [0.2], [0.6]]), np.array([[steepness]]))] * 2)
    own = JointLaw(shape, (Column("velocity"), Column("torque")), np.array([0.05, 4e-4]), np.zeros((2, 2)),
                   np.zeros(PARTS))
    law = CommandLaw((own, own), cycle, np.full(2, 0.02), np.zeros(2), np.ones(2), "model")
    inverse = CommandInverse(dataclasses.replace(Model.nominal(arm), friction=friction, command=law), arm)
    t = np.arange(0.0, 5.0, cycle)[:, None]
    swell = np.sin(np.pi * np.clip((t - 0.4) / 4.2, 0.0, 1.0)) ** 6
    q_d = 0.4 * swell * np.sin(2 * np.pi * np.array([0.5, 0.8]) * t + np.array([0.3, 1.0]))
    q_c = inverse.along(q_d)
    # Two derivatives of what is commanded beyond the path; a leap of one N m alone would be 4e-4 / cycle**2.
    bend = np.abs(np.diff(q_c - q_d, 2, axis=0)) / cycle**2
    assert bend.max() < 0.8 * arm.a_max.max()
    # At rest rounding of the velocity has no direction.
    assert np.abs(np.diff((q_c - q_d)[: round(0.2 / cycle)], 4, axis=0)).max() < 1e-6
    state, stepped = inverse.init(q_d[0]), []
    for k in range(round(0.7 / cycle)):
        command, state = inverse.step(state, q_d[k : k + inverse.n_d])
        stepped.append(command)
    np.testing.assert_allclose(stepped, q_c[: len(stepped)], atol=1e-5)


@pytest.mark.parametrize("size", [0.0, 1e-5])
def test_variances_are_as_large_as_the_squares_of_what_is_missed(size: float) -> None:
    """Also where nothing is missed: a joint that a path leaves where it is ended the identification."""
    t = np.arange(0.0, 4.0, 0.012)
    motion = Motion.of(0.3 * np.sin(2.0 * t)[:, None], 0.012, np.array([0.01]))
    rows = np.arange(len(t))
    stretch = Stretch(motion, motion, (motion, motion), motion.q, motion.q, np.array([1e-5]), rows)
    missed = size * np.random.default_rng(1).standard_normal(len(rows))
    found = variances([missed], [stretch], 0)
    assert found.shape == (PARTS,)
    assert np.all(found >= 0.0)
    assert np.mean(error_parts(motion)[:, :, 0] @ found) == pytest.approx(np.mean(missed**2), rel=0.05)
