"""Plays a case in a process of its own, with limits of time and memory, and says what broke our promises."""

from __future__ import annotations

import csv
import json
import math
import os
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from unittest.mock import patch

import typer.main

SECONDS = 60.0
"""Longest processor time of a case [s]."""
PATIENCE = 5.0
"""How many times as long by the clock, where other processes share the cores; what takes longer hangs."""
BYTES = 2 * 1024**3
"""Memory a case may take beside what the loaded program maps [bytes]."""
CACHE = "IDEAL_ROBOT_CACHE"
"""Environment variable of the folder of prepared models; a case has its own."""


@dataclass(frozen=True)
class Case:
    """What is called with what.

    Attributes:
        name: kind of the case: verb and format.
        words: of the command line.
        files: name → bytes, in the working folder.
        must_fail: whether exit code 0 would be wrong: a required column is lost.
        interrupted: time by the clock after which Ctrl-C is pressed [s]; None for never.
    """

    name: str
    words: list[str]
    files: dict[str, bytes] = field(default_factory=dict)
    must_fail: bool = False
    interrupted: float | None = None


@dataclass(frozen=True)
class Played:
    """How a case ended.

    Attributes:
        code: exit code; negative: the signal that ended it.
        seconds: of processor time.
        peak: largest resident memory [bytes].
        err: standard error.
        broken: the promise that was broken, or None.
    """

    code: int
    seconds: float
    peak: int
    err: str
    broken: str | None


def warm_up(cases: Sequence[Case] = ()) -> None:
    """Loads the program once, so that cases do not.

    Args:
        cases: sound calls that are played here, in the process from which the cases fork: what they import and load of
            compiled code is there for all.

    Raises:
        RuntimeError: one of them fails that need not.
    """
    command = _command()
    home, arguments = Path.cwd(), sys.argv
    for case in cases:
        with tempfile.TemporaryDirectory(prefix="fuzz-") as folder, open(os.devnull, "w") as nowhere, \
                patch.dict(os.environ, {CACHE: "kept"}):
            _write(case, Path(folder))
            os.chdir(folder)
            sys.argv = ["ideal-robot", *case.words]
            try:
                with redirect_stdout(nowhere), redirect_stderr(nowhere):
                    command(standalone_mode=False)
            except Exception as error:
                if not case.must_fail:
                    raise RuntimeError(f"{case.name}: the sound call fails: {error}") from error
            finally:
                os.chdir(home)
                sys.argv = arguments


@cache
def _command() -> Callable[..., object]:
    """The command line with all its verbs and options, made once."""
    import scenes.cli

    return typer.main.get_command(scenes.cli.app)


def play(case: Case, seconds: float = SECONDS) -> Played:
    """Plays a case in a forked process in an empty folder of its own.

    Args:
        case: what is called.
        seconds: of processor time, after which it is killed.
    """
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    try:
        _write(case, folder)
        code, peak, took = _forked(case, folder, seconds)
        err = (folder / ".err").read_text(errors="replace") if (folder / ".err").exists() else ""
        return Played(code, took, peak, err, _broken(case, folder, code, took, peak, err, seconds))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write(case: Case, folder: Path) -> None:
    for name, raw in case.files.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(raw)


def _forked(case: Case, folder: Path, seconds: float) -> tuple[int, int, float]:
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        _child(case, folder, seconds)
    begun, pressed = time.monotonic(), False
    while True:
        done, status, usage = os.wait4(child, os.WNOHANG)
        if done:
            used = usage.ru_utime + usage.ru_stime
            return os.waitstatus_to_exitcode(status), 1024 * usage.ru_maxrss, used
        if case.interrupted is not None and not pressed and time.monotonic() > begun + case.interrupted:
            os.kill(child, signal.SIGINT)
            pressed = True
        if time.monotonic() > begun + PATIENCE * seconds:
            os.killpg(child, signal.SIGKILL)
            _, status, usage = os.wait4(child, 0)
            return os.waitstatus_to_exitcode(status), 1024 * usage.ru_maxrss, math.inf
        time.sleep(0.005)


def _child(case: Case, folder: Path, seconds: float) -> None:
    code = 70
    try:
        os.setsid()
        os.chdir(folder)
        # A shell that starts the whole in the background has it ignored.
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number, name in ((1, ".out"), (2, ".err")):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        # Not those of who watches the tests.
        sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (mapped + BYTES, mapped + BYTES))
        resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(seconds), math.ceil(seconds) + 2))
        os.environ |= {"IDEAL_ROBOT_DEBUG": "1", CACHE: "kept"}
        sys.argv = ["ideal-robot", *case.words]
        import scenes.cli

        try:
            _command()()
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 0 if ended.code is None else 1
        except KeyboardInterrupt:
            # As the entry point answers it where no verb is under way.
            code = 130
        except BaseException as error:
            code = scenes.cli.ended_by(error)
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _says_why(figures: Path) -> bool:
    """Whether these are figures of what did not succeed, whole and with the reason.

    Of an arm that was stopped on its path, of a sweep without a success, of pictures without a line.
    """
    content = json.loads(figures.read_text())
    if "runs" in content:
        return all(run["failure"] for run in content["runs"])
    if "pictures" in content:
        return not any(picture["found"] for picture in content["pictures"])
    return bool(content.get("failure"))


def _rows_say_why(table: Path) -> bool:
    """Whether each run of a sweep's table failed and says why."""
    with table.open(encoding="utf-8", newline="") as file:
        return all(row["failure"] for row in csv.DictReader(file))


def _broken(case: Case, folder: Path, code: int, took: float, peak: int, err: str, seconds: float) -> str | None:
    if code < 0:
        return "over time" if took >= 0.98 * seconds else f"killed by signal {-code}"
    if took > seconds:
        return "over time"
    if "Traceback (most recent call last)" in err:
        places = re.findall(r'File "[^"]*/((?:ideal_robot|scenes|sensing|planning|sim)/[^"]*)", line (\d+)', err)
        last = [line for line in err.strip().splitlines() if line.strip()][-1]
        return f"traceback at {':'.join(places[-1]) if places else '?'}: {last[:160]}"
    if code not in (0, 1, 2) and not (case.interrupted and code == 130):
        return f"exit code {code}"
    if code == 0 and case.must_fail:
        return "exit code 0 without a required column"
    if code and "not enough memory" in err:
        return "memory"
    lines = [line for line in err.splitlines() if line.strip()]
    if code == 2 and "Usage:" not in err and len(lines) != 1:
        return f"{len(lines)} lines on standard error"
    leftovers = {path.name for path in folder.iterdir()} - {Path(name).parts[0] for name in case.files} \
        - {".out", ".err"}
    if code and "kept" in leftovers and list((folder / "kept").glob("*.json")):
        # A model that was prepared is not lost with the scene for which it was.
        leftovers.remove("kept")
    if code == 1 and "j.json" in leftovers and leftovers <= {"j.json", "o", "t.csv"} and _says_why(folder / "j.json"):
        return None
    if code == 1 and case.words[0] == "sweep" and "--csv" in case.words:
        table = folder / case.words[case.words.index("--csv") + 1]
        leftovers -= {table.name} if table.is_file() and _rows_say_why(table) else set()
    if code and leftovers:
        return f"left {', '.join(sorted(leftovers))} after a failure"
    if any(name.startswith(".") for name in leftovers):
        return f"left {', '.join(sorted(leftovers))}"
    return None
