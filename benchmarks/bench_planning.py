"""Planning alone, with an arm that does what it is told: the time it takes and the error it leaves.

    python benchmarks/bench_planning.py [--n-d 25] [--speed 0.7]

First medians and 99 % of the calling thread's processor time: predicting where the line will be, fusing a camera field,
the horizon with and without a new field. Of a field's 3 ms and a cycle's 1 ms without one, this is planning's share.
Then the distance of the TCP from a displaced line that is seen with 0.03 mm of noise a point, by speed and latency.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

from planning.line.line_follower import FollowerSettings, LineFollower

# The cell without pictures is the tests' own.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.planning.cell import (
    Camera,
    T,
    displaced,
    distance,
    follow,
    joint_path,
    kr6,
    profile,
    reference,
    sine_points,
)


def measure(n_d: int, speed: float, passes: int = 3) -> dict[str, list[float]]:
    """Processor times [s] of each call by name."""
    times: dict[str, list[float]] = defaultdict(list)
    travel = profile(speed)
    for seed in range(passes):
        follower = LineFollower(kr6(), reference(), travel, n_d, joint_path=joint_path(), settings=FollowerSettings())
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


def error(speed: float, latency: float, seeds: int = 3) -> tuple[float, float]:
    """Mean and 95 % of the distance from the line [m], from 0.5 s on."""
    line = displaced(sine_points())
    distances = []
    for seed in range(seeds):
        follower = LineFollower(
            kr6(), reference(), profile(speed), joint_path=joint_path(), settings=FollowerSettings(latency=latency)
        )
        run = follow(follower, Camera(line, np.random.default_rng(seed)), latency=latency)
        inside = (run.t > 0.5) & (run.tcp[:, 1] < line[-1, 1] - 0.005)
        distances.append(distance(run.tcp[inside], line))
    whole = np.concatenate(distances)
    return float(whole.mean()), float(np.percentile(whole, 95))


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
    latencies = (0.02, 0.04, 0.08, 0.12)
    print("distance from the line, µm: mean / 95 %")
    print("  speed   " + "".join(f"{1e3 * latency:9.0f} ms" for latency in latencies))
    for speed in (0.2, 0.4, 0.7, 1.0, 1.3):
        cells = [error(speed, latency) for latency in latencies]
        print(f"  {speed:.1f} m/s " + "".join(f"{1e6 * mean:6.0f} /{1e6 * p95:4.0f}" for mean, p95 in cells))


if __name__ == "__main__":
    main()
