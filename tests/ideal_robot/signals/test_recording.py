"""Recordings survive being written and read, from every kind of file, and say clearly what is wrong with them."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from rosbags.highlevel import AnyReader

from ideal_robot.errors import InputError
from ideal_robot.row_log import KEPT, finished, in_file, let_go, new_columns
from ideal_robot.signals import sampling as module
from ideal_robot.signals import table_file
from ideal_robot.signals.export import write_mcap, write_rosbag2
from ideal_robot.signals.plausible import text_columns
from ideal_robot.signals.recording import WRITTEN_ROWS, Recording, short_names
from ideal_robot.signals.sampling import shortened, stretches, uniform_time


@pytest.fixture
def recording() -> Recording:
    t = np.arange(200) * 0.01
    rng = np.random.default_rng(4)
    return Recording.from_arrays(t, q=rng.normal(size=(200, 3)), tau=rng.normal(size=(200, 3)), meta={"robot": "x"})


def write_bag(path: Path, plugin: str, names: list[str], positions: np.ndarray, efforts: np.ndarray,
              shuffle_from: int | None = None, compression: str = "") -> Path:
    """Joint states, 2 ms apart; efforts ``(N, 0)`` for none."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    message, header, stamp = (types.types[key] for key in (
        "sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"))
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[plugin])
    if compression:
        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=types)
        for k, (q, tau) in enumerate(zip(positions, efforts, strict=True)):
            time = 1_700_000_000_000_000_000 + k * 2_000_000
            order = list(range(len(names)))
            if shuffle_from is not None and k >= shuffle_from:
                order.reverse()
            state = message(header(stamp(time // 10**9, time % 10**9), ""), [names[i] for i in order], q[order],
                            np.zeros(0), tau[order] if len(tau) else tau)
            writer.write(connection, time + 500, types.serialize_cdr(state, "sensor_msgs/msg/JointState"))
    return path


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_joint_states_from_a_bag(tmp_path: Path, plugin: str) -> None:
    q, tau = np.random.default_rng(8).normal(size=(2, 50, 3))
    bag = write_bag(tmp_path / "bag", plugin, ["b", "a", "c"], q, tau, shuffle_from=20)
    for path in [bag, *bag.glob("*.mcap")]:
        recording = Recording.read(path)
        np.testing.assert_allclose(recording.t, np.arange(50) * 0.002, atol=1e-9)
        np.testing.assert_array_equal(recording.joints("q"), q)
        np.testing.assert_array_equal(recording.joints("tau"), tau)
        assert recording.meta["joints"] == ["b", "a", "c"]


@pytest.mark.parametrize(("rows", "names", "says"), [(0, ["a", "b"], "no messages"), (5, ["a", "a"], "same name")])
def test_a_bag_without_messages_or_with_one_name_twice_is_refused(tmp_path: Path, rows: int, names: list[str],
                                                                  says: str) -> None:
    bag = write_bag(tmp_path / "bag", "SQLITE3", names, np.zeros((rows, 2)), np.zeros((rows, 2)))
    with pytest.raises(InputError, match=says):
        Recording.read(bag)


def test_errors_name_file_and_field(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such recording"):
        Recording.read(tmp_path / "none.parquet")
    broken = tmp_path / "broken.parquet"
    broken.write_text("not parquet")
    with pytest.raises(InputError, match=r"broken\.parquet"):
        Recording.read(broken)
    words = tmp_path / "words.csv"
    words.write_text("t,q_1\n0,here\n1,there\n")
    with pytest.raises(InputError, match="q_1"):
        Recording.read(words)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="bag"):
        Recording.read(tmp_path / "empty")
    with pytest.raises(InputError, match="tau_3"):
        Recording({k: v for k, v in recording.columns.items() if k != "tau_3"}).joints("tau")


@pytest.mark.parametrize("ending", [".parquet", ".csv"])
def test_a_comment_beside_the_signals_is_left_out_and_told(recording: Recording, tmp_path: Path,
                                                           monkeypatch: pytest.MonkeyPatch, ending: str) -> None:
    monkeypatch.setattr(table_file, "PIECE", 500)
    frame = pd.DataFrame(recording.columns).assign(program=["1"] * 150 + ["approach"] * 50)
    place = tmp_path / f"r{ending}"
    if ending == ".csv":
        frame.to_csv(place, index=False)
    else:
        frame.set_index("t").to_parquet(place)
    for read in (Recording.read(place), Recording.from_frame(frame)):
        assert read.columns.keys() == recording.columns.keys()
        np.testing.assert_allclose(read.joints("tau"), recording.joints("tau"), rtol=1e-12)
        assert text_columns(read) == ["text-column: program not of numbers, left out"]
    # The file that is written of it holds none, and its reader is told none.
    assert not text_columns(Recording.read(read.write(tmp_path / "again.parquet")))


def test_true_and_false_are_no_torque() -> None:
    with pytest.raises(InputError, match="tau_1: column holds true and false"):
        Recording({"t": np.arange(4.0), "tau_1": np.array([True, False, True, True])})
    assert Recording({"t": np.arange(2.0), "touched": np.array([True, False])}).columns["touched"].dtype == bool


# Recordings longer than memory should hold: their columns are in a file, and they are written piece by piece.

def stored_recording(length: int) -> Recording:
    columns = new_columns(["t", "q_1"], length)
    for first in range(0, length, 5000):
        rows = np.arange(first, min(first + 5000, length))
        columns["t"][rows] = 0.002 * rows
        columns["q_1"][rows] = np.where(rows % 7 == 0, np.nan, np.sin(rows))
        let_go(columns["t"])
    return Recording(finished(columns))


@pytest.mark.parametrize("length", [100, KEPT, KEPT + 1, 3 * KEPT])
def test_columns_are_the_same_wherever_they_are(length: int) -> None:
    stored = stored_recording(length)
    rows = np.arange(length)
    plain = Recording.from_arrays(0.002 * rows, q=np.where(rows % 7 == 0, np.nan, np.sin(rows))[:, None])
    assert stored.hash == plain.hash
    # Of a long one nothing is copied into memory.
    assert all(in_file(column) for column in stored.columns.values()) == (length > KEPT)
    with pytest.raises(ValueError, match="read-only"):
        stored.columns["q_1"][0] = 1.0


def test_an_ending_in_capitals_is_the_same_one(recording: Recording, tmp_path: Path) -> None:
    small = recording.write(tmp_path / "r.csv")
    again = Recording.read(small.rename(tmp_path / "R.CSV"))
    np.testing.assert_allclose(again.joints("q"), recording.joints("q"), atol=1e-8)


@pytest.mark.parametrize("ending", [".parquet", ".csv"])
def test_long_recordings_are_written_in_pieces(tmp_path: Path, ending: str) -> None:
    stored = stored_recording(2 * WRITTEN_ROWS + 10)
    place = stored.write(tmp_path / f"long{ending}")
    if ending == ".parquet":
        assert pq.ParquetFile(place).num_row_groups == 3
    read = Recording.read(place)
    for name, values in stored.columns.items():
        np.testing.assert_array_equal(read.columns[name], values)


# Very long recordings are read piece by piece, and stretches of them are used.

def long_recording(length: int, source: str = "a") -> Recording:
    rows = np.arange(length)
    return Recording.from_arrays(0.002 * rows, q=np.sin(rows)[:, None], source=source,
                                 tau=np.where(rows % 7 == 0, np.nan, rows)[:, None], meta={"robot": "kr15"})


def test_recordings_of_normal_length_are_used_as_they_are() -> None:
    recordings = (long_recording(1000), long_recording(10))
    used, warnings = stretches(recordings)
    assert all(stretch is other for stretch, other in zip(used, recordings, strict=True))
    assert not warnings


def test_of_long_ones_stretches_from_begin_to_end_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST", 10_000)
    monkeypatch.setattr(module, "STRETCH", 1000)
    monkeypatch.setattr(module, "FEWEST", 200)
    used, (warning,) = stretches([long_recording(50_000), long_recording(100, "short")])
    assert warning.startswith("long-recording: of 50100 samples")
    long, short = used[:-1], used[-1]
    assert len(long) == 9
    assert all(len(stretch.t) == 1000 for stretch in long)
    assert long[0].t[0] == 0.0
    assert long[-1].t[-1] == pytest.approx(0.002 * 49_999)
    assert len(short.t) == 100
    assert short.source.startswith("short")
    np.testing.assert_array_equal(long[3].columns["q_1"], np.sin(np.rint(long[3].t / 0.002)))


@pytest.mark.parametrize("ending", [".parquet", ".csv"])
def test_a_table_read_piece_by_piece_is_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str) -> None:
    place = long_recording(40_000).write(tmp_path / f"r{ending}")
    whole = Recording.read(place)
    monkeypatch.setattr(table_file, "AT_ONCE", 1000)
    monkeypatch.setattr(table_file, "PIECE", 49_000)
    pieces = Recording.read(place)
    assert not in_file(whole.t)
    assert in_file(pieces.t)
    assert pieces.hash == whole.hash
    assert pieces.meta == whole.meta


def test_a_word_far_down_a_long_table_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_file, "AT_ONCE", 100)
    monkeypatch.setattr(table_file, "PIECE", 100)
    lines = [f"{0.002 * i},{i}" for i in range(500)]
    lines[444] = "0.888,broken"
    place = tmp_path / "r.csv"
    place.write_text("t,q_1\n" + "\n".join(lines) + "\n")
    with pytest.raises(InputError, match="not numeric"):
        Recording.read(place)


def test_stretches_of_one_recording_follow_each_other_after_a_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a diagnosis works on; the camera's stamps stay with their samples."""
    monkeypatch.setattr(module, "MOST", 10_000)
    monkeypatch.setattr(module, "STRETCH", 1000)
    long = long_recording(50_000)
    assert shortened(long_recording(9_000))[1] == []
    long = replace(long, columns={**long.columns, "cam_t": long.t - 0.04})
    used, (warning,) = shortened(long)
    assert warning.startswith("long-recording: of 50000 samples 10000 are used")
    assert len(used.t) == 10_000
    steps = np.diff(used.t)
    assert np.count_nonzero(steps > 0.01) == 9
    np.testing.assert_allclose(steps[steps > 0.01], 0.9)
    np.testing.assert_allclose(used.t - used.columns["cam_t"], 0.04)
    np.testing.assert_array_equal(used.columns["q_1"][-1000:], long.columns["q_1"][-1000:])
    uniform, hole = uniform_time(used)
    assert len(uniform) < 15_000
    assert np.count_nonzero(np.diff(hole.astype(int)) == 1) == 9


# What is written as a bag is read back by the library that others read bags with.

RNG = np.random.default_rng(0)
T = 0.012 * np.arange(50.0)
QUATERNION = np.tile([0.0, 0.0, 0.0, 1.0], (50, 1))
RECORDING = Recording.from_arrays(
    T, q=RNG.normal(size=(50, 6)), tau=RNG.normal(size=(50, 6)), q_c=RNG.normal(size=(50, 6)), x=T, y=T, z=T,
    qx=QUATERNION[:, 0], qy=QUATERNION[:, 1], qz=QUATERNION[:, 2], qw=QUATERNION[:, 3],
    **{name: np.where(np.arange(50) % 2, T, np.nan) for name in ("fx", "fy", "fz", "mx", "my", "mz")})


@pytest.mark.parametrize("mcap", [True, False])
def test_joint_states_come_back_as_they_were(mcap: bool, tmp_path: Path) -> None:
    path = write_mcap(RECORDING, tmp_path / "run.mcap") if mcap else write_rosbag2(RECORDING, tmp_path / "run")
    back = Recording.read(path)
    np.testing.assert_allclose(back.t, RECORDING.t, atol=1e-9)
    np.testing.assert_array_equal(back.joints("q"), RECORDING.joints("q"))
    np.testing.assert_array_equal(back.joints("tau"), RECORDING.joints("tau"))
    with AnyReader([path]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts == {"/joint_states": 50, "/joint_commands": 50, "/tcp": 50, "/wrench": 25}
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_names_that_cannot_be_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.mcap"):
        write_mcap(RECORDING, tmp_path / "run.bag")
    (tmp_path / "there").mkdir()
    with pytest.raises(InputError, match="does not exist"):
        write_rosbag2(RECORDING, tmp_path / "there")
    with pytest.raises(InputError, match="no joints"):
        write_mcap(Recording.from_arrays(T, x=T), tmp_path / "run.mcap")
    with pytest.raises(InputError, match="no rows"):
        write_mcap(Recording({"t": T[:0], "q_1": T[:0]}), tmp_path / "run.mcap")


def test_names_of_joints_that_are_none_are_not_taken(tmp_path: Path) -> None:
    back = Recording.read(write_mcap(Recording(RECORDING.columns, {"joints": 3}), tmp_path / "run.mcap"))
    assert back.meta["joints"] == [f"joint_{i + 1}" for i in range(6)]


@pytest.mark.parametrize("t", [-T[::-1], T[::-1], 1e300 * T, 1.7e18 + 1e7 * T])
def test_times_that_no_stamp_holds_are_refused(t: np.ndarray, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="give t in seconds"):
        write_mcap(Recording.from_arrays(t, q=np.zeros((50, 2))), tmp_path / "run.mcap")
    assert not list(tmp_path.iterdir())


def test_a_spreadsheet_shows_columns_titles_as_they_stand(tmp_path: Path) -> None:
    """Titles come from files of others, and a spreadsheet would reckon with some of them."""
    formulas = ("=1+1|cmd", "+1", "-1", "@sum", "\tq", "q_1")
    place = Recording({"t": np.arange(3.0), **{name: np.zeros(3) for name in formulas}}).write(tmp_path / "r.csv")
    with place.open(newline="") as file:
        titles, *rows = csv.reader(file)
    assert titles == ["t", "'=1+1|cmd", "'+1", "'-1", "'@sum", "'\tq", "q_1"]
    assert [row[0] for row in rows] == ["0.0", "1.0", "2.0"]


@pytest.mark.parametrize(("sources", "names"), [
    (["out/plan/r.parquet", "out/other/r.parquet"], ["plan/r.parquet", "other/r.parquet"]),
    (["a/x/r.csv", "b/x/r.csv", "b/x/s.csv"], ["a/x/r.csv", "b/x/r.csv", "s.csv"]),
    (["r.csv", "r.csv"], ["r.csv", "r.csv"]), (["here/r.csv"], ["r.csv"]), (["", "play"], ["", "play"]),
])
def test_recordings_that_are_called_alike_are_named_with_their_folders(sources: list[str], names: list[str]) -> None:
    assert short_names(sources) == names
