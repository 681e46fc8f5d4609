"""Time of a diagnosis: 240 s at 250 Hz with six joints. Run: ``python benchmarks/bench_diagnose.py``."""

from __future__ import annotations

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
    """Draws the recording and prints wall and CPU time."""
    rng = np.random.default_rng(3)
    arm = draw_arm(rng)
    while arm.n != 6:
        arm = draw_arm(rng)
    t = np.arange(0.0, 240.0, 0.004)
    s = scene(arm, t, *draw_motion(rng, arm, t))
    noise = 0.01 * np.std(s.torque, axis=0)
    recording = measured(rng, arm, t, s.q, s.torque + INSIDE["stribeck"](rng, s, 2), noise, None)
    with tempfile.TemporaryDirectory() as folder:
        urdf = Path(folder) / "arm.urdf"
        urdf.write_text(arm.urdf, encoding="utf-8")
        robot = Robot.load(urdf)
        wall, cpu = time.perf_counter(), time.process_time()
        found = diagnose(recording, robot)
        print(f"240 s at 250 Hz, 6 joints: {time.perf_counter() - wall:.1f} s wall, "
              f"{time.process_time() - cpu:.1f} s CPU, "
              f"verdict {found.verdict}: {[(e.fitted.name, e.fitted.joint) for e in found.effects]}")


if __name__ == "__main__":
    main()
