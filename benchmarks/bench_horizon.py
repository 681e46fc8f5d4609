"""Error over n_d, the desired positions that the ideal robot is given in each cycle ([L] 2.2, 2.3).

    python benchmarks/bench_horizon.py [--scene line] [--seeds 3] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from scenes import load_scene
from scenes.line.cell import prepared
from scenes.line.kind import run

N_D = (1, 2, 3, 4, 5, 6, 8, 13, 25)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--scene", default="line")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    played = [("sensor_path", 1), *(("ideal", n_d) for n_d in N_D)]
    means = np.empty((len(played), options.seeds))
    for seed in range(1, options.seeds + 1):
        scene = load_scene(options.scene).changed(seed=seed)
        with prepared(scene) as shared:
            for i, (method, n_d) in enumerate(played):
                error = run(scene.changed(n_d=n_d), method=method, shared=shared).control_error
                means[i, seed - 1] = 1e3 * error.mean
    print(f"| {options.scene}: method | n_d | mean mm, seeds 1 to {options.seeds} |\n| --- | --- | --- |")
    for (method, n_d), row in zip(played, means, strict=True):
        print(f"| `{method}` | {n_d} | {', '.join(f'{mean:.3f}' for mean in row)} |")
    if options.json:
        rows = [{"method": method, "n_d": n_d, "mean_mm": row.tolist()}
                for (method, n_d), row in zip(played, means, strict=True)]
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
