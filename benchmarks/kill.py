"""``kill -9``, SIGTERM and Ctrl-C at random moments of ``identify``, ``run`` and ``sweep`` over an earlier result.

    python benchmarks/kill.py --verb run --count 50
    python benchmarks/kill.py --verb sweep --count 10 --signal TERM

Every file must be the earlier one or the new one, all of one kind; a sweep's file of lines must hold whole answers,
and ``--resume`` must bring it to the same end. Verbs fork from a process that has played them once, so that moments are
those of the work and not of imports. Prints how many of each kind and, of signals that can be caught, the longest time
until all processes are gone; exit code 1 for a mixture, for a process that outlives it, or for more than two seconds.
"""

from __future__ import annotations

import argparse
import collections
import hashlib
import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from tests.fuzz import mutate_table, originals  # noqa: E402

LONGEST = 2.0
"""Time in which a signal that can be caught must end a verb [s]."""
KINDS = ("old", "new")


@dataclass(frozen=True)
class Verb:
    """What is called for the earlier (``old``) and the later (``new``) result, and which kind a folder holds."""

    words: Callable[[str], list[str]]
    kind_of: Callable[[Path], str]


def begun(folder: Path, words: list[str]) -> int:
    """A verb under way in a process group of its own."""
    child = os.fork()
    if child:
        return child
    code = 70
    try:
        os.setsid()
        os.chdir(folder)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.argv = ["ideal-robot", *words]
        import scenes.cli

        try:
            scenes.cli.main()
            code = 0
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 0
        except KeyboardInterrupt:
            code = 130
    finally:
        os._exit(code)


def finished(folder: Path, words: list[str]) -> float:
    """Plays a verb to its end; returns how long it took [s]."""
    start = time.monotonic()
    code = os.waitstatus_to_exitcode(os.waitpid(begun(folder, words), 0)[1])
    if code:
        raise SystemExit(f"{' '.join(words)} ends with exit code {code}")
    return time.monotonic() - start


def group_lives(group: int) -> bool:
    """Whether any process of the group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def identify_verb(folder: Path) -> Verb:
    """A model, its report, JSON and URDF from one of two recordings."""
    columns = originals.motion(folder)
    (folder / "old.csv").write_bytes(mutate_table.csv_bytes(columns))
    (folder / "new.csv").write_bytes(mutate_table.csv_bytes({**columns, "tau_1": 1.1 * columns["tau_1"]}))
    known: dict[str, tuple[str, ...]] = {}

    def digests(where: Path) -> tuple[str, ...]:
        return tuple(hashlib.sha256((where / name).read_bytes()).hexdigest()
                     for name in ("o/report.html", "o/j.json", "o/m.json", "o/e.urdf"))

    def words(kind: str) -> list[str]:
        return ["identify", f"{kind}.csv", "--urdf", "arm.urdf", "--friction", "viscous_coulomb", "--out", "o",
                "--json", "o/j.json", "--model", "o/m.json", "--export-urdf", "o/e.urdf"]

    for kind in ("new", "old"):
        finished(folder, words(kind))
        known[kind] = digests(folder)
    return Verb(words, lambda where: next((kind for kind in KINDS if known[kind] == digests(where)), "mixed"))


def run_verb(folder: Path) -> Verb:
    """Report, JSON and recording of one of two short scenes, told apart by their seeds."""
    for seed, kind in enumerate(KINDS, start=1):
        (folder / f"{kind}.toml").write_bytes(originals.LINE.replace(b"seed = 1", f"seed = {seed}".encode()).replace(
            b'title = "short"', f'title = "the {kind} one"'.encode()))
    recordings: dict[str, bytes] = {}

    def words(kind: str) -> list[str]:
        return ["run", f"{kind}.toml", "--out", "o", "--json", "o/j.json"]

    def kind_of(where: Path) -> str:
        recording = next(kind for kind in (*KINDS, "mixed")
                         if recordings.get(kind) == (where / "o/recording.parquet").read_bytes() or kind == "mixed")
        report = (where / "o/report.html").read_text(encoding="utf-8")
        seed = json.loads((where / "o/j.json").read_text())["seed"]
        ends = report.rstrip().endswith("</html>")
        of_report = next((kind for kind in KINDS if ends and f"the {kind} one" in report), "mixed")
        return recording if recording == of_report == KINDS[seed - 1] else "mixed"

    for kind in ("new", "old"):
        finished(folder, words(kind))
        recordings[kind] = (folder / "o/recording.parquet").read_bytes()
    return Verb(words, kind_of)


def sweep_verb(folder: Path) -> Verb:
    """Answers of six runs as lines; ``new`` is a file that one more sweep brings to the six answers."""
    (folder / "s.toml").write_bytes(originals.LINE)

    def words(kind: str) -> list[str]:
        count = 1 if kind == "old" else 6
        return ["sweep", "s.toml", "--seeds", f"1-{count}", "--processes", "1", "--lines", "l.jsonl", "--resume",
                "--json", "j.json"]

    def figures(where: Path) -> list[str]:
        answers = [json.loads(line)["answer"] for line in (where / "l.jsonl").read_text().splitlines()]
        return sorted(f"{answer['seed']}: {answer['control_error_mm']}" for answer in answers)

    finished(folder, words("new"))
    whole = figures(folder)

    def kind_of(where: Path) -> str:
        raw = (where / "l.jsonl").read_bytes() if (where / "l.jsonl").exists() else b""
        for line in raw.splitlines(keepends=True):
            if line.endswith(b"\n"):
                json.loads(line)
        json.loads((where / "j.json").read_text())
        left = raw.count(b"\n")
        finished(where, words("new"))
        kind = "old" if left == 0 else "new" if left == len(whole) else f"{left} answers"
        kind = kind if figures(where) == whole else "mixed"
        (where / "l.jsonl").unlink()
        return kind

    (folder / "l.jsonl").unlink()
    return Verb(words, kind_of)


VERBS = {"identify": identify_verb, "run": run_verb, "sweep": sweep_verb}


def main() -> None:
    """Kills and counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--verb", choices=sorted(VERBS), default="identify")
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--signal", choices=("KILL", "TERM", "INT"), default="KILL")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kill-") as folder:
        sys.exit(killed(options, Path(folder)))


def killed(options: argparse.Namespace, folder: Path) -> bool:
    """Kills a verb so many times in a folder and prints what was left; returns whether a promise was broken."""
    rng, sent = np.random.default_rng(options.seed), signal.Signals[f"SIG{options.signal}"]
    originals.arm(folder)
    import scenes.cli  # noqa: F401

    verb = VERBS[options.verb](folder)
    restored = options.verb != "sweep"
    took = finished(folder, verb.words("new"))
    if restored:
        finished(folder, verb.words("old"))
    else:
        (folder / "l.jsonl").unlink()
    kinds: collections.Counter[str] = collections.Counter()
    slowest, outlived = 0.0, 0
    for turn in range(options.count):
        child = begun(folder, verb.words("new"))
        time.sleep(float(rng.uniform(0.02, 1.05)) * took)
        start = time.monotonic()
        os.kill(child, sent)
        os.waitpid(child, 0)
        while group_lives(child) and time.monotonic() - start < 20.0:
            time.sleep(0.01)
        slowest = max(slowest, time.monotonic() - start)
        if group_lives(child):
            outlived += 1
            os.killpg(child, signal.SIGKILL)
        kind = verb.kind_of(folder)
        kinds[kind] += 1
        print(f"    {turn + 1} of {options.count}: {kind}", file=sys.stderr, flush=True)
        if restored and kind != "old":
            finished(folder, verb.words("old"))
    print(f"{options.verb}, {options.count} times {sent.name} within {took:.1f} s: "
          + ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items()))
          + f"; all processes gone after {slowest:.2f} s at most, {outlived} outlived it")
    return bool(kinds["mixed"] or outlived or (sent is not signal.SIGKILL and slowest > LONGEST))


if __name__ == "__main__":
    main()
