"""The recording of a force scene: what the controller logged, what was desired, what the sensors said."""

from __future__ import annotations

import numpy as np

from ideal_robot.signals.column_store import ColumnStore
from ideal_robot.signals.recording import Recording
from scenes.force.scene import ForceScene
from scenes.force.task import ForceTask
from sim.arm.arm import SimulatedArm

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
"""Columns of a force sensor."""


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
    t, q_d, felt = recording.t, np.asarray(log.q_d), np.asarray(log.samples)
    names = [f"q_d_{i + 1}" for i in range(q_d.shape[1])]
    names += (["f_normal"] if len(felt) else []) + ([*WRENCH] if len(log.wrenches) else [])
    store = ColumnStore(names, len(t))
    for i in range(q_d.shape[1]):
        store.fill(names[i], 0, np.interp(t, np.asarray(log.t), q_d[:, i]))
        store.release()
    if len(felt):
        order = np.argsort(felt[:, 0])
        store.fill("f_normal", 0, np.interp(t, felt[order, 0], felt[order, 1]))
    if len(log.wrenches):
        instants = log.wrenches.column(0)
        for i, name in enumerate(WRENCH, start=1):
            store.fill(name, 0, np.interp(t, instants, log.wrenches.column(i)))
            store.release()
    tool = {"bias": task.tool.bias.tolist(), "mass": task.tool.mass, "com": task.tool.com.tolist()}
    meta = {**recording.meta, "tool": tool, "contact_stiffness": task.assumed_stiffness, "scene": scene.name,
            "method": method, "speed": scene.speed, "seed": scene.seed,
            "stopped_because": log.failure}
    return Recording({**recording.columns, **store.finished()}, meta, recording.source)
