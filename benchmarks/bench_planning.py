"""Time that planning takes of a cycle: predicting, fusing a camera field, the horizon with and without a new field.

    python benchmarks/bench_planning.py [--n-d 25] [--speed 0.7]

Prints medians and 99 % of the calling thread's processor time over one pass along a displaced line, arm and camera
ideal. Of a field's 3 ms and a cycle's 1 ms without one, this is planning's share.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict

import numpy as np

from planning.line_follower import FollowerSettings, LineFollower
from planning.speed_profile import SpeedProfile
from tests.planning.cell import Camera, T, displaced, joint_path, kr6, reference, sine_points


def measure(n_d: int, speed: float, passes: int = 3) -> dict[str, list[float]]:
    """Processor times [s] of each call by name."""
    times: dict[str, list[float]] = defaultdict(list)
    profile = SpeedProfile.plan(kr6(), reference(), speed, joint_path())
    for seed in range(passes):
        follower = LineFollower(kr6(), reference(), profile, n_d, joint_path=joint_path(), settings=FollowerSettings())
        camera = Camera(displaced(sine_points()), np.random.default_rng(seed))
        under_way, exposure = [], 3 * T
        for k in range(int(follower.duration / T)):
            t = k * T
            new = bool(under_way) and under_way[0].t + 0.04 <= t
            while under_way and under_way[0].t + 0.04 <= t:
                field = under_way.pop(0)
                begin = time.thread_time()
                follower.update(field)
                times["update (fuse one field)"].append(time.thread_time() - begin)
            begin = time.thread_time()
            q_d = follower.horizon(t)
            times[f"horizon, {'new field' if new else 'no new field'}"].append(time.thread_time() - begin)
            begin = time.thread_time()
            follower.observe(t, q_d[0])
            times["observe"].append(time.thread_time() - begin)
            while exposure <= t - 2 * T:
                begin = time.thread_time()
                pose = follower.history.pose(exposure)
                follower.predict(exposure).seen_from(pose)
                times["predict (where to look)"].append(time.thread_time() - begin)
                under_way.append(camera.look(follower, exposure, pose))
                exposure += 0.02
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n-d", type=int, default=25)
    parser.add_argument("--speed", type=float, default=0.7)
    options = parser.parse_args()
    times = measure(options.n_d, options.speed)
    print(f"n_d = {options.n_d}, {options.speed} m/s; µs of processor time: median, 99 %, calls")
    for name in sorted(times):
        values = 1e6 * np.array(times[name])
        print(f"  {name:28s} {np.median(values):7.0f} {np.percentile(values, 99):7.0f} {len(values):6d}")


if __name__ == "__main__":
    main()
