"""Wrong recordings: a clear error or a named warning, never a silent wrong model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from ideal_robot.errors import InputError
from ideal_robot.friction import ViscousCoulomb
from ideal_robot.identification.checks import checked, require_motion
from ideal_robot.identification.idim import identify
from ideal_robot.identification.whole_model import identify_model
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.filters import lowpass
from ideal_robot.signals.preprocess import preprocess
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.identification.test_excitation import base, record, robot, truth
from tests.sources import DATA


@pytest.fixture(scope="module")
def good() -> Recording:
    return record(truth(), np.random.default_rng(0), rate=100.0)


def changed(recording: Recording, **columns: np.ndarray | None) -> Recording:
    values = {**recording.columns, **columns}
    return Recording({k: np.array(v) for k, v in values.items() if v is not None}, recording.meta, recording.source)


def in_degrees(recording: Recording) -> dict[str, np.ndarray]:
    return {f"q_{i + 1}": np.degrees(recording.columns[f"q_{i + 1}"]) for i in range(6)}


def test_a_good_recording_passes(good: Recording) -> None:
    usable, warnings = checked([good], robot())
    assert warnings == []
    assert usable[0].hash == good.hash


@pytest.mark.parametrize(("columns", "says"), [
    ({"tau_3": None}, "tau_3"), ({"q_1": None}, "q_1"), ({"t": None}, r"t \[s\]"), ({"q_6": None}, r"5 joints .*has 6"),
    ({f"tau_{i + 1}": 0.0 for i in range(6)}, "every torque is zero")])
def test_columns_that_are_missing_or_zero(columns: dict[str, float | None], says: str, good: Recording) -> None:
    values = {name: None if value is None else np.full(len(good.t), value) for name, value in columns.items()}
    with pytest.raises(InputError, match=says):
        identify([changed(good, **values)], robot())


def test_a_recording_of_another_shipped_arm(good: Recording) -> None:
    """A path of the KR 15 read with the KR 6's URDF gave kinematic errors of 46 mm instead of a word."""
    named = Recording(dict(good.columns), {"robot": "kr15"}, "path.parquet")
    with pytest.raises(InputError, match=r"of kr15, not of kr6; give --robot kr15"):
        checked([named], Robot.load("kr6"))


def test_degrees_are_seen_from_the_limits(good: Recording) -> None:
    with pytest.raises(InputError, match="degrees"):
        identify([changed(good, **in_degrees(good))], robot())


def test_too_short_or_none_at_all(good: Recording) -> None:
    with pytest.raises(InputError, match="too short"):
        identify([Recording({k: v[:60].copy() for k, v in good.columns.items()})], robot())
    with pytest.raises(InputError, match="no recording"):
        identify([], robot())


def test_a_few_nans_are_left_out_and_said(good: Recording) -> None:
    q = np.array(good.columns["q_2"])
    q[[100, 101, 500]] = np.nan
    usable, warnings = checked([changed(good, q_2=q)], robot())
    assert len(usable[0].t) == len(good.t) - 3
    assert warnings[0].startswith("not-a-number: 3 samples")
    q[: len(q) // 4] = np.nan
    with pytest.raises(InputError, match="q_2"):
        checked([changed(good, q_2=q)], robot())


def test_a_joint_that_never_moves_is_said_and_keeps_its_nominal_values(good: Recording) -> None:
    still = changed(good, q_6=np.full(len(good.t), 0.3))
    result = identify([still], robot(), friction="viscous_coulomb")
    assert {"joint-never-moves", "not-excited"} <= {w.split(":")[0] for w in result.warnings}
    assert np.all(np.isfinite(result.model.inverse_dynamics(*np.zeros((3, 1, 6)))))


def test_current_becomes_torque(good: Recording) -> None:
    arm = robot()
    columns = {k: v for k, v in good.columns.items() if not k.startswith("tau")}
    columns |= {f"current_{i + 1}": good.columns[f"tau_{i + 1}"] / arm.drive_gain[i] for i in range(6)}
    usable, warnings = checked([Recording(columns)], arm)
    np.testing.assert_allclose(usable[0].joints("tau"), good.joints("tau"))
    assert warnings == []
    _, warnings = checked([Recording(columns)], replace(arm, drive_gain=np.ones(6)))
    assert warnings[0].startswith("unknown-drive-gain: no drive gains are known")
    some = replace(arm, drive_gain=np.where(np.arange(6) == 2, 1.0, arm.drive_gain))
    _, warnings = checked([Recording(columns)], some)
    assert warnings[0].startswith("unknown-drive-gain: the drive gain of joint 3 is not known")


@pytest.mark.parametrize("unknown", [(0, 1, 2, 3, 4, 5), (2,)])
def test_parameters_in_amperes_are_said_to_be_and_are_no_masses(unknown: tuple[int, ...], tmp_path: Path) -> None:
    model = Model.nominal(robot())
    joints = [j + 1 for j in unknown]
    amperes = replace(model, provenance={**model.provenance, "amperes": joints})
    for j in range(6):
        assert amperes.units("N m")[j] == ("A" if j in unknown else "N m")
        assert amperes.units("N m/rad")[j] == ("A/rad" if j in unknown else "N m/rad")
    for own, plain in zip(amperes.parameters, model.parameters, strict=True):
        assert ("kg" in own.unit or "N" in own.unit) == (("kg" in plain.unit or "N" in plain.unit)
                                                         and own.joint not in joints)
    with pytest.raises(InputError, match="in amperes; give drive gains"):
        amperes.export_urdf(tmp_path / "arm.urdf")
    assert not (tmp_path / "arm.urdf").exists()
    model.export_urdf(tmp_path / "arm.urdf")


def test_joint_names_tell_which_joint_it_is_or_are_refused(good: Recording) -> None:
    """They are put in the robot's order.

    Of other names than the robot's, what all of them share counts for nothing; taken by number they mixed joints.
    """
    names = list(robot().pinocchio.names)[1:]
    order = [3, 1, 0, 5, 4, 2]
    columns = {"t": good.t, **{f"{p}_{i + 1}": good.columns[f"{p}_{j + 1}"] for p in ("q", "tau")
                               for i, j in enumerate(order)}}
    for called in (names, [f"left_{name}_joint" for name in names], [f"axis {i + 1}" for i in range(6)]):
        usable, _ = checked([Recording(columns, {"joints": [called[j] for j in order]})], robot())
        np.testing.assert_array_equal(usable[0].joints("q"), good.joints("q"))
    foreign = ["pan", "lift", "elbow", "roll", "pitch", "yaw"]
    with pytest.raises(InputError, match=f"joints: .*{', '.join(foreign)}.*{', '.join(names)}.*give the URDF"):
        checked([Recording(columns, {"joints": foreign})], robot())


@pytest.mark.parametrize(("names", "missing"), [((1, 2, 4, 5, 6), "q_3"), (range(6), "q_6")])
def test_the_column_that_is_missing_is_named(good: Recording, names: Sequence[int], missing: str) -> None:
    columns = {f"q_{name}": good.columns["q_1"] for name in names}
    with pytest.raises(InputError, match=f"{missing}: column is missing"):
        checked([Recording({"t": good.t, **columns})], robot())


def test_the_same_recording_is_no_second_one(good: Recording) -> None:
    """Whatever its file is called: it has no part in what judges it, and counts once."""
    again = replace(good, source="copy.csv")
    for recordings, validation in (([good, again], []), ([good], [again])):
        with pytest.raises(InputError, match=r"copy\.csv: .*same samples as"):
            identify(recordings, robot(), validation=validation)


def test_an_arm_at_rest_tells_nothing(good: Recording) -> None:
    still = changed(good, **{f"q_{i}": 1e-6 * good.columns[f"q_{i}"] for i in range(1, good.n + 1)})
    with pytest.raises(InputError, match="no joint moves"):
        identify([still], robot())
    require_motion([still, good])


# Filters, channels and errors of the motion are found from the data, and a known truth behind them is recovered.

PANDA = DATA / "panda" / "panda_a.parquet"
TIAGO = DATA / "tiago" / "tiago_a.parquet"


def stepped_and_late(recording: Recording, rng: np.random.Generator) -> Recording:
    """As a poor logger has it: encoder steps of 0.5 mrad, stamps 1 ms about the clock."""
    t = np.sort(recording.t + np.clip(rng.normal(scale=1e-3, size=len(recording.t)), -1.9e-3, 1.9e-3))
    q = {f"q_{j + 1}": 5e-4 * np.round(recording.columns[f"q_{j + 1}"] / 5e-4) for j in range(recording.n)}
    return changed(recording, t=t, **q)


def test_truth_behind_encoder_steps_and_jitter_without_a_switch() -> None:
    rng, what = np.random.default_rng(3), truth()
    result = identify([stepped_and_late(record(what, rng), rng)], robot(), friction="viscous_coulomb")
    std = np.sqrt(np.diag(result.model.covariance))[: base().count]
    good = std < 0.2 * np.abs(result.model.base_values)
    z = ((result.model.base_values - what.base) / std)[good]
    assert good.sum() >= 12
    assert np.all(np.abs(z) < 4.0)
    assert np.sqrt(np.mean(z**2)) < 1.6
    error = result.model.provenance["position_error"]
    assert error["jitter"] == pytest.approx(1e-3, rel=0.2)
    np.testing.assert_allclose(error["step"], 5e-4, rtol=1e-3)
    assert result.model.provenance["filters"]["cutoff"] <= 20.0
    names = {text.split(":")[0] for text in result.warnings}
    assert {"irregular-stamps", "stepped-channel"} <= names


def test_a_dead_channel_is_named_and_left_out() -> None:
    rng, what = np.random.default_rng(4), truth()
    good = record(what, rng)
    dead = np.where(rng.random(len(good.t)) < 0.8, 0.0, good.columns["tau_6"])
    result = identify([changed(good, tau_6=dead)], robot(), friction="viscous_coulomb")
    assert any(text.startswith("dead-channel: tau_6") for text in result.warnings)
    assert result.model.provenance["samples_counted_percent"][5] == 0.0
    assert result.model.provenance["samples_counted_percent"][0] > 50.0
    assert np.all(result.estimation[0].residual_std_percent[:5] < 10.0)
    assert np.all(np.isfinite(result.model.covariance))


def test_torque_filtered_before_it_was_logged_is_named() -> None:
    rng, what = np.random.default_rng(5), truth()
    good = record(what, rng)
    slow = signal.sosfiltfilt(signal.butter(6, 5.0 / 125.0, output="sos"), good.columns["tau_2"])
    result = identify([changed(good, tau_2=slow)], robot(), friction="viscous_coulomb")
    (named,) = (text for text in result.warnings if text.startswith("filtered-channel"))
    assert "tau_2" in named


def test_friction_never_drives() -> None:
    """Viscous friction that is not there comes out at its bound, without a standard deviation, and is named."""
    rng = np.random.default_rng(6)
    laws = [ViscousCoulomb(np.array([[0.0], [0.04 * tau]])) for tau in robot().tau_max]
    result = identify([record(truth(laws), rng)], robot(), friction="viscous_coulomb")
    viscous = {p.name: p for p in result.model.parameters if p.name.startswith("Fv")}
    assert all(p.value >= 0.0 for p in viscous.values())
    held = [p for p in viscous.values() if p.value == 0.0]
    assert held
    assert all(p.std == 0.0 for p in held)
    assert any(text.startswith("friction-at-bound") and held[0].name in text for text in result.warnings)


@pytest.mark.parametrize("law", [pytest.param("arctan", marks=pytest.mark.slow),
                                 pytest.param("stribeck", marks=pytest.mark.slow), "bell_stribeck"])
def test_a_single_law_that_nowhere_brakes_ends_in_a_model(law: str) -> None:
    rng = np.random.default_rng(6)
    none = [ViscousCoulomb(np.zeros((2, 1))) for _ in range(6)]
    model = identify([record(truth(none), rng)], robot(), friction=law).model
    slow = np.full((1, 6), 0.1)
    assert np.all(np.abs(model.friction.torque(slow)) < 0.01 * robot().tau_max)


@pytest.mark.slow
def test_the_wrong_sign_is_said_only_where_it_is_wrong() -> None:
    good = record(truth(), np.random.default_rng(7))
    flipped = changed(good, **{f"tau_{j + 1}": -good.columns[f"tau_{j + 1}"] for j in range(6)})
    for logged, wrong in ((good, False), (flipped, True)):
        warnings = identify([logged], robot(), friction="viscous_coulomb").warnings
        assert any("wrong-sign" in text for text in warnings) == wrong


@pytest.mark.slow
@pytest.mark.skipif(not PANDA.exists(), reason="measured data (../shared/data/panda) are not there")
def test_panda_ahead_of_its_authors_without_a_switch() -> None:
    """Published: std(residual) / std(torque) on the second half, positions below 8 Hz, torques below 4 Hz."""
    model = identify([Recording.read(PANDA)], Robot.load(PANDA.parent / "panda.urdf")).model
    s = preprocess(Recording.read(PANDA.parent / "panda_b.parquet"), cutoff=8.0)
    residual, torque = (lowpass(values, s.dt, 4.0)[500:-500] for values in (
        s.tau - model.inverse_dynamics(s.q, s.qd, s.qdd), s.tau))
    errors = 100.0 * np.std(residual, axis=0) / np.std(torque, axis=0)
    assert np.sum(errors > [6.3, 2.5, 2.4, 5.1, 11.5, 7.4, 19.9]) <= 1


@pytest.mark.skipif(not TIAGO.exists(), reason="measured data (../shared/data/tiago) are not there")
def test_dead_channels_of_a_real_arm() -> None:
    result = identify([Recording.read(TIAGO)], Robot.load(TIAGO.parent / "tiago.urdf"), friction="viscous_coulomb")
    dead = [text for text in result.warnings if text.startswith("dead-channel")]
    assert [text.split()[1] for text in dead] == ["tau_6", "tau_7", "tau_8"]


def test_a_recording_of_three_seconds_ends_in_a_model() -> None:
    """None of the laws that led a first look at a joint brakes in the second: the simplest one is left."""
    whole = record(truth(), np.random.default_rng(1), noise=0.02)
    here = (whole.t >= 6.0) & (whole.t < 9.25)
    short = replace(whole, columns={name: values[here] for name, values in whole.columns.items()})
    model = identify([short], robot()).model
    assert np.all(np.isfinite(model.covariance))
    assert np.all(model.friction.torque(np.full((1, 6), 0.5)) > 0.0)


def commands(recording: Recording) -> dict[str, np.ndarray]:
    """Commands that lead a motion by 20 ms."""
    return {f"q_c_{i + 1}": np.interp(recording.t + 0.02, recording.t, recording.columns[f"q_{i + 1}"])
            for i in range(6)}


def test_commands_are_checked_where_they_are_used(good: Recording) -> None:
    whole = changed(good, **commands(good))
    assert checked([whole], robot(), commands=True) == ([whole], [])
    holed = np.array(whole.columns["q_c_2"])
    holed[100:110] = np.nan
    (used,), (warning,) = checked([changed(whole, q_c_2=holed)], robot(), commands=True)
    assert len(used.t) == len(whole.t) - 10
    assert "10 samples with NaN (first in q_c_2)" in warning
    _, (warning,) = checked([changed(whole, q_c_4=None)], robot(), commands=True)
    assert warning.startswith("no-controller: q_c_4 is missing")
    torn = np.array(whole.columns["q_c_2"])
    torn[100] += 3.0
    (used,), (warning,) = checked([changed(whole, q_c_2=torn)], robot(), commands=True)
    np.testing.assert_array_equal(used.t, np.delete(whole.t, 100))
    assert warning.startswith("spike: 1 samples of q_c_2")
    torn[1000:] = np.nan
    (used,), (warning,) = checked([changed(whole, q_c_2=torn)], robot(), commands=True)
    assert warning.startswith("no-controller: q_c_2 has no number in")
    assert used.joints("tau").shape == whole.joints("tau").shape


def test_commands_in_degrees_or_of_another_joint_are_refused(good: Recording) -> None:
    led = commands(good)
    degrees = {name: np.degrees(values) for name, values in led.items()}
    with pytest.raises(InputError, match=r"q_c_\d: .*degrees"):
        checked([changed(good, **degrees)], robot(), commands=True)
    with pytest.raises(InputError, match="q_c_2: the joint does not follow this command"):
        checked([changed(good, **{**led, "q_c_2": led["q_c_3"], "q_c_3": led["q_c_2"]})], robot(), commands=True)
    assert checked([changed(good, **degrees)], robot())[1] == []
    with pytest.raises(InputError, match="degrees"):
        identify_model(good, robot(), without_integrator=changed(good, **led, **in_degrees(good)))
