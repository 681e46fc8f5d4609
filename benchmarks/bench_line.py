"""Speed of the line-following loop: real-time factor, and computing time of a cycle with and without a new field.

    python benchmarks/bench_line.py [--runs 5] [--world workshop] [--tool-mm 250] [--profile]

All world effects are on, 320×240 at 50 Hz, rendering counts in the real-time factor. Processor time of this thread,
which other work on the machine hardly lengthens, and elapsed time beside it. ``--tool-mm`` puts a tool on, and the
arm's links into the picture; the last line then says how many of their shapes came into view.
``--profile`` adds where the time goes.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import time
from typing import Any

import numpy as np

from ideal_robot.arrays import Array
from scenes import load_scene
from scenes.line import play
from scenes.line.cell import prepared
from scenes.line.kind import run
from scenes.online.line_task import LineTask
from scenes.scene_files.scene import chosen
from sim.camera.bullet_camera import BulletCamera
from sim.camera.camera import RenderedCamera

CYCLES: list[float] = []
"""Processor time of sensing, planning and feedforward of each cycle of the run that is being played [s]."""


class TimedTask(LineTask):
    """A task that writes down how long its part of each cycle takes."""

    def observe(self, *arguments: Any) -> None:
        """As ``LineTask.observe``; the cycle begins.

        Args:
            arguments: of ``LineTask.observe``.
        """
        self._begun = time.thread_time()
        super().observe(*arguments)

    def command(self, t: float, q_d: Array) -> Array:
        """As ``LineTask.command``; the computing of the cycle ends.

        Args:
            t: begin of the cycle [s].
            q_d: horizon ``(n_d, n)`` [rad].
        """
        q_c = super().command(t, q_d)
        CYCLES.append(time.thread_time() - self._begun)
        return q_c


def shapes_shown(camera: RenderedCamera) -> int:
    """How many of the arm's shapes a window has shown."""
    return len(camera.arm.bodies) if isinstance(camera, BulletCamera) and camera.arm is not None else 0


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--world")
    parser.add_argument("--tool-mm", type=float, default=0.0)
    parser.add_argument("--profile", action="store_true")
    options = parser.parse_args()
    scene = chosen(load_scene("line"), world=options.world).changed(tool_mm=options.tool_mm)
    vars(play)["LineTask"] = TimedTask
    with prepared(scene) as cell:
        run(scene, method="ideal", shared=cell)
        busy, factor, elapsed, fields = [], [], [], []
        for _ in range(options.runs):
            CYCLES.clear()
            begun = time.process_time()
            result = run(scene, method="ideal", shared=cell)
            factor.append(result.timing.simulated / (time.process_time() - begun))
            busy.append(np.array(CYCLES))
            elapsed.append(result.timing.cycles)
            fields.append(result.timing.with_field)
        print(f"real-time factor, rendering on, by processor time: median {np.median(factor):.2f} of "
              f"{options.runs} runs (from {min(factor):.2f} to {max(factor):.2f})")
        times, walls, with_field = np.concatenate(busy), np.concatenate(elapsed), np.concatenate(fields)
        for kind, which in (("with a new field", with_field), ("without", ~with_field)):
            print(f"sensing + planning + feedforward, cycles {kind}: processor time median "
                  f"{1e3 * np.median(times[which]):.2f} ms, 99 % {1e3 * np.quantile(times[which], 0.99):.2f} ms; "
                  f"elapsed median {1e3 * np.median(walls[which]):.2f} ms; {which.sum()} cycles")
        print(f"mean error {1e3 * result.control_error.mean:.3f} mm, fields used {result.fields_used} of "
              f"{result.fields_seen}; shapes of the arm that came into view: {shapes_shown(cell.camera)}")
        if options.profile:
            profile = cProfile.Profile()
            profile.enable()
            run(scene, method="ideal", shared=cell)
            profile.disable()
            pstats.Stats(profile).sort_stats("tottime").print_stats(25)


if __name__ == "__main__":
    main()
