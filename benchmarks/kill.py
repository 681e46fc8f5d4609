"""``kill -9`` at random moments of ``identify`` over an earlier result: ``python benchmarks/kill.py --count 50``.

Every file must be the earlier one or the new one, all of one kind. Prints how many of each; exit code 1 for a mixture.
"""

from __future__ import annotations

import argparse
import collections
import hashlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from tests.fuzz import mutate_table, originals  # noqa: E402

FILES = ("o/report.html", "o/j.json", "o/m.json", "o/e.urdf")


def begun(folder: Path, recording: str) -> subprocess.Popen[bytes]:
    """``identify`` on a recording, under way."""
    words = ["identify", recording, "--urdf", "arm.urdf", "--friction", "viscous_coulomb", "--out", "o", "--json",
             "o/j.json", "--model", "o/m.json", "--export-urdf", "o/e.urdf"]
    return subprocess.Popen([sys.executable, "-m", "scenes.cli", *words], cwd=folder, stdout=subprocess.DEVNULL,
                            stderr=subprocess.DEVNULL,
                            env={**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"})


def digests(folder: Path) -> tuple[str, ...]:
    """Of the result's files."""
    return tuple(hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in FILES)


def main() -> None:
    """Kills and counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    folder = Path(tempfile.mkdtemp(prefix="kill-"))
    columns = originals.motion(folder)
    (folder / "old.csv").write_bytes(mutate_table._csv(columns))
    (folder / "new.csv").write_bytes(mutate_table._csv({**columns, "tau_1": 1.1 * columns["tau_1"]}))
    results = {}
    for name in ("new", "old"):
        start = time.monotonic()
        if begun(folder, f"{name}.csv").wait():
            raise SystemExit("identify fails")
        took, results[name] = time.monotonic() - start, digests(folder)
    kinds: collections.Counter[str] = collections.Counter()
    for _ in range(options.count):
        process = begun(folder, "new.csv")
        time.sleep(float(rng.uniform(0.5, 1.05)) * took)
        process.kill()
        process.wait()
        found = digests(folder)
        kind = next((name for name, known in results.items() if known == found), "mixed")
        kinds[kind] += 1
        if kind != "old":
            begun(folder, "old.csv").wait()
    print(f"{options.count} kills within {took:.1f} s: " + ", ".join(f"{n} {kind}" for kind, n in kinds.items()))
    sys.exit(bool(kinds["mixed"]))


if __name__ == "__main__":
    main()
