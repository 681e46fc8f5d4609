"""Speed of the line-following loop: real-time factor, and computing time of a cycle with and without a new field.

All world effects are on, 320×240 at 50 Hz, rendering counts in the real-time factor. Prints medians over several runs;
`--profile` adds where the time of a cycle goes.
"""

from __future__ import annotations

import cProfile
import pstats
import sys

import numpy as np

from scenes import load_scene
from scenes.line.cell import prepared
from scenes.line.kind import run

RUNS = 5


def main() -> None:
    scene = load_scene("line")
    with prepared(scene) as cell:
        run(scene, method="ideal", shared=cell)
        results = [run(scene, method="ideal", shared=cell) for _ in range(RUNS)]
        factor = [result.timing.real_time_factor for result in results]
        print(f"real-time factor, rendering on: median {np.median(factor):.2f} of {RUNS} runs "
              f"(from {min(factor):.2f} to {max(factor):.2f})")
        for kind, wanted in (("with a new field", True), ("without", False)):
            times = np.concatenate([result.timing.cycles[result.timing.with_field == wanted] for result in results])
            print(f"sensing + planning + feedforward, cycles {kind}: median {1e3 * np.median(times):.2f} ms, "
                  f"99 % {1e3 * np.quantile(times, 0.99):.2f} ms, {len(times)} cycles")
        if "--profile" in sys.argv:
            profile = cProfile.Profile()
            profile.enable()
            run(scene, method="ideal", shared=cell)
            profile.disable()
            pstats.Stats(profile).sort_stats("tottime").print_stats(25)


if __name__ == "__main__":
    main()
