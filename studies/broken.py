"""Broken files and options, and verbs that are killed at any moment."""

from __future__ import annotations

import collections
import contextlib
import gc
import hashlib
import json
import os
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import typer

import scenes.cli
from tests.fuzz import mutate, originals
from tests.fuzz.cases import MAKERS, drawn, sound
from tests.fuzz.play import play, warm_up

EACH = 1000
"""Cases after which it is told how far the run has come."""


def fuzz(count: int = 1000, first: int = 0, kinds: str = ",".join(MAKERS), minutes: float = 1e9,
         show: bool = False) -> None:
    """Whole verbs with broken files and options, each case drawn from its seed alone.

    A case that breaks a promise (traceback, more than a minute, more than 2 GB, files left after a failure, exit code 0
    without a required column) is printed with its seed and can be played again with --first SEED --count 1 --show.
    Exit code 1 where any did.
    """
    warnings.simplefilter("ignore")
    counts: collections.Counter[str] = collections.Counter()
    codes: collections.Counter[tuple[str, int]] = collections.Counter()
    longest, largest, broken, start = 0.0, 0, 0, time.monotonic()

    def told() -> str:
        return (f"{counts.total()} cases from seed {first}, {broken} broken promises; longest {longest:.1f} s, largest "
                f"{largest / 1e9:.2f} GB; {(time.monotonic() - start) / 60.0:.0f} minutes")

    # Ended by hand, it tells what was played until then.
    with tempfile.TemporaryDirectory(prefix="fuzz-originals-") as folder, contextlib.suppress(KeyboardInterrupt):
        warm_up(sound(Path(folder)))
        # What is loaded now is never collected: collections in the cases would copy the pages they share with this
        # process.
        gc.freeze()
        for seed in range(first, first + count):
            if time.monotonic() - start > 60.0 * minutes:
                break
            case = drawn(seed, Path(folder), tuple(kinds.split(",")))
            outcome = play(case)
            counts[case.name] += 1
            codes[case.name, outcome.code] += 1
            longest, largest = max(longest, outcome.seconds), max(largest, outcome.peak)
            if show:
                print(case.words, outcome.code, f"{outcome.seconds:.2f} s", outcome.err, sep="\n")
            if outcome.broken is not None:
                broken += 1
                print(f"seed {seed}: {case.name}: {outcome.broken}", flush=True)
            if counts.total() % EACH == 0:
                print(told(), flush=True)
    for name, number in sorted(counts.items()):
        print(f"{name:24s} {number:6d}  " + "  ".join(f"exit {code}: {n}" for (kind, code), n in sorted(codes.items())
                                                      if kind == name))
    print(told())
    raise typer.Exit(bool(broken))


LONGEST = 2.0
"""Time in which a signal that can be caught must end a verb [s]."""
KINDS = ("old", "new")


@dataclass(frozen=True)
class Verb:
    """What is called for the earlier (``old``) and the later (``new``) result, and which kind a folder holds."""

    words: Callable[[str], list[str]]
    kind_of: Callable[[Path], str]


def _begun(folder: Path, words: list[str]) -> int:
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
        try:
            scenes.cli.main()
            code = 0
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 0
        except KeyboardInterrupt:
            code = 130
    finally:
        os._exit(code)


def _finished(folder: Path, words: list[str]) -> float:
    """Plays a verb to its end; returns how long it took [s]."""
    start = time.monotonic()
    code = os.waitstatus_to_exitcode(os.waitpid(_begun(folder, words), 0)[1])
    if code:
        raise SystemExit(f"{' '.join(words)} ends with exit code {code}")
    return time.monotonic() - start


def _group_lives(group: int) -> bool:
    """Whether any process of the group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def _identify_verb(folder: Path) -> Verb:
    """A model, its report, JSON and URDF from one of two recordings."""
    columns = originals.motion(folder)
    (folder / "old.csv").write_bytes(mutate.csv_bytes(columns))
    (folder / "new.csv").write_bytes(mutate.csv_bytes({**columns, "tau_1": 1.1 * columns["tau_1"]}))
    known: dict[str, tuple[str, ...]] = {}

    def digests(where: Path) -> tuple[str, ...]:
        return tuple(hashlib.sha256((where / name).read_bytes()).hexdigest()
                     for name in ("o/report.html", "o/j.json", "o/m.json", "o/e.urdf"))

    def words(kind: str) -> list[str]:
        return ["identify", f"{kind}.csv", "--urdf", "arm.urdf", "--friction", "viscous_coulomb", "--out", "o",
                "--json", "o/j.json", "--model", "o/m.json", "--export-urdf", "o/e.urdf"]

    for kind in ("new", "old"):
        _finished(folder, words(kind))
        known[kind] = digests(folder)
    return Verb(words, lambda where: next((kind for kind in KINDS if known[kind] == digests(where)), "mixed"))


def _run_verb(folder: Path) -> Verb:
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
        _finished(folder, words(kind))
        recordings[kind] = (folder / "o/recording.parquet").read_bytes()
    return Verb(words, kind_of)


def _sweep_verb(folder: Path) -> Verb:
    """Answers of six runs as lines; ``new`` is a file that one more sweep brings to the six answers."""
    (folder / "s.toml").write_bytes(originals.LINE)

    def words(kind: str) -> list[str]:
        count = 1 if kind == "old" else 6
        return ["sweep", "s.toml", "--seeds", f"1-{count}", "--processes", "1", "--lines", "l.jsonl", "--resume",
                "--json", "j.json"]

    def figures(where: Path) -> list[str]:
        answers = [json.loads(line)["answer"] for line in (where / "l.jsonl").read_text().splitlines()]
        return sorted(f"{answer['seed']}: {answer['control_error_mm']}" for answer in answers)

    _finished(folder, words("new"))
    whole = figures(folder)

    def kind_of(where: Path) -> str:
        raw = (where / "l.jsonl").read_bytes() if (where / "l.jsonl").exists() else b""
        for line in raw.splitlines(keepends=True):
            if line.endswith(b"\n"):
                json.loads(line)
        json.loads((where / "j.json").read_text())
        answers = raw.count(b"\n")
        _finished(where, words("new"))
        kind = "old" if answers == 0 else "new" if answers == len(whole) else f"{answers} answers"
        kind = kind if figures(where) == whole else "mixed"
        (where / "l.jsonl").unlink()
        return kind

    (folder / "l.jsonl").unlink()
    return Verb(words, kind_of)


VERBS = {"identify": _identify_verb, "run": _run_verb, "sweep": _sweep_verb}


def kill(verb: str = "identify", count: int = 50, signal_name: str = "KILL", seed: int = 0) -> None:
    """`kill -9`, SIGTERM and Ctrl-C at random moments of `identify`, `run` or `sweep` (--verb).

    Every file must be the earlier one or the new one, all of one kind; a sweep's file of lines must hold whole answers,
    and --resume must bring it to the same end. Verbs fork from a process that has played them once, so that moments are
    those of the work and not of imports. --signal-name is KILL, TERM or INT. Exit code 1 for a mixture, for a process
    that outlives the signal, and, of signals that can be caught, for more than two seconds.
    """
    rng, sent = np.random.default_rng(seed), signal.Signals[f"SIG{signal_name}"]
    kinds: collections.Counter[str] = collections.Counter()
    slowest, outlived = 0.0, 0
    with tempfile.TemporaryDirectory(prefix="kill-") as name:
        folder = Path(name)
        originals.arm(folder)
        played, restored = VERBS[verb](folder), verb != "sweep"
        took = _finished(folder, played.words("new"))
        if restored:
            _finished(folder, played.words("old"))
        else:
            (folder / "l.jsonl").unlink()
        for turn in range(count):
            child = _begun(folder, played.words("new"))
            time.sleep(float(rng.uniform(0.02, 1.05)) * took)
            start = time.monotonic()
            os.kill(child, sent)
            os.waitpid(child, 0)
            while _group_lives(child) and time.monotonic() - start < 20.0:
                time.sleep(0.01)
            slowest = max(slowest, time.monotonic() - start)
            if _group_lives(child):
                outlived += 1
                os.killpg(child, signal.SIGKILL)
            kind = played.kind_of(folder)
            kinds[kind] += 1
            print(f"    {turn + 1} of {count}: {kind}", file=sys.stderr, flush=True)
            if restored and kind != "old":
                _finished(folder, played.words("old"))
    print(f"{verb}, {count} times {sent.name} within {took:.1f} s: "
          + ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items()))
          + f"; all processes gone after {slowest:.2f} s at most, {outlived} outlived it")
    raise typer.Exit(bool(kinds["mixed"] or outlived or (sent is not signal.SIGKILL and slowest > LONGEST)))
