"""Digests of what the program computes, to show that a change of layout changed no number.

Run on a checkout: ``python benchmarks/same_numbers.py --write before.json``; then on the changed one with
``--compare before.json``. Scenes are played with seed 1 through the command line and the columns of their recordings
are hashed bit by bit; of the blind trials the printed lines are compared without their times.
Exit code 1 where anything differs. About ten minutes of processor time; ``--trials 0`` leaves the trials out.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

ROOT = Path(__file__).resolve().parents[1]
SCENES = ("line", "iso9283_1", "force_wave", "glue", "contour", "clamped_kr500_1")
BLIND_FIRST = 16000


def run(arguments: list[str]) -> str:
    """What a Python of this checkout prints; one thread, so that sums do not depend on the machine's load."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(arguments)} ended with {done.returncode}:\n{done.stderr}")
    return done.stdout


def digest(recording: Path) -> str:
    """Hash of the columns' names and values, without the file's metadata."""
    frame = pd.read_parquet(recording)
    sha = hashlib.sha256()
    for column in sorted(frame.columns):
        sha.update(column.encode())
        sha.update(np.ascontiguousarray(frame[column].to_numpy()).tobytes())
    return sha.hexdigest()


def scene_digests(scene: str) -> dict[str, str]:
    """Digests of the recordings that a scene with seed 1 writes."""
    with tempfile.TemporaryDirectory() as folder:
        run(["-m", "scenes.cli", "run", scene, "--seed", "1", "--out", folder])
        found = sorted(Path(folder).rglob("*.parquet"))
        return {f"{scene}/{path.relative_to(folder)}": digest(path) for path in found}


def blind_lines(count: int) -> dict[str, str]:
    """The lines of the blind trials by seed, without the seconds that each took."""
    if not count:
        return {}
    text = run(["benchmarks/blind_trials.py", "--count", str(count), "--first", str(BLIND_FIRST), "--processes", "2"])
    lines = [line for line in text.splitlines() if line.startswith(("ok ", "BAD"))]
    return {f"trial {line.split()[1]}": re.sub(r" +\d+\.\d s ", " ", line) for line in lines}


def main() -> None:
    """Writes or compares the digests."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, help="write the digests to this file")
    parser.add_argument("--compare", type=Path, help="compare with the digests in this file")
    parser.add_argument("--trials", type=int, default=60, help="how many blind trials; 0 for none")
    parser.add_argument("--scenes", default=",".join(SCENES))
    options = parser.parse_args()
    digests: dict[str, str] = {}
    for scene in filter(None, options.scenes.split(",")):
        digests.update(scene_digests(scene))
        print(scene, flush=True)
    digests.update(blind_lines(options.trials))
    if options.write is not None:
        options.write.write_text(json.dumps(digests, indent=1) + "\n", encoding="utf-8")
    if options.compare is None:
        print(json.dumps(digests, indent=1))
        return
    expected = {key: value for key, value in json.loads(options.compare.read_text(encoding="utf-8")).items()
                if key in digests}
    differing = [key for key in digests if digests[key] != expected.get(key)]
    for key in differing:
        print(f"differs: {key}\n  before {expected.get(key)}\n  now    {digests[key]}")
    print(f"{len(digests) - len(differing)} of {len(digests)} equal")
    sys.exit(bool(differing))


if __name__ == "__main__":
    main()
