"""Writes recordings as files of other programs: ROS 2 bags and MCAP through ``rosbags``, without ROS; and Rerun.

Topics: ``/joint_states`` (measured position and torque), ``/joint_commands`` and ``/joint_desired`` (positions),
``/arm_states`` (arm angles), ``/tcp`` (pose of the TCP) and ``/wrench``, each where the recording has the columns.
"""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.signals.recording import POSE, WRENCH, Recording
from ideal_robot.whole_file import OutputError, whole_file

_STATE, _TCP, _WRENCH = "sensor_msgs/msg/JointState", "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"
_LAST = 2.0**31
"""Seconds that a stamp of ROS 2 can hold."""
_ANGLES = {"/joint_commands": "q_c", "/joint_desired": "q_d", "/arm_states": "qa"}


def write_mcap(recording: Recording, path: str | Path) -> Path:
    """Writes one MCAP file, times from the recording's own; what was there before stays until the new one is whole.

    Raises:
        InputError: an ending that is not ``.mcap``, or a recording without joints.
        OutputError: it cannot be written, e.g. the disk is full.
    """
    path = Path(path)
    if path.suffix != ".mcap":
        raise InputError("expected a name ending in .mcap", field="path", value=str(path))
    with whole_file(path) as partial, tempfile.TemporaryDirectory(dir=path.parent, prefix=".mcap_") as folder:
        bag = _write(recording, Path(folder) / "bag", mcap=True)
        next(bag.glob("*.mcap")).replace(partial)
    return path


def write_rosbag2(recording: Recording, path: str | Path) -> Path:
    """Writes one MCAP file with the recording's own times; an old file stays until the new one is complete.

    Raises:
        InputError: something of that name exists, or a recording without joints.
        OutputError: it cannot be written, e.g. the disk is full.
    """
    path = Path(path)
    if path.exists():
        raise InputError("a bag is a new folder; choose a name that does not exist", field="path", value=str(path))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".bag_") as folder:
            _write(recording, Path(folder) / path.name, mcap=False).rename(path)
    except (OSError, sqlite3.Error) as error:
        raise OutputError.of(path, error) from error
    return path


def _write(recording: Recording, folder: Path, *, mcap: bool) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    if recording.n == 0:
        raise InputError("the recording has no joints q_1, q_2, …", file=recording.source, field="q_1")
    if len(recording.t) == 0:
        raise InputError("the recording has no rows", file=recording.source, field="t")
    if not (recording.t[0] >= 0.0 and np.all(np.diff(recording.t) >= 0.0) and recording.t[-1] < _LAST):
        raise InputError("ROS 2 takes times that rise, from 0 to 2^31 s; give t in seconds", file=recording.source,
                         field="t", value=[float(recording.t[0]), float(recording.t[-1])])
    store = get_typestore(Stores.ROS2_HUMBLE)
    stamps = np.round(recording.t * 1e9).astype(np.int64)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        for topic, kind, message in _topics(recording, store):
            connection = writer.add_connection(topic, kind, typestore=store)
            for k, stamp in enumerate(stamps):
                content = message(k, int(stamp))
                if content is not None:
                    writer.write(connection, int(stamp), store.serialize_cdr(content, kind))
    return folder


def _topics(recording: Recording, store: Any) -> Iterator[tuple[str, str, Callable[[int, int], Any]]]:
    """Topic, message type and the maker of message k."""
    types = store.types
    Time, Header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    listed = recording.meta.get("joints")
    names = [str(name) for name in listed] if isinstance(listed, (list, tuple)) else []
    if len(names) != recording.n:
        names = [f"joint_{i + 1}" for i in range(recording.n)]

    def header(stamp: int, frame: str) -> Any:
        return Header(stamp=Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000), frame_id=frame)

    def joints(position: Array, effort: Array | None) -> Callable[[int, int], Any]:
        nothing = np.empty(0)

        def message(k: int, stamp: int) -> Any:
            return types[_STATE](header=header(stamp, "base"), name=names, position=position[k], velocity=nothing,
                                      effort=nothing if effort is None else effort[k])

        return message

    yield ("/joint_states", _STATE,
           joints(recording.joints("q"), recording.joints("tau") if recording.has("tau") else None))
    for topic, prefix in _ANGLES.items():
        if recording.has(prefix):
            yield topic, _STATE, joints(recording.joints(prefix), None)
    if all(name in recording.columns for name in POSE):
        pose = np.column_stack([recording.columns[name] for name in POSE])
        yield "/tcp", _TCP, lambda k, stamp: None if np.isnan(pose[k]).any() else types[_TCP](
            header=header(stamp, "base"), pose=types["geometry_msgs/msg/Pose"](
                position=types["geometry_msgs/msg/Point"](*pose[k, :3].tolist()),
                orientation=types["geometry_msgs/msg/Quaternion"](*pose[k, 3:].tolist())))
    if all(name in recording.columns for name in WRENCH):
        wrench = np.column_stack([recording.columns[name] for name in WRENCH])
        vector = types["geometry_msgs/msg/Vector3"]
        yield "/wrench", _WRENCH, lambda k, stamp: None if np.isnan(wrench[k]).any() else types[_WRENCH](
            header=header(stamp, "force_sensor"), wrench=types["geometry_msgs/msg/Wrench"](
                force=vector(*wrench[k, :3].tolist()), torque=vector(*wrench[k, 3:].tolist())))


# A recording as a Rerun file: every signal over time, and the tool's path in space.

def write_rerun(recording: Recording, path: Path) -> Path:
    """Writes a ``.rrd`` file; an old file stays until the new one is complete.

    Each column becomes the entity ``prefix/joint`` or its own name. Raises InputError for another ending, or where
    Rerun is not installed.
    """
    if path.suffix != ".rrd":
        raise InputError("expected a name ending in .rrd", field="--rerun", value=str(path))
    try:
        import rerun as rr
    except ImportError as error:
        raise InputError("needs the package rerun-sdk (pip install 'ideal-robot[rerun]')", field="--rerun") from error
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.partial")
    stream: Any = rr.RecordingStream("ideal-robot")
    stream.save(str(partial))
    times = [rr.TimeColumn("time", duration=recording.t)]
    for name, values in recording.columns.items():
        if name == "t":
            continue
        prefix, _, joint = name.rpartition("_")
        entity = f"{prefix}/{joint}" if prefix and joint.isdigit() else name
        stream.send_columns(entity, times, rr.Scalars.columns(scalars=values))
    if all(axis in recording.columns for axis in "xyz"):
        place = np.column_stack([recording.columns[axis] for axis in "xyz"])
        finite = np.isfinite(place).all(axis=1)
        stream.log("tool/path", rr.LineStrips3D([place[finite]]), static=True)
        stream.send_columns("tool/now", [rr.TimeColumn("time", duration=recording.t[finite])],
                            rr.Points3D.columns(positions=place[finite]))
    stream.flush()
    stream.disconnect()
    partial.replace(path)
    return path
