"""Recordings survive being written and read, from every kind of file, and say clearly what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording


@pytest.fixture
def recording() -> Recording:
    t = np.arange(200) * 0.01
    rng = np.random.default_rng(4)
    return Recording.from_arrays(t, q=rng.normal(size=(200, 3)), tau=rng.normal(size=(200, 3)), meta={"robot": "x"})


@pytest.mark.parametrize("name", ["a.parquet", "a.csv"])
def test_written_and_read(recording: Recording, tmp_path: Path, name: str) -> None:
    back = Recording.read(recording.write(tmp_path / "new" / name))
    assert back.n == 3
    np.testing.assert_array_equal(back.joints("q"), recording.joints("q"))
    assert not list((tmp_path / "new").glob("*.part"))


def test_metadata_and_hash_survive_parquet(recording: Recording, tmp_path: Path) -> None:
    back = Recording.read(recording.write(tmp_path / "a.parquet"))
    assert back.meta["robot"] == "x"
    assert back.hash == recording.hash


def test_unknown_columns_are_kept(recording: Recording, tmp_path: Path) -> None:
    more = Recording({**recording.columns, "weather": np.ones(200)})
    assert "weather" in Recording.read(more.write(tmp_path / "a.parquet")).columns


def write_bag(path: Path, plugin: str, names: list[str], positions: np.ndarray, efforts: np.ndarray,
              shuffle_from: int | None = None) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    message, header, stamp = (types.types[key] for key in (
        "sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"))
    with Writer(path, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        connection = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=types)
        for k, (q, tau) in enumerate(zip(positions, efforts, strict=True)):
            time = 1_700_000_000_000_000_000 + k * 2_000_000
            order = list(range(len(names)))
            if shuffle_from is not None and k >= shuffle_from:
                order.reverse()
            state = message(header(stamp(time // 10**9, time % 10**9), ""), [names[i] for i in order], q[order],
                            np.zeros(0), tau[order])
            writer.write(connection, time + 500, types.serialize_cdr(state, "sensor_msgs/msg/JointState"))
    return path


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
def test_joint_states_from_a_bag(tmp_path: Path, plugin: str) -> None:
    rng = np.random.default_rng(8)
    q, tau = rng.normal(size=(2, 50, 3))
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


def test_columns_cannot_be_changed(recording: Recording) -> None:
    with pytest.raises(ValueError):
        recording.columns["t"][0] = 1.0


def test_true_and_false_are_no_torque() -> None:
    with pytest.raises(InputError, match="tau_1: column holds true and false"):
        Recording({"t": np.arange(4.0), "tau_1": np.array([True, False, True, True])})
    assert Recording({"t": np.arange(2.0), "touched": np.array([True, False])}).columns["touched"].dtype == bool
