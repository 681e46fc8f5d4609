"""Values that cannot be are found, named and left out or refused; a valid recording comes back bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from ideal_robot.errors import InputError
from ideal_robot.identification.checks import checked
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.channels import channel_findings, dead_joints, filtered_above, lattice
from ideal_robot.signals.plausible import plausible
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.sampling import regular_stamps, sampling_instants
from tests.sources import DATA


def recording(seed: int = 1, dt: float = 0.004, count: int = 3000) -> Recording:
    rng = np.random.default_rng(seed)
    t = dt * np.arange(count)
    q = np.column_stack([np.sin(1.3 * t), 0.4 * np.cos(2.1 * t)])
    tau = 40.0 * np.sign(np.cos(1.3 * t))[:, None] + 30.0 * q + rng.normal(size=q.shape)
    return Recording.from_arrays(t, q=q, tau=tau)


def check(one: Recording) -> tuple[Recording, list[str]]:
    return plausible(one, ["q_1", "q_2"], ["tau_1", "tau_2"])


def changed(name: str, index: object, value: object) -> Recording:
    columns = {key: np.array(values) for key, values in recording().columns.items()}
    columns[name][index] = value  # type: ignore[index]
    return Recording(columns)


@given(st.integers(0, 10_000), st.sampled_from([0.001, 0.004, 0.012]), st.integers(30, 800), st.floats(0.0, 1.0))
def test_a_valid_recording_comes_back_as_it_is(seed: int, dt: float, count: int, jitter: float) -> None:
    """Reversals of friction, steps of the command, rest and jittering stamps are nothing to complain of."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(dt * (1.0 + 0.4 * jitter * rng.uniform(-1, 1, count)))
    speed = np.repeat(rng.uniform(-6, 6, count // 10 + 1) * rng.integers(0, 2, count // 10 + 1), 10)[:count]
    q = np.cumsum(speed * np.diff(t, prepend=t[0]))
    tau = rng.uniform(1, 100) * np.sign(speed) + rng.normal(size=count)
    valid = Recording.from_arrays(t, q=q[:, None], tau=tau[:, None])
    same, warnings = plausible(valid, ["q_1"], ["tau_1"])
    assert same is valid
    assert warnings == []


@pytest.mark.parametrize(("name", "value"), [("tau_1", 1e6), ("tau_2", -1e4), ("q_1", 0.5), ("q_2", 3.0)])
def test_a_spike_is_left_out_and_named(name: str, value: float) -> None:
    good = recording()
    spoilt = changed(name, 1500, good.columns[name][1500] + value)
    clean, warnings = check(spoilt)
    assert any("spike" in warning and name in warning for warning in warnings)
    assert len(clean.t) == len(good.t) - 1
    assert 1500 * 0.004 not in clean.t


def test_a_few_samples_that_are_no_numbers_are_left_out_and_many_refused() -> None:
    clean, warnings = check(changed("tau_1", slice(100, 110), np.nan))
    assert len(clean.t) == 2990
    assert "not-a-number" in warnings[0]
    with pytest.raises(InputError, match="not numbers") as refused:
        check(changed("tau_2", slice(0, 900), np.inf))
    assert refused.value.field == "tau_2"


@pytest.mark.parametrize(("change", "says"), [
    (lambda t: np.where(t > 6.0, t - 5.0, t), "does not increase at sample 1501"),
    (lambda t: np.where(t > 6.0, t + 3600.0, t), "jumps"),
    (lambda t: np.where(t > 6.0, t + 172_800.0, t), "jumps"), (lambda t: t[::-1], "does not increase"),
    (lambda t: 1e3 * t, "milliseconds"), (lambda t: 0.0 * t, "does not increase"),
])
def test_clocks_that_go_back_or_jump_are_refused(change: object, says: str) -> None:
    good = recording()
    with pytest.raises(InputError, match=says) as refused:
        check(Recording({**good.columns, "t": change(good.t)}))  # type: ignore[operator]
    assert refused.value.field == "t"


def test_a_pause_is_mentioned_and_the_arm_may_stand_elsewhere_after_it() -> None:
    whole = recording()
    later = whole.t > 6.0
    columns = {**whole.columns, "t": whole.t + 20.0 * later, "q_1": whole.columns["q_1"] + 0.7 * later}
    same, warnings = check(Recording(columns))
    assert len(same.t) == len(whole.t)
    assert "20" in warnings[0]


def test_a_position_that_jumps_and_stays_is_refused() -> None:
    with pytest.raises(InputError, match="the position jumps") as refused:
        check(changed("q_2", slice(1500, None), 3.0))
    assert refused.value.field == "q_2"


def test_measured_recordings_pass_untouched() -> None:
    files = sorted(DATA.rglob("*.parquet"))
    if not files:
        pytest.skip("no measured recordings beside the repository")
    for file in files[:20]:
        measured = Recording.read(file)
        joints = range(1, measured.n + 1)
        driven = [f"{key}_{i}" for key in ("tau", "current") if measured.has(key) for i in joints]
        same, _ = plausible(measured, [f"q_{i}" for i in joints], driven)
        assert same is measured, file.name


@pytest.mark.parametrize("name", ["q_1", "tau_2"])
def test_a_column_of_values_that_no_arm_has_is_refused(name: str) -> None:
    good = recording()
    with pytest.raises(InputError, match=r"impossible for an arm"):
        check(changed(name, slice(None), 1e200 * good.columns[name] if name == "tau_2" else good.columns[name] + 1e10))


@pytest.mark.parametrize("share", [0.04, 0.5])
def test_a_torque_that_stands_still_while_its_joint_moves_is_named(share: float) -> None:
    good = recording(count=15_000)
    stands = slice(6000, 6000 + round(share * len(good.t)))
    tau = np.array(good.columns["tau_2"])
    tau[stands] = tau[6000]
    spoilt = Recording({**good.columns, "tau_2": tau})
    if share > 0.05:
        with pytest.raises(InputError, match=r"tau_2.*stands at"):
            check(spoilt)
        return
    clean, warnings = check(spoilt)
    assert any(warning.startswith("stuck: tau_2") for warning in warnings)
    assert len(good.t) - len(clean.t) == stands.stop - stands.start


def test_a_coarse_channel_one_at_its_limit_and_one_at_rest_do_not_stand_still() -> None:
    moving = recording(count=15_000)
    tau, q = np.array(moving.columns["tau_1"]), np.array(moving.columns["q_1"])
    coarse = Recording({**moving.columns, "tau_1": 50.0 * np.round(moving.columns["q_1"] / 0.4)})
    limited = Recording({**moving.columns, "tau_1": np.clip(5.0 * tau, -60.0, 60.0)})
    q[3000:6000], tau[3000:6000] = q[3000], tau[3000]
    q[6000:] += q[5999] - q[6000]
    rests = Recording({**moving.columns, "q_1": q, "tau_1": tau})
    for sound in (coarse, limited, rests):
        assert check(sound) == (sound, [])


def test_torques_beyond_what_the_drive_gives_are_refused() -> None:
    good, tau_max = recording(), np.array([200.0, np.inf])
    assert plausible(good, ["q_1", "q_2"], ["tau_1", "tau_2"], tau_max)[0] is good
    spoilt = Recording({**good.columns, "tau_1": 1e3 * good.columns["tau_1"]})
    with pytest.raises(InputError, match=r"tau_1.*the drive gives 200 N m"):
        plausible(spoilt, ["q_1", "q_2"], ["tau_1", "tau_2"], tau_max)


# Channels are recognised for what they are, and ordinary ones are left alone.

T = np.arange(0.0, 20.0, 0.004)


def motion() -> np.ndarray:
    return np.column_stack([np.sin(1.3 * T), np.cos(0.9 * T)])


def torque(rng: np.random.Generator) -> np.ndarray:
    return 10.0 * np.column_stack([np.sin(1.3 * T + 0.3), np.cos(2.1 * T)]) + 0.1 * rng.normal(size=(len(T), 2))


def kinds(tau: np.ndarray, q: np.ndarray | None = None, t: np.ndarray = T) -> list[tuple[str, str]]:
    findings = channel_findings(Recording.from_arrays(t, q=motion() if q is None else q, tau=tau))
    return [(f.kind, f.column) for f in findings]


def test_ordinary_channels_are_left_alone() -> None:
    assert kinds(torque(np.random.default_rng(0))) == []


def test_dead_stepped_clipped_and_filtered() -> None:
    rng = np.random.default_rng(1)
    tau = torque(rng)
    dead = tau.copy()
    dead[rng.random(len(T)) < 0.8, 1] = 0.0
    assert kinds(dead) == [("dead", "tau_2")]
    dead[:, 1] = 3.7
    assert kinds(dead) == [("dead", "tau_2")]
    dead[:, 1] = 0.0
    assert dead_joints(channel_findings(Recording.from_arrays(T, q=motion(), tau=dead))) == [1]
    assert kinds(np.column_stack([tau[:, 0], np.round(tau[:, 1])])) == [("stepped", "tau_2")]
    assert kinds(np.column_stack([np.clip(tau[:, 0], -8.0, 8.0), tau[:, 1]])) == [("clipped", "tau_1")]
    slow = signal.sosfiltfilt(signal.butter(6, 5.0, fs=250.0, output="sos"), tau[:, 0])
    assert kinds(np.column_stack([slow, tau[:, 1]])) == [("filtered", "tau_1")]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("levels", [1, 2, 3])
def test_a_torque_that_stands_with_its_joint_is_not_at_a_limit(levels: int, seed: int) -> None:
    """A joint that rests in a few postures: the logged torque is one level in each, and the largest is one of them."""
    rng = np.random.default_rng(seed)
    q, tau = motion(), torque(rng)
    joint, other = seed % 2, 1 - seed % 2
    rest = np.array_split(np.arange(len(T)), 2 * levels + 1)[1::2]
    for k, rows in enumerate(rest):
        q[rows[0]:, joint] += q[rows[0], joint] - q[rows, joint][-1]
        q[rows, joint] = q[rows[0], joint]
        tau[rows, joint] = 12.0 * (-1.0) ** k
    assert ("clipped", f"tau_{joint + 1}") not in kinds(tau, q=q)
    tau[:, other] = np.clip(tau[:, other], -8.0, 8.0)
    assert ("clipped", f"tau_{other + 1}") in kinds(tau, q=q)


def test_coarse_encoders_and_irregular_stamps() -> None:
    rng = np.random.default_rng(2)
    tau = torque(rng)
    assert kinds(tau, q=5e-4 * np.round(motion() / 5e-4)) == [("stepped", "q_1"), ("stepped", "q_2")]
    assert kinds(tau, t=np.sort(T + rng.uniform(-1e-3, 1e-3, len(T)))) == [("irregular-stamps", "t")]


def test_a_step_is_measured() -> None:
    rng = np.random.default_rng(3)
    assert lattice(0.25 * rng.integers(-20, 20, 1000)) == pytest.approx(0.25)
    assert lattice(rng.normal(size=1000)) == 0.0


def test_numbers_whose_squares_overflow_say_nothing_of_their_filter() -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        assert filtered_above(1e200 * np.sin(T)[:, None], 250.0) == [None]


# Samples taken irregularly and stamped as if they were regular.

def _motion(t: np.ndarray, n: int) -> np.ndarray:
    rng = np.random.default_rng(5)
    phase, size = rng.uniform(0.0, 6.28, (n, 4)), rng.uniform(0.1, 0.4, (n, 4))
    return np.column_stack([sum(size[j, k] * np.sin(2 * np.pi * 0.15 * (k + 1) * t + phase[j, k]) for k in range(4))
                            for j in range(n)])


@pytest.mark.parametrize(("step", "encoder"), [(0.01, 1e-4), (0.004, 1e-5)])
def test_instants_are_told_by_the_motion(step: float, encoder: float) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 20.0, step)
    late = rng.uniform(-0.15, 0.15, len(t)) * step
    instants, spread = sampling_instants(t, np.round(_motion(t + late, 5) / encoder) * encoder)
    assert spread == pytest.approx(np.std(late), rel=0.2)
    # What a filter of 5 Hz takes for motion stays.
    inner = slice(50, -50)
    assert np.std((instants - t - late)[inner]) < 0.45 * np.std(late)


def test_regular_samples_stay_where_they_are() -> None:
    t = np.arange(0.0, 20.0, 0.01)
    q = np.round(_motion(t, 5) / 1e-4) * 1e-4
    assert sampling_instants(t, q)[1] == 0.0
    # Vibrations are no clock: they do not follow each joint's speed.
    shake = 3e-4 * np.sin(2 * np.pi * 17.0 * t)[:, None] * np.array([1.0, -0.5, 0.8, 0.3, -1.0])
    assert sampling_instants(t, q + shake)[1] == 0.0


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("moving", [0, 1, 3])
def test_joints_that_stand_still_or_turn_evenly_say_nothing_of_the_clock(moving: int) -> None:
    """Once means of nothing: instants that were no numbers."""
    t = np.arange(0.0, 20.0, 0.004)
    instants, spread = sampling_instants(t, np.outer(t, 0.1 * (np.arange(3) < moving)))
    np.testing.assert_array_equal(instants, t)
    assert spread == 0.0


def test_stamps_that_are_right_are_kept() -> None:
    t = np.arange(0.0, 20.0, 0.01) + np.random.default_rng(2).uniform(-0.0015, 0.0015, 2000)
    assert sampling_instants(t, np.round(_motion(t, 5) / 1e-4) * 1e-4)[1] == 0.0


def test_checked_recording_says_so() -> None:
    rng = np.random.default_rng(3)
    robot = Robot.load("kr6")
    t = np.arange(0.0, 20.0, 0.01)
    q = _motion(t + rng.uniform(-0.0015, 0.0015, len(t)), robot.n)
    tau = np.sin(t[:, None] + np.arange(robot.n))
    (repaired,), warnings = checked([Recording.from_arrays(t, q=q, tau=tau, source="jittery")], robot)
    assert any(text.startswith("irregular-sampling") for text in warnings)
    assert np.std(repaired.t - t) == pytest.approx(0.0015 / np.sqrt(3.0), rel=0.2)


def test_joints_that_move_in_step_are_no_clock() -> None:
    """Strokes whose acceleration jumps are as fast as any jitter, and in all joints alike."""
    t = np.arange(0.0, 20.0, 0.01)
    stroke = np.cumsum(np.cumsum(8.0 * np.sign(np.sin(2 * np.pi * 1.3 * t))) * 0.01) * 0.01
    stroke -= np.polyval(np.polyfit(t, stroke, 1), t)
    q = stroke[:, None] * np.array([0.8, -0.5, 1.0, 0.3, -0.7])
    assert sampling_instants(t, np.round(q / 1e-4) * 1e-4)[1] == 0.0


@pytest.mark.parametrize("lost", [0.0, 0.03])
def test_irregular_samples_with_jittering_stamps_are_not_put_on_a_clock(lost: float) -> None:
    """A clock made of such stamps is less rough than they are, and was taken for the one that had sampled."""
    rng = np.random.default_rng(4)
    robot = Robot.load("kr6")
    # Some steps are a fifth longer, as a logger has them that waits for its controller.
    instants = np.cumsum(rng.choice([0.0100, 0.0120], size=4000, p=[0.7, 0.3]))
    stamps = np.sort(instants + np.clip(rng.normal(scale=1e-3, size=len(instants)), -1.9e-3, 1.9e-3))
    q = np.round(_motion(instants, robot.n) / 1e-4) * 1e-4
    keep = rng.random(len(instants)) >= lost
    tau = np.sin(instants[:, None] + np.arange(robot.n))
    (repaired,), _ = checked([Recording.from_arrays(stamps[keep], q=q[keep], tau=tau[keep], source="jittery")], robot)
    error = (repaired.t - instants[keep])[50:-50]
    assert np.std(error) < 0.5 * np.std((stamps - instants)[keep])
    q_now, _ = regular_stamps(repaired.t, repaired.joints("q"))
    np.testing.assert_array_equal(q_now, repaired.t)


# Stamps are corrected where the positions say that they are late, and only there.

STEP = 0.004


def path(t: np.ndarray) -> np.ndarray:
    return np.column_stack([np.sin(2.0 * t), np.cos(3.1 * t)])


def test_late_stamps_are_put_back() -> None:
    rng = np.random.default_rng(1)
    true = np.arange(0.0, 20.0, STEP)
    true = true[rng.random(len(true)) > 0.01]
    stamped = np.sort(true + rng.normal(scale=4e-4, size=len(true)))
    stamps, jitter = regular_stamps(stamped, path(true))
    assert jitter == pytest.approx(4e-4, rel=0.1)
    assert np.std(stamps - true) < 0.25 * np.std(stamped - true)


def test_right_stamps_of_irregular_samples_stay() -> None:
    true = np.sort(np.arange(0.0, 20.0, STEP) + np.random.default_rng(2).normal(scale=4e-4, size=5000))
    stamps, jitter = regular_stamps(true, path(true))
    assert jitter == 0.0
    np.testing.assert_array_equal(stamps, true)
