"""Values that cannot be are found, named and left out or refused; a valid recording comes back bit for bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ideal_robot.errors import InputError
from ideal_robot.signals.plausible import plausible
from ideal_robot.signals.recording import Recording

SHARED = Path(__file__).resolve().parents[4] / "shared" / "data"


def recording(seed: int = 1, dt: float = 0.004, count: int = 3000) -> Recording:
    rng = np.random.default_rng(seed)
    t = dt * np.arange(count)
    q = np.column_stack([np.sin(1.3 * t), 0.4 * np.cos(2.1 * t)])
    tau = 40.0 * np.sign(np.cos(1.3 * t))[:, None] + 30.0 * q + rng.normal(size=q.shape)
    return Recording.from_arrays(t, q=q, tau=tau)


def check(one: Recording) -> tuple[Recording, list[str]]:
    return plausible(one, ["q_1", "q_2"], ["tau_1", "tau_2"])


def changed(name: str, index: object, value: object) -> Recording:
    one = recording()
    columns = {key: np.array(values) for key, values in one.columns.items()}
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
    one = Recording.from_arrays(t, q=q[:, None], tau=tau[:, None])
    same, warnings = plausible(one, ["q_1"], ["tau_1"])
    assert same is one
    assert warnings == []


@pytest.mark.parametrize(("name", "value"), [("tau_1", 1e6), ("tau_2", -1e4), ("q_1", 0.5), ("q_2", 3.0)])
def test_a_spike_is_left_out_and_named(name: str, value: float) -> None:
    one = recording()
    spoilt = changed(name, 1500, one.columns[name][1500] + value)
    clean, warnings = check(spoilt)
    assert any("spike" in warning and name in warning for warning in warnings)
    assert len(clean.t) == len(one.t) - 1
    assert 1500 * 0.004 not in clean.t


def test_a_few_samples_that_are_no_numbers_are_left_out_and_many_refused() -> None:
    clean, warnings = check(changed("tau_1", slice(100, 110), np.nan))
    assert len(clean.t) == 2990
    assert "not-a-number" in warnings[0]
    with pytest.raises(InputError, match="not numbers") as refused:
        check(changed("tau_2", slice(0, 900), np.inf))
    assert refused.value.field == "tau_2"


@pytest.mark.parametrize(("change", "says"), [
    (lambda t: np.where(t > 6.0, t - 5.0, t), "does not increase"),
    (lambda t: np.where(t > 6.0, t + 3600.0, t), "jumps"),
    (lambda t: np.where(t > 6.0, t + 172_800.0, t), "jumps"), (lambda t: t[::-1], "does not increase"),
    (lambda t: 1e3 * t, "milliseconds"), (lambda t: 0.0 * t, "does not increase"),
])
def test_clocks_that_go_back_or_jump_are_refused(change: object, says: str) -> None:
    one = recording()
    with pytest.raises(InputError, match=says) as refused:
        check(Recording({**one.columns, "t": change(one.t)}))  # type: ignore[operator]
    assert refused.value.field == "t"


def test_a_pause_is_mentioned_and_the_arm_may_stand_elsewhere_after_it() -> None:
    one = recording()
    later = one.t > 6.0
    columns = {**one.columns, "t": one.t + 20.0 * later, "q_1": one.columns["q_1"] + 0.7 * later}
    same, warnings = check(Recording(columns))
    assert len(same.t) == len(one.t)
    assert "20" in warnings[0]


def test_a_position_that_jumps_and_stays_is_refused() -> None:
    with pytest.raises(InputError, match="the position jumps") as refused:
        check(changed("q_2", slice(1500, None), 3.0))
    assert refused.value.field == "q_2"


def test_measured_recordings_pass_untouched() -> None:
    files = sorted(SHARED.rglob("*.parquet"))
    if not files:
        pytest.skip("no measured recordings beside the repository")
    for file in files[:20]:
        one = Recording.read(file)
        joints = range(1, one.n + 1)
        driven = [f"{key}_{i}" for key in ("tau", "current") if one.has(key) for i in joints]
        same, _ = plausible(one, [f"q_{i}" for i in joints], driven)
        assert same is one, file.name


@pytest.mark.parametrize("name", ["q_1", "tau_2"])
def test_a_column_of_values_that_no_arm_has_is_refused(name: str) -> None:
    one = recording()
    with pytest.raises(InputError, match=r"no arm has"):
        check(changed(name, slice(None), 1e200 * one.columns[name] if name == "tau_2" else one.columns[name] + 1e10))


@pytest.mark.parametrize("share", [0.04, 0.5])
def test_a_torque_that_stands_still_while_its_joint_moves_is_named(share: float) -> None:
    one = recording(count=15_000)
    stands = slice(6000, 6000 + round(share * len(one.t)))
    tau = np.array(one.columns["tau_2"])
    tau[stands] = tau[6000]
    spoilt = Recording({**one.columns, "tau_2": tau})
    if share > 0.05:
        with pytest.raises(InputError, match=r"tau_2.*stands at"):
            check(spoilt)
        return
    clean, warnings = check(spoilt)
    assert any(warning.startswith("stuck: tau_2") for warning in warnings)
    assert len(one.t) - len(clean.t) == stands.stop - stands.start


def test_a_coarse_channel_one_at_its_limit_and_one_at_rest_do_not_stand_still() -> None:
    one = recording(count=15_000)
    tau, q = np.array(one.columns["tau_1"]), np.array(one.columns["q_1"])
    coarse = Recording({**one.columns, "tau_1": 50.0 * np.round(one.columns["q_1"] / 0.4)})
    limited = Recording({**one.columns, "tau_1": np.clip(5.0 * tau, -60.0, 60.0)})
    q[3000:6000], tau[3000:6000] = q[3000], tau[3000]
    q[6000:] += q[5999] - q[6000]
    rests = Recording({**one.columns, "q_1": q, "tau_1": tau})
    for sound in (coarse, limited, rests):
        assert check(sound) == (sound, [])


def test_torques_beyond_what_the_drive_gives_are_refused() -> None:
    one, tau_max = recording(), np.array([200.0, np.inf])
    assert plausible(one, ["q_1", "q_2"], ["tau_1", "tau_2"], tau_max)[0] is one
    spoilt = Recording({**one.columns, "tau_1": 1e3 * one.columns["tau_1"]})
    with pytest.raises(InputError, match=r"tau_1.*the drive gives 200 N m"):
        plausible(spoilt, ["q_1", "q_2"], ["tau_1", "tau_2"], tau_max)
