"""The recording of a force scene: what the controller logged, what was desired, what the sensors said."""

from __future__ import annotations

import numpy as np

from ideal_robot.signals.recording import Recording
from scenes.force.scene import ForceScene
from scenes.force.task import ForceTask
from sim.arm.arm import SimulatedArm


def force_recording(arm: SimulatedArm, scene: ForceScene, method: str, task: ForceTask) -> Recording:
    """The controller's recording, with columns added.

    ``q_d_i``, the wrench as sensed, the felt force ``f_normal``; in the metadata what
    calibration said of tool and contact, and why the arm stopped.

    Args:
        arm: after the run.
        scene: noted in the metadata.
        method: its key, noted in the metadata.
        task: what was done.
    """
    recording, log = arm.recording(external=True), task.log
    columns = dict(recording.columns)
    t, q_d = np.array(log.t), np.array(log.q_d)
    for i in range(q_d.shape[1]):
        columns[f"q_d_{i + 1}"] = np.interp(recording.t, t, q_d[:, i])
    if log.samples:
        felt = np.array(log.samples)
        order = np.argsort(felt[:, 0])
        columns["f_normal"] = np.interp(recording.t, felt[order, 0], felt[order, 1])
    if log.wrenches:
        times, sensed = np.array([s.t for s in log.wrenches]), np.array([s.wrench for s in log.wrenches])
        for i, name in enumerate(("fx", "fy", "fz", "mx", "my", "mz")):
            columns[name] = np.interp(recording.t, times, sensed[:, i])
    tool = {"bias": task.tool.bias.tolist(), "mass": task.tool.mass, "com": task.tool.com.tolist()}
    meta = {**recording.meta, "tool": tool, "contact_stiffness": task.assumed_stiffness, "scene": scene.name,
            "method": method, "speed": scene.speed, "seed": scene.seed,
            "stopped_because": log.failure}
    return Recording(columns, meta, recording.source)
