"""The recording of a line-following run: what the controller logged, what was desired, what the camera said."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from ideal_robot.signals.recording import Recording
from scenes.line.scene import LineScene
from sensing.camera.camera_model import CameraModel
from sensing.camera.line_detection import LineField
from sim.arm.arm import SimulatedArm


def line_recording(arm: SimulatedArm, scene: LineScene, method: str, t: Array, q_d: Array, fields: Sequence[LineField],
                   failure: str | None, camera: CameraModel) -> Recording:
    """The arm's own recording with columns added.

    ``q_d_i`` desired arm angles; for each camera field, in the row at its time stamp and NaN elsewhere: ``cam_t`` [s]
    and the line points in the tool frame ``line_x_i line_y_i line_z_i`` [m] (points that were left out are NaN).

    Args:
        arm: the arm after the run.
        scene: noted in the metadata.
        method: its key, noted in the metadata.
        t: begins of the cycles ``(K,)`` [s].
        q_d: desired angles at them ``(K, n)`` [rad].
        fields: the camera fields that arrived.
        failure: why the run ended early, noted in the metadata.
        camera: as it is believed to be; where its optical axis meets the surface, and how far away, is noted.
    """
    recording = arm.recording(external=scene.tracker)
    columns: dict[str, Array] = dict(recording.columns)
    rows = recording.t
    for i in range(q_d.shape[1]):
        columns[f"q_d_{i + 1}"] = np.interp(rows, t, q_d[:, i])
    stamps = np.full(len(rows), np.nan)
    points = np.full((len(rows), scene.points, 3), np.nan)
    for seen in fields:
        row = min(int(np.searchsorted(rows, seen.t)), len(rows) - 1)
        stamps[row] = seen.t
        points[row, seen.used] = seen.points_tcp[seen.used]
    columns["cam_t"] = stamps
    for i in range(scene.points):
        for axis, name in enumerate("xyz"):
            columns[f"line_{name}_{i + 1}"] = points[:, i, axis].copy()
    meta: dict[str, Any] = {**recording.meta, "scene": scene.name, "method": method, "speed": scene.speed,
                            "seed": scene.seed, "stopped_because": failure}
    mount = camera.T_tool_camera
    distance = -mount.translation[2] / mount.rotation[2, 2]
    meta["camera"] = {"axis": [float(v) for v in camera.axis_on_surface],
                      "distance": float(distance)}
    return dataclasses.replace(recording, columns=columns, meta=meta)
