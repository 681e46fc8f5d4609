"""Fuzzed calls of the command line: ``python benchmarks/fuzz.py --count 20000 --first 0``.

Each case is drawn from its seed alone (``tests/fuzz``); a case that breaks a promise — traceback, more than a minute,
more than 2 GB, files left after a failure, exit code 0 without a required column — is printed with its seed and can be
played again with ``--first SEED --count 1 --show``. Exit code 1 where any did.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import gc
import sys
import tempfile
import time
import warnings
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.fuzz.cases import MAKERS, drawn, sound
from tests.fuzz.play import play, warm_up

EACH = 1000
"""Cases after which it is told how far the run has come."""


def main() -> None:
    """Plays the cases and counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--kinds", default=",".join(MAKERS))
    parser.add_argument("--minutes", type=float, default=1e9, help="end after so long")
    parser.add_argument("--show", action="store_true", help="print what each case wrote to standard error")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory(prefix="fuzz-originals-") as folder:
        sys.exit(played(options, Path(folder)))


def played(options: argparse.Namespace, folder: Path) -> bool:
    """Plays the cases with sound files in a folder and prints what broke our promises; returns whether any did."""
    warm_up(sound(folder))
    # What is loaded now is never collected: collections in the cases would copy the pages they share with this process.
    gc.freeze()
    counts: collections.Counter[str] = collections.Counter()
    codes: collections.Counter[tuple[str, int]] = collections.Counter()
    broken: collections.Counter[str] = collections.Counter()
    longest, largest, start = 0.0, 0, time.monotonic()
    # Ended by hand, it tells what was played until then.
    with contextlib.suppress(KeyboardInterrupt):
        for seed in range(options.first, options.first + options.count):
            if time.monotonic() - start > 60.0 * options.minutes:
                break
            case = drawn(seed, folder, tuple(options.kinds.split(",")))
            one = play(case)
            counts[case.name] += 1
            codes[case.name, one.code] += 1
            longest, largest = max(longest, one.seconds), max(largest, one.peak)
            if options.show:
                print(case.words, one.code, f"{one.seconds:.2f} s", one.err, sep="\n")
            if one.broken is not None:
                broken[one.broken] += 1
                print(f"seed {seed}: {case.name}: {one.broken}", flush=True)
            if sum(counts.values()) % EACH == 0:
                print(told(counts, broken, options.first, longest, largest, start), flush=True)
    for name, count in sorted(counts.items()):
        print(f"{name:24s} {count:6d}  " + "  ".join(f"exit {code}: {n}" for (kind, code), n in sorted(codes.items())
                                                      if kind == name))
    print(told(counts, broken, options.first, longest, largest, start))
    return bool(broken)


def told(counts: collections.Counter[str], broken: collections.Counter[str], first: int, longest: float, largest: int,
         start: float) -> str:
    """What was played since ``start`` (monotonic clock) [s] in a line: longest case [s], largest [bytes]."""
    return (f"{sum(counts.values())} cases from seed {first}, {sum(broken.values())} broken promises; longest "
            f"{longest:.1f} s, largest {largest / 1e9:.2f} GB; {(time.monotonic() - start) / 60.0:.0f} minutes")


if __name__ == "__main__":
    main()
