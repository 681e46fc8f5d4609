"""A recording as a Rerun file: every signal over time, and the tool's path in space."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording


def write_rerun(recording: Recording, path: Path) -> Path:
    """Writes a ``.rrd`` file; what was there before stays until the new one is whole.

    Args:
        recording: what is written; each column becomes the entity ``prefix/joint`` or its own name.
        path: ending in ``.rrd``.

    Raises:
        InputError: another ending, or Rerun is not installed.
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
        there = np.isfinite(place).all(axis=1)
        stream.log("tool/path", rr.LineStrips3D([place[there]]), static=True)
        stream.send_columns("tool/now", [rr.TimeColumn("time", duration=recording.t[there])],
                            rr.Points3D.columns(positions=place[there]))
    stream.flush()
    stream.disconnect()
    partial.replace(path)
    return path
