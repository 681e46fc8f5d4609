"""The recording of a line-following run: what the controller logged, what was desired, what the camera said."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from ideal_robot.signals.column_store import ColumnStore
from ideal_robot.signals.recording import Recording
from scenes.line.log import LineLog, field_columns
from scenes.line.scene import LineScene
from sensing.camera.camera_model import CameraModel
from sim.arm.arm import SimulatedArm


def line_recording(arm: SimulatedArm, scene: LineScene, method: str, log: LineLog, camera: CameraModel) -> Recording:
    """The arm's own recording with columns added.

    ``q_d_i`` desired arm angles; for each camera field, in the row at its time stamp and NaN elsewhere: ``cam_t`` [s]
    and the line points in the tool frame ``line_x_i line_y_i line_z_i`` [m] (points that were left out are NaN).

    Args:
        arm: the arm after the run.
        scene: noted in the metadata.
        method: its key, noted in the metadata.
        log: of the run; why it ended early is noted in the metadata.
        camera: as it is believed to be; where its optical axis meets the surface, and how far away, is noted.
    """
    recording = arm.recording(external=scene.tracker)
    rows, t, q_d = recording.t, np.asarray(log.t), np.asarray(log.q_d)
    desired = [f"q_d_{i + 1}" for i in range(q_d.shape[1])]
    store = ColumnStore([*desired, *field_columns(scene.points)], len(rows))
    for name, angle in zip(desired, q_d.T, strict=True):
        store.fill(name, 0, np.interp(rows, t, angle))
        store.release()
    for name, values in log.field_columns(rows, scene.points):
        store.fill(name, 0, values)
        store.release()
    columns = {**recording.columns, **store.finished()}
    meta: dict[str, Any] = {**recording.meta, "scene": scene.name, "method": method, "speed": scene.speed,
                            "seed": scene.seed, "stopped_because": log.failure}
    mount = camera.T_tool_camera
    distance = -mount.translation[2] / mount.rotation[2, 2]
    meta["camera"] = {"axis": [float(v) for v in camera.axis_on_surface],
                      "distance": float(distance)}
    return dataclasses.replace(recording, columns=columns, meta=meta)
