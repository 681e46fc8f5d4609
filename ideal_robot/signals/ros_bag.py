"""Joint states out of ROS 2 bags and MCAP files, through ``rosbags``; no ROS needed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError

SUFFIXES = (".mcap", ".db3", ".bag")
_TYPE = "sensor_msgs/msg/JointState"


def read_joint_states(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """Columns ``t``, ``q_i`` and, where given, ``qd_i`` and ``tau_i`` (effort) of the ``JointState`` messages in a bag.

    Time is that of the messages' headers, of the log where these are empty, and starts at zero. Joints are numbered in
    the order of the first message; their names stand in the metadata under ``joints``. The topic is ``/joint_states``,
    or the only one of its type.

    Args:
        path: folder of a ROS 2 bag, or a single ``.mcap``, ``.db3`` or ROS 1 ``.bag`` file.

    Raises:
        InputError: not a bag, no joint states in it, or messages that name other joints.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
            connections = [c for c in reader.connections if c.msgtype == _TYPE]
            topics = sorted({c.topic for c in connections})
            if not topics:
                found = ", ".join(sorted({c.msgtype for c in reader.connections})) or "nothing"
                raise InputError(f"no {_TYPE} messages; the bag holds {found}", file=path)
            topic = "/joint_states" if "/joint_states" in topics else topics[0]
            if len(topics) > 1 and topic != "/joint_states":
                raise InputError(f"several topics of joint states ({', '.join(topics)}) and none is /joint_states",
                                 file=path)
            messages = [(stamp, reader.deserialize(raw, connection.msgtype))
                        for connection, stamp, raw in reader.messages([c for c in connections if c.topic == topic])]
    except InputError:
        raise
    except Exception as error:  # a damaged bag can fail anywhere in the reader
        raise InputError(f"not a readable bag ({error})", file=path) from error
    return _columns(messages, path, topic)


def _columns(messages: list[tuple[int, Any]], path: Path, topic: str) -> tuple[dict[str, Array], dict[str, Any]]:
    if not messages:
        raise InputError(f"no messages on {topic}; record them while the arm moves", file=path)
    names = list(messages[0][1].name)
    if len(set(names)) < len(names):
        raise InputError(f"joints of the same name ({', '.join(names)})", file=path, field="name")
    order = {name: i for i, name in enumerate(names)}
    stamps = np.array([m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for _, m in messages])
    if not np.any(stamps):
        stamps = np.array([stamp for stamp, _ in messages])
    columns: dict[str, Array] = {"t": (stamps - stamps[0]) * 1e-9}
    for key, attribute in (("q", "position"), ("qd", "velocity"), ("tau", "effort")):
        if len(getattr(messages[0][1], attribute)) != len(names):
            continue
        values = np.full((len(messages), len(names)), np.nan)
        for k, (_, message) in enumerate(messages):
            given = getattr(message, attribute)
            if len(given) != len(names) or set(message.name) != set(names):
                raise InputError(f"message {k + 1} on {topic} names other joints than the first "
                                 f"({', '.join(message.name)})", file=path, field=attribute)
            values[k, [order[name] for name in message.name]] = given
        columns.update({f"{key}_{i + 1}": np.ascontiguousarray(values[:, i]) for i in range(len(names))})
    return columns, {"joints": names, "topic": topic, "stamp_0": int(stamps[0])}
