"""Recordings as other programs write them are read; what is left out is counted and named."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ideal_robot.errors import InputError
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.channels import channel_findings, dead_joints
from ideal_robot.signals.clean import cleaned
from ideal_robot.signals.export import write_mcap
from ideal_robot.signals.recording import Recording

N, ROWS, STEP = 6, 900, 0.004
KR6 = Robot.load("kr6")


def motion(seed: int = 1, rows: int = ROWS, step: float = STEP) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times ``(rows,)``, angles and torques ``(rows, 6)`` of a smooth motion within the limits."""
    rng = np.random.default_rng(seed)
    t = step * np.arange(rows)
    phase, speed = rng.uniform(0.0, 6.0, (2, N))
    q = KR6.home + 0.15 * np.sin(t[:, None] * (0.5 + 0.2 * speed) + phase)
    return t, q, 40.0 * np.cos(t[:, None] * (0.5 + 0.2 * speed)) + rng.normal(size=q.shape)


T, Q, TAU = motion()


def table(titles: Callable[[int], tuple[str, str]], time: str, clock: np.ndarray = T, scale: float = 1.0
          ) -> pd.DataFrame:
    """A table whose titles of position and torque of each joint are given."""
    frame = {time: clock}
    for j in range(N):
        position, torque = titles(j)
        frame |= {position: scale * Q[:, j], torque: TAU[:, j]}
    return pd.DataFrame(frame)


@pytest.mark.parametrize(("time", "titles"), [
    ("timestamp", lambda j: (f"actual_q_{j}", f"actual_current_{j}")),
    ("__time", lambda j: (f"/joint_states/joint_{j + 1}/position", f"/joint_states/joint_{j + 1}/effort")),
    ("%time", lambda j: (f"field.position{j}", f"field.effort{j}")),
    ("time", lambda j: (f"q[{j}]", f"tau_J[{j}]")),
    ("Zeit [s]", lambda j: (f"A{j + 1} Istposition [rad]", f"A{j + 1} Drehmoment [Nm]")),
    ("Time", lambda j: (f"Axis {j + 1}.Position actual value", f"Axis {j + 1}.Torque actual value")),
    ("timestamp", lambda j: (f"actual_q_{j}", f"measured_tq_{j}")),
    ("timestamp", lambda j: (f"actual_q_{j}", f"actual_current_as_torque_{j}")),
    ("Timestamp", lambda j: (f"MeasJntPos{j + 1}", f"MeasJntTrq{j + 1}")),
    ("times", lambda j: (f"joint{j + 1}", f"torque{j + 1}")),
    ("time", lambda j: (f"j{j + 1}", f"tau{j + 1}")),
    ("timestamp", lambda j: (f"observation.state_{j}", f"observation.effort_{j}")),
    ("stamp", lambda j: (f"{'abcdef'[j]}_joint_position", f"{'abcdef'[j]}_joint_torque"))])
def test_titles_of_other_programs_are_recognised(time: str, titles: Any, tmp_path: Path) -> None:
    table(titles, time).to_csv(tmp_path / "r.csv", index=False)
    read = Recording.read(tmp_path / "r.csv")
    np.testing.assert_allclose(read.t, T)
    np.testing.assert_allclose(read.joints("q"), Q)
    np.testing.assert_allclose(read.joints("tau" if read.has("tau") else "current"), TAU)
    assert any(text.startswith("columns: ") for text in read.meta["reading"])


@pytest.mark.parametrize(("axis", "scale"), [("$AXIS_ACT[{}]", np.degrees(1.0)), ("axis_act_{}", 1.0),
                                             ("$AXIS_ACT_MEAS[A{}]", np.degrees(1.0))])
def test_axes_of_krl_are_degrees(axis: str, scale: float, tmp_path: Path) -> None:
    table(lambda j: (axis.format(j + 1), f"$TORQUE_AXIS_ACT[{j + 1}]"), "t", scale=scale).to_csv(
        tmp_path / "r.csv", index=False)
    read = Recording.read(tmp_path / "r.csv")
    np.testing.assert_allclose(read.joints("q"), Q)
    np.testing.assert_allclose(read.joints("tau"), TAU)


def test_the_measured_value_is_taken_and_the_target_is_the_command(tmp_path: Path) -> None:
    frame = table(lambda j: (f"actual_q_{j}", f"actual_current_{j}"), "timestamp")
    for j in range(N):
        frame[f"target_q_{j}"] = Q[:, j] + 0.01
        frame[f"target_moment_{j}"] = 7.0
        frame[f"actual_TCP_force_{j}"] = 1.0
    frame.to_csv(tmp_path / "r.csv", index=False)
    read = Recording.read(tmp_path / "r.csv")
    np.testing.assert_allclose(read.joints("q_c"), Q + 0.01)
    assert not read.has("tau")
    assert "target_moment_0" in read.columns


@pytest.mark.parametrize(("unit", "scale"), [("[deg]", np.degrees(1.0)), ("(°)", np.degrees(1.0)), ("[rad]", 1.0)])
def test_units_in_titles_are_taken_into_account(unit: str, scale: float, tmp_path: Path) -> None:
    frame = table(lambda j: (f"joint{j + 1}_pos {unit}", f"joint{j + 1}_torque"), "time [ms]", 1e3 * T, scale)
    frame.to_csv(tmp_path / "r.csv", index=False)
    read = Recording.read(tmp_path / "r.csv")
    np.testing.assert_allclose(read.joints("q"), Q)
    np.testing.assert_allclose(read.t, T)


@pytest.mark.parametrize("form", [{"sep": ";", "decimal": ","}, {"sep": "\t"}, {"sep": " "}, {"sep": ";"},
                                  {"sep": "\t", "decimal": ","}])
@pytest.mark.parametrize("before", ["", "# exported by a trace\n\n"])
def test_separators_and_decimal_commas(form: dict[str, str], before: str, tmp_path: Path) -> None:
    frame = table(lambda j: (f"q_{j + 1}", f"tau_{j + 1}"), "t")
    (tmp_path / "r.csv").write_text(before + frame.to_csv(index=False, **form), encoding="utf-8")
    read = Recording.read(tmp_path / "r.csv")
    np.testing.assert_allclose(read.joints("q"), Q)
    np.testing.assert_allclose(read.joints("tau"), TAU)


def test_a_line_of_units_and_a_separator_at_the_end(tmp_path: Path) -> None:
    frame = table(lambda j: (f"A{j + 1} position", f"A{j + 1} torque"), "Time", scale=np.degrees(1.0))
    titles, *rows = frame.to_csv(index=False, sep=";").splitlines()
    units = ";".join(["s", *["°", "Nm"] * N])
    (tmp_path / "r.csv").write_text("\n".join(f"{line};" for line in (titles, units, *rows)), encoding="cp1252")
    read = Recording.read(tmp_path / "r.csv")
    np.testing.assert_allclose(read.joints("q"), Q)


@pytest.mark.parametrize("commanded", ["PositionCmptd", "Position_desired", "target_position"])
def test_further_words_beside_numbered_joints_are_no_joints(commanded: str, tmp_path: Path) -> None:
    log = table(lambda j: (f"Position{j + 1}", f"Torque{j + 1}"), "Time")
    for j in range(N):
        log = log.assign(**{f"TorqueSm{j + 1}": 0.0, f"TorqueFriction{j + 1}": 1.0, f"PositionOther{j + 1}": 9.0,
                            f"{commanded}{j + 1}": Q[:, j] + 1e-3})
    log.to_csv(tmp_path / "log.csv", index=False)
    recording = Recording.read(tmp_path / "log.csv")
    np.testing.assert_allclose(recording.joints("q"), Q)
    np.testing.assert_allclose(recording.joints("tau"), TAU)
    np.testing.assert_allclose(recording.joints("q_c"), Q + 1e-3)
    assert {"TorqueSm1", "PositionOther6"} <= set(recording.columns)


def test_tables_for_learning_hold_what_was_measured_and_commanded(tmp_path: Path) -> None:
    pq.write_table(pa.table({"timestamp": T, "observation.state": list(Q), "action": list(Q + 0.01),
                             "episode_index": np.zeros(ROWS)}), tmp_path / "log.parquet")
    recording = Recording.read(tmp_path / "log.parquet")
    np.testing.assert_allclose(recording.joints("q"), Q)
    np.testing.assert_allclose(recording.joints("q_c"), Q + 0.01)


@pytest.mark.parametrize("packed", [False, True])
def test_arrays_of_numpy_are_a_column_for_each_joint(packed: bool, tmp_path: Path) -> None:
    save = np.savez_compressed if packed else np.savez
    save(tmp_path / "log.npz", times=T, positions=Q, torques=TAU, target_positions=Q + 1e-3, rate=250.0,
         poses=np.zeros((ROWS, 4, 4)), names=np.array(["a", {}], dtype=object), other=np.zeros(7))
    recording = Recording.read(tmp_path / "log.npz")
    np.testing.assert_allclose(recording.t, T)
    np.testing.assert_allclose(recording.joints("q"), Q)
    np.testing.assert_allclose(recording.joints("tau"), TAU)
    np.testing.assert_allclose(recording.joints("q_c"), Q + 1e-3)


@pytest.mark.parametrize("hold", [b"no archive", b"PK\x03\x04" + 40 * b"x", b""])
def test_what_is_no_archive_of_arrays_is_refused(hold: bytes, tmp_path: Path) -> None:
    (tmp_path / "log.npz").write_bytes(hold)
    with pytest.raises(InputError, match="not a readable recording"):
        Recording.read(tmp_path / "log.npz")


def test_arrays_that_unfold_to_far_more_than_their_file_are_refused(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "log.npz", times=np.zeros(25_000_000))
    with pytest.raises(InputError, match="unfolds"):
        Recording.read(tmp_path / "log.npz")


def test_a_map_of_the_rate_alone_leaves_the_joints_to_their_titles(tmp_path: Path) -> None:
    table(lambda j: (f"Joint_{j + 1}", f"Torque_{j + 1}"), "t").drop(columns="t").to_csv(tmp_path / "log.csv",
                                                                                      index=False)
    with pytest.raises(InputError, match="Joint_") as refused:
        Recording.read(tmp_path / "log.csv")
    assert refused.value.field == "t"
    (tmp_path / "map.toml").write_text(f"t = {{rate = {1.0 / STEP}}}\n")
    recording = Recording.read(tmp_path / "log.csv", columns=tmp_path / "map.toml")
    np.testing.assert_allclose(recording.joints("q"), Q)
    np.testing.assert_allclose(recording.joints("tau"), TAU)
    np.testing.assert_allclose(recording.t, T, atol=1e-9)


def test_a_map_names_columns_factors_and_joints(tmp_path: Path) -> None:
    frame = table(lambda j: (f"ang{j}", f"x{j}"), "clock", 1e3 * T, np.degrees(1.0))
    frame.to_csv(tmp_path / "r.csv", index=False)
    with pytest.raises(InputError, match=r"columns are clock, ang\{0\} \(6\).*--columns"):
        Recording.read(tmp_path / "r.csv")
    gains = np.arange(1.0, 7.0)
    (tmp_path / "map.toml").write_text(
        f't = {{column = "clock", unit = "ms"}}\nq = {{columns = "ang{{0}}", unit = "deg"}}\n'
        f'tau = {{columns = {[f"x{j}" for j in range(N)]}, factor = {gains.tolist()}}}\n')
    read = Recording.read(tmp_path / "r.csv", columns=tmp_path / "map.toml")
    np.testing.assert_allclose(read.joints("q"), Q)
    np.testing.assert_allclose(read.joints("tau"), gains * TAU)
    np.testing.assert_allclose(read.t, T)
    for text, field in (('t = "nothing"', "t"), ('t = "clock"\nzeta = "x0"', "zeta"), ('t = "clock"', "q"),
                        ('t = "clock"\nq = {columns = "ang{0}", factor = [1, 2]}', "q.factor")):
        (tmp_path / "map.toml").write_text(text)
        with pytest.raises(InputError) as refused:
            Recording.read(tmp_path / "r.csv", columns=tmp_path / "map.toml")
        assert refused.value.field == field
        assert refused.value.file == tmp_path / "map.toml"


def test_two_groups_of_joints_are_asked_for(tmp_path: Path) -> None:
    frame = table(lambda j: (f"/left/joint_states/a{j}/position", f"/left/joint_states/a{j}/effort"), "__time")
    other = table(lambda j: (f"/right/joint_states/a{j}/position", f"/right/joint_states/a{j}/effort"), "t")
    pd.concat([frame, 2.0 * other.drop(columns="t")], axis=1).to_csv(tmp_path / "r.csv", index=False)
    with pytest.raises(InputError, match="--topic"):
        Recording.read(tmp_path / "r.csv")
    np.testing.assert_allclose(Recording.read(tmp_path / "r.csv", topic="right").joints("q"), 2.0 * Q)


@pytest.mark.parametrize(("factor", "digits"), [(1.0, 6), (1e3, 3), (1e9, 0)])
@pytest.mark.parametrize("title", ["timestamp", "t"])
def test_epoch_stamps_count_from_the_first(title: str, factor: float, digits: int, tmp_path: Path) -> None:
    frame = table(lambda j: (f"actual_q_{j}", f"actual_current_{j}"), title)
    frame[title] = [f"{factor * (1.7e9 + t):.{digits}f}" for t in T]
    frame.to_csv(tmp_path / "r.csv", index=False)
    read = Recording.read(tmp_path / "r.csv").t
    # A column t is seconds of a clock of its own.
    np.testing.assert_allclose(read - (1.7e9 if (title, factor) == ("t", 1.0) else 0.0), T, atol=2e-6)


# Stamps.

@pytest.mark.parametrize("rate", [50.0, 250.0])
def test_a_table_without_a_clock_is_read_at_a_rate(rate: float, tmp_path: Path) -> None:
    table(lambda j: (f"joint{j}", f"load{j}"), "row").drop(columns="row").to_csv(tmp_path / "r.csv", index=False)
    with pytest.raises(InputError, match=r"joint\{0\} \(6\), load\{0\} \(6\).*rate"):
        Recording.read(tmp_path / "r.csv")
    (tmp_path / "map.toml").write_text(f't = {{rate = {rate}}}\nq = "joint{{0}}"\ntau = "load{{0}}"\n')
    read = Recording.read(tmp_path / "r.csv", columns=tmp_path / "map.toml")
    np.testing.assert_allclose(read.t, np.arange(ROWS) / rate)
    np.testing.assert_allclose(read.joints("tau"), TAU)
    assert any(text.startswith("clock: ") for text in read.meta["reading"])
    (tmp_path / "map.toml").write_text('t = {rate = 0}\nq = "joint{0}"\n')
    with pytest.raises(InputError, match="rate"):
        Recording.read(tmp_path / "r.csv", columns=tmp_path / "map.toml")


def test_a_map_need_not_name_a_clock_that_names_itself(tmp_path: Path) -> None:
    table(lambda j: (f"joint{j}", f"load{j}"), "timestamp").to_csv(tmp_path / "r.csv", index=False)
    (tmp_path / "map.toml").write_text('q = "joint{0}"\n')
    np.testing.assert_allclose(Recording.read(tmp_path / "r.csv", columns=tmp_path / "map.toml").t, T)


@pytest.mark.parametrize("joint", range(3))
def test_a_column_that_stands_there_twice(joint: int, tmp_path: Path) -> None:
    frame = table(lambda j: (f"q_{j + 1}", f"tau_{j + 1}"), "t")
    again = pd.concat([frame, frame[[f"tau_{joint + 1}"]]], axis=1)
    again.to_csv(tmp_path / "r.csv", index=False)
    read = Recording.read(tmp_path / "r.csv")
    np.testing.assert_allclose(read.joints("tau"), TAU)
    assert any(f"tau_{joint + 1}" in text and "twice" in text for text in read.meta["reading"])
    again.iloc[:, -1] += 1.0
    again.to_csv(tmp_path / "r.csv", index=False)
    with pytest.raises(InputError, match="rename"):
        Recording.read(tmp_path / "r.csv")


@pytest.mark.parametrize("form", ["%Y-%m-%d %H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%f+00:00", "%H:%M:%S.%f"])
def test_dates_and_times_of_the_day_are_a_clock(form: str, tmp_path: Path) -> None:
    frame = table(lambda j: (f"q_{j + 1}", f"tau_{j + 1}"), "t")
    stamps = pd.Timestamp("2025-07-03 14:01:15.37") + pd.to_timedelta(T, unit="s")
    frame["t"] = stamps.strftime(form)
    frame.to_csv(tmp_path / "r.csv", index=False)
    read = Recording.read(tmp_path / "r.csv")
    np.testing.assert_allclose(read.t - read.t[0], T, atol=2e-6)
    frame["t"] = stamps
    frame.to_parquet(tmp_path / "r.parquet")
    read = Recording.read(tmp_path / "r.parquet")
    np.testing.assert_allclose(read.t - read.t[0], T, atol=2e-6)


@pytest.mark.parametrize("fixed", [True, False])
def test_lists_in_a_table_are_a_column_for_each_joint(fixed: bool, tmp_path: Path) -> None:
    kind = pa.list_(pa.float64(), N if fixed else -1)
    lists = {"timestamp": pa.array(T), "position": pa.array(list(Q), kind), "effort": pa.array(list(TAU), kind)}
    pq.write_table(pa.table(lists), tmp_path / "r.parquet")
    read = Recording.read(tmp_path / "r.parquet")
    np.testing.assert_allclose(read.joints("q"), Q)
    np.testing.assert_allclose(read.joints("tau"), TAU)
    short = [*TAU[:-1], TAU[-1][:3]]
    if not fixed:
        pq.write_table(pa.table({**lists, "effort": pa.array(short, kind)}), tmp_path / "r.parquet")
        with pytest.raises(InputError, match="lists"):
            Recording.read(tmp_path / "r.parquet")


@pytest.mark.parametrize("parts", [2, 4])
def test_recordings_one_after_another_are_joined(parts: int) -> None:
    t = np.concatenate([T + (3.0 if k == 1 else 0.0) for k in range(parts)])
    read = Recording.from_arrays(t, q=np.vstack([Q] * parts), tau=np.vstack([TAU] * parts))
    done = cleaned(read, KR6)
    joined = done.recording
    assert len(joined.t) == parts * ROWS
    assert np.all(np.diff(joined.t) > 0.0)
    assert np.count_nonzero(np.diff(joined.t) > 10.0 * STEP) == parts - 1
    assert any(text.startswith("joined: ") and f"sample {ROWS + 1}" in text for text in done.acts)


@pytest.mark.parametrize("lost", [0.0, 0.02])
def test_stamps_of_few_digits_are_put_on_a_clock(lost: float) -> None:
    keep = np.random.default_rng(3).random(ROWS) >= lost
    coarse = np.floor((1.7e9 + T[keep]) / 0.01 + 1e-6) * 0.01
    done = cleaned(Recording.from_arrays(coarse, q=Q[keep], tau=TAU[keep]), KR6)
    assert any(act.startswith("coarse-stamps") for act in done.acts)
    late = done.recording.t - 1.7e9 - T[keep]
    assert np.std(late) < (1e-4 if lost == 0.0 else 2e-3)


@pytest.mark.parametrize("place", [0, 400, ROWS - 1])
@pytest.mark.parametrize("stamp", [-1e6, 0.0, 1e7, "before"])
def test_a_handful_of_bad_stamps_is_left_out(place: int, stamp: float | str) -> None:
    t = 5e5 + T
    t[place] = t[max(place - 1, 0)] - 1e-4 * (place == 0) if stamp == "before" else stamp
    done = cleaned(Recording.from_arrays(t, q=Q, tau=TAU), KR6)
    # One a little before all others is a good one.
    assert any(act.startswith("bad-stamps: 1 ") for act in done.acts) == (stamp != "before" or place > 0)
    assert np.all(np.diff(done.recording.t) < 0.05)


@pytest.mark.parametrize("place", [1, 250, ROWS - 1])
@pytest.mark.parametrize("late", [False, True])
def test_of_two_samples_with_one_stamp_the_one_of_that_time_is_kept(place: int, late: bool) -> None:
    # A message bears the stamp of the one before it, or of the one after it.
    wrong = place - late
    t = 5e5 + T
    t[wrong] = t[place if late else place - 1]
    done = cleaned(Recording.from_arrays(t, q=Q, tau=TAU), KR6)
    assert any(act.startswith("bad-stamps: 1 samples") and f"sample {wrong + 1}," in act for act in done.acts)
    assert not any(act.startswith("irregular-sampling") for act in done.acts)


# Angles, brakes, dead channels.

@pytest.mark.parametrize("joint", [1, 4, 6])
@pytest.mark.parametrize("shift", [0.0, 2.2])
def test_wrapped_angles_go_on(joint: int, shift: float) -> None:
    q = Q.copy()
    q[:, joint - 1] += np.pi - Q[:, joint - 1].mean()
    arm = replace(KR6, q_min=np.full(N, -2 * np.pi), q_max=np.full(N, 2 * np.pi))
    wrapped = (q + shift + np.pi) % (2 * np.pi) - np.pi
    done = cleaned(Recording.from_arrays(T, q=wrapped, tau=TAU, q_c=q), arm)
    jumps = np.abs(np.diff(wrapped, axis=0)).max(axis=0) > np.pi
    assert {act.split()[1] for act in done.acts if act.startswith("wrapped")} == {
        f"q_{j + 1}" for j in np.flatnonzero(jumps)}
    clean = done.recording.joints("q")
    assert np.abs(np.diff(clean, axis=0)).max() < 0.1
    np.testing.assert_allclose(np.std(clean - q, axis=0), np.zeros(N), atol=1e-9)


@pytest.mark.parametrize("joints", [[2], [5], [1, 2, 3, 4, 5, 6]])
def test_positions_of_the_motor_are_said_with_the_gear_ratio(joints: list[int]) -> None:
    q, own = Q.copy(), [j - 1 for j in joints]
    q[:, own] *= KR6.gear_ratio[own]
    with pytest.raises(InputError, match=f"ratio {KR6.gear_ratio[1 if 2 in joints else 4]:g} "):
        cleaned(Recording.from_arrays(T, q=q, tau=TAU), KR6)


def test_a_wrist_that_was_turned_on_is_taken_and_degrees_are_not() -> None:
    arm = replace(KR6, q_min=np.full(N, -2 * np.pi), q_max=np.full(N, 2 * np.pi))
    q = Q + np.array([0, 0, 0, 0, 0, 8.0])
    done = cleaned(Recording.from_arrays(T, q=q, tau=TAU), arm)
    assert any(act.startswith("turned-on: q_6") for act in done.acts)
    with pytest.raises(InputError, match="degrees"):
        cleaned(Recording.from_arrays(T, q=np.degrees(Q), tau=TAU), arm)


@pytest.mark.parametrize("joint", [1, 5])
@pytest.mark.parametrize("value", [0.0, np.nan])
def test_a_channel_that_measures_nothing_does_not_end_the_file(joint: int, value: float) -> None:
    tau = TAU.copy()
    tau[:, joint - 1] = value
    done = cleaned(Recording.from_arrays(T, q=Q, tau=tau), KR6)
    assert np.all(done.recording.columns[f"tau_{joint}"] == 0.0)
    assert dead_joints(channel_findings(done.recording)) == [joint - 1]


@pytest.mark.parametrize("share", [0.05, 0.11])
def test_zeros_under_brakes_are_left_out_and_said(share: float) -> None:
    rest = round(share * ROWS)
    q, tau = np.vstack([np.repeat(Q[:1], rest, axis=0), Q]), np.vstack([np.zeros((rest, N)), TAU])
    recording = Recording.from_arrays(STEP * np.arange(rest + ROWS), q=q, tau=tau)
    done = cleaned(recording, KR6)
    assert len(done.recording.t) == ROWS
    assert any(act.startswith("brakes: ") for act in done.acts)


def test_a_fast_motor_is_no_jump() -> None:
    t = 0.001 * np.arange(4000)
    q = 30.0 * np.sin(t)[:, None] * np.ones(N)
    arm = replace(KR6, q_min=np.full(N, -np.inf), q_max=np.full(N, np.inf))
    assert not [act for act in cleaned(Recording.from_arrays(t, q=q, tau=np.tile(TAU, (5, 1))[:4000]), arm).acts
                if act.startswith("spike")]


# Bags.

TYPES = get_typestore(Stores.ROS2_HUMBLE)
TYPES.register(get_types_from_msg("""std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint reference
trajectory_msgs/JointTrajectoryPoint feedback
""", "control_msgs/msg/JointTrajectoryControllerState"))
STATE, LOOP, FORCE = ("sensor_msgs/msg/JointState", "control_msgs/msg/JointTrajectoryControllerState",
                      "geometry_msgs/msg/WrenchStamped")
NAMES = [f"joint_{i}" for i in range(1, N + 1)]
START = 1_700_000_000_000_000_000
Message = tuple[str, str, int, Any]


def header(stamp: int) -> Any:
    time = TYPES.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    return TYPES.types["std_msgs/msg/Header"](stamp=time, frame_id="")


def state(topic: str, k: int, names: list[str], q: Any, tau: Any, stamp: int | None = None) -> Message:
    at = START + round(1e9 * T[k])
    return topic, STATE, at + 300_000, TYPES.types[STATE](
        header=header(at if stamp is None else stamp), name=names, position=np.array(q, float), velocity=np.zeros(0),
        effort=np.array(tau, float))


def arm(topic: str = "/joint_states") -> Iterator[Message]:
    yield from (state(topic, k, NAMES, Q[k], TAU[k]) for k in range(ROWS))


def bag(path: Path, messages: Iterator[Message] | list[Message]) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics: dict[str, Any] = {}
        for topic, kind, stamp, message in sorted(messages, key=lambda one: one[2]):
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            writer.write(topics[topic], stamp, TYPES.serialize_cdr(message, kind))
    return path


def test_joints_beside_the_arms_are_left_out(tmp_path: Path) -> None:
    for k, names in enumerate((["grip", *NAMES], ["wheel_1", "wheel_2", *NAMES[::-1], "head"],
                               [*(f"robot_{name}" for name in NAMES), "grip"])):
        order = [next((i for i, own in enumerate(NAMES) if name.endswith(own)), None) for name in names]
        def row(values: np.ndarray, order: list[int | None] = order) -> list[float]:
            return [np.nan if i is None else values[i] for i in order]
        path = bag(tmp_path / str(k), [state("/joint_states", i, names, np.nan_to_num(row(Q[i])), row(TAU[i]))
                                       for i in range(ROWS)])
        done = cleaned(Recording.read(path), KR6)
        np.testing.assert_array_equal(done.recording.joints("q"), Q)
        np.testing.assert_array_equal(done.recording.joints("tau"), TAU)
        assert any(act.startswith("left-out: joints ") for act in done.acts)


@pytest.mark.parametrize("every", [1, 5])
def test_messages_of_other_joints_or_without_efforts_are_counted(every: int, tmp_path: Path) -> None:
    others = [state("/joint_states", k, ["grip"], [0.4], [1.0]) for k in range(0, ROWS, every)]
    read = Recording.read(bag(tmp_path / "grip", [*arm(), *others]))
    np.testing.assert_array_equal(read.joints("q"), Q)
    assert f"{len(others)} messages" in read.meta["reading"][0]
    empty = [state("/joint_states", k, NAMES, np.zeros(N), []) for k in range(0, ROWS, 5)]
    read = Recording.read(bag(tmp_path / "zeros", [*arm(), *empty]))
    np.testing.assert_array_equal(read.joints("q"), Q)
    assert f"{len(empty)} messages on /joint_states without efforts" in read.meta["reading"][0]


def test_two_namespaces_are_chosen_between(tmp_path: Path) -> None:
    both = [*arm("/left/joint_states"), *(state("/right/joint_states", k, NAMES, 0.5 * Q[k], TAU[k])
                                          for k in range(ROWS))]
    path = bag(tmp_path / "two", both)
    with pytest.raises(InputError, match=r"/left/joint_states, /right/joint_states.*--topic"):
        Recording.read(path)
    np.testing.assert_array_equal(Recording.read(path, topic="/right/joint_states").joints("q"), 0.5 * Q)
    np.testing.assert_array_equal(Recording.read(path, topic="left", joints=NAMES[2:4]).joints("q"), Q[:, 2:4])


@pytest.mark.parametrize("name", ["arm.mcap", "arm_2024_0.mcap"])
def test_a_bag_whose_files_were_renamed_is_read(name: str, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", list(arm()))
    next(folder.glob("*.mcap")).rename(folder / name)
    read = Recording.read(folder)
    np.testing.assert_allclose(read.joints("q"), Q)
    assert any(text.startswith("renamed: ") and name in text for text in read.meta["reading"])


def test_unstamped_messages_have_the_stamp_of_the_log(tmp_path: Path) -> None:
    messages = list(arm())
    for k in (10, 300):
        messages[k] = state("/joint_states", k, NAMES, Q[k], TAU[k], stamp=0)
    read = Recording.read(bag(tmp_path / "bare", messages))
    np.testing.assert_allclose(read.t, T, atol=1e-8)
    assert read.meta["reading"][0].startswith("unstamped: 2 of 900")


def test_a_controllers_reference_is_the_command_and_its_wrench_is_read(tmp_path: Path) -> None:
    Point, Vector = TYPES.types["trajectory_msgs/msg/JointTrajectoryPoint"], TYPES.types["geometry_msgs/msg/Vector3"]
    duration = TYPES.types["builtin_interfaces/msg/Duration"](sec=0, nanosec=0)

    def point(q: np.ndarray) -> Any:
        return Point(positions=q.copy(), velocities=np.zeros(0), accelerations=np.zeros(0), effort=np.zeros(0),
                     time_from_start=duration)

    def loop(k: int) -> Message:
        stamp = START + round(1e9 * T[k])
        return "/arm/state", LOOP, stamp + 1, TYPES.types[LOOP](
            header=header(stamp), joint_names=NAMES[::-1], reference=point(Q[k, ::-1] + 0.01),
            feedback=point(Q[k, ::-1]))

    def force(k: int) -> Message:
        stamp = START + round(1e9 * T[k])
        wrench = TYPES.types["geometry_msgs/msg/Wrench"](force=Vector(float(k), 2.0, 3.0), torque=Vector(4.0, 5.0, 6.0))
        return "/ft", FORCE, stamp + 2, TYPES.types[FORCE](header=header(stamp), wrench=wrench)

    read = Recording.read(bag(tmp_path / "led", [*arm(), *map(loop, range(ROWS)), *map(force, range(0, ROWS, 3))]))
    np.testing.assert_allclose(read.joints("q_c"), Q + 0.01)
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(read.columns["fx"])), np.arange(0, ROWS, 3))
    assert {"q_c_i from /arm/state", "fx to mz from /ft"} == set(
        read.meta["reading"][0].removeprefix("beside: ").split(", "))
    alone = Recording.read(bag(tmp_path / "alone", [loop(k) for k in range(ROWS)]))
    np.testing.assert_allclose(alone.joints("q"), Q[:, ::-1])
    assert alone.meta["joints"] == NAMES[::-1]


@pytest.mark.parametrize("share", [0.3, 0.7, 0.97])
def test_what_a_killed_recorder_left_is_read(share: float, tmp_path: Path) -> None:
    whole = next(bag(tmp_path / "whole", arm()).glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: int(share * len(whole))])
    read = Recording.read(cut)
    assert len(read.t) > 0.9 * share * ROWS * 0.9
    np.testing.assert_array_equal(read.joints("q"), Q[: len(read.t)])
    assert read.meta["reading"][0].startswith("cut: ")
    cut.write_bytes(whole[:60])
    with pytest.raises(InputError):
        Recording.read(cut)


def test_what_export_writes_comes_back_whole(tmp_path: Path) -> None:
    given = Recording.from_arrays(T, q=Q, tau=TAU, q_c=Q + 0.1, q_d=Q + 0.2, qa=Q + 0.3)
    back = Recording.read(write_mcap(given, tmp_path / "r.mcap"))
    for key in ("q", "tau", "q_c", "q_d", "qa"):
        np.testing.assert_allclose(back.joints(key), given.joints(key))
