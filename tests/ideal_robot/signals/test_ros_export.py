"""What is written as a bag is read back by the library that others read bags with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording
from ideal_robot.signals.ros_export import write_mcap, write_rosbag2

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
    assert [one.name for one in tmp_path.iterdir()] == [path.name]


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
    told = Recording(RECORDING.columns, {"joints": 3})
    back = Recording.read(write_mcap(told, tmp_path / "run.mcap"))
    assert back.meta["joints"] == [f"joint_{i + 1}" for i in range(6)]


@pytest.mark.parametrize("t", [-T[::-1], T[::-1], 1e300 * T, 1.7e18 + 1e7 * T])
def test_times_that_no_stamp_holds_are_refused(t: np.ndarray, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="give t in seconds"):
        write_mcap(Recording.from_arrays(t, q=np.zeros((50, 2))), tmp_path / "run.mcap")
    assert not list(tmp_path.iterdir())
