"""Time and memory of a diagnosis: 240 s at 250 Hz with six joints. Run: ``python benchmarks/bench_diagnose.py``.

``--seconds 3600`` makes it an hour. Memory is by how much the process grew beyond the largest it had been.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from ideal_robot.diagnosis import diagnose
from ideal_robot.robots.robot import Robot
from trials.arms import draw_arm, draw_motion
from trials.torque import measured
from trials.torque_truth import INSIDE, scene


def main() -> None:
    """Draws the recording and prints wall and CPU time, and memory."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=240.0, help="length of the recording [s]")
    seconds = parser.parse_args().seconds
    rng = np.random.default_rng(3)
    arm = draw_arm(rng)
    while arm.n != 6:
        arm = draw_arm(rng)
    t = np.arange(0.0, seconds, 0.004)
    s = scene(arm, t, *draw_motion(rng, arm, t))
    noise = 0.01 * np.std(s.torque, axis=0)
    recording = measured(rng, arm, t, s.q, s.torque + INSIDE["stribeck"](rng, s, 2), noise, None)
    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / "arm.urdf"
        urdf.write_text(arm.urdf, encoding="utf-8")
        robot = Robot.load(urdf)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        wall, cpu = time.perf_counter(), time.process_time()
        found = diagnose(recording, robot)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory
        print(f"{seconds:g} s at 250 Hz, 6 joints: {wall:.1f} s wall, {cpu:.1f} s CPU, {memory / 1e6:.2f} GB more, "
              f"verdict {found.verdict}: {[(e.fitted.name, e.fitted.joint) for e in found.effects]}")


if __name__ == "__main__":
    main()
