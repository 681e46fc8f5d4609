"""Which share of single faults the tests notice: mutation testing of the packages that lead an arm.

A mutant is one fault of ``studies/mutant_sites.py`` in a copy of the checkout. Of the tests of ``make test`` it meets
those of its package's folder and those of other parts that import its module, the latter and the quick ones first, for
20 s or until one fails; whole scenes, which take minutes, are left out, so that the shares are lower bounds. It counts
as killed by a test that fails, by code that does not compile or ends the process, and by a run that takes three times
as long.
"""

from __future__ import annotations

import ast
import contextlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections import defaultdict
from collections.abc import Callable, Generator, Iterable, Iterator
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numba.core import caching

from ideal_robot.errors import InputError
from studies.mutant_sites import Mutant, mutants_of
from studies.report import head, row

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("ideal_robot", "sensing", "planning", "sim", "scenes", "studies", "tests", "docs", "examples")
PACKAGES = {
    "limits": (), "execution": ("ideal_robot/execution",), "feedforward": ("ideal_robot/feedforward",),
    "fusion": ("planning/line",), "planning": ("planning/path", "planning/force"), "sensing": ("sensing",),
    "physics": ("sim/arm",),
}
"""What is told apart, and the folders that belong to it."""
LIMITS = ("ideal_robot/execution/command_governor.py:*", "sensing/life_signs.py:*",
          "planning/force/felt_by_motors.py:*",
          "planning/force/contact.py:most_force", "planning/force/contact.py:StopLimits*",
          "planning/force/contact.py:StopConditions*", "planning/force/contact.py:EmergencyStopError*",
          "planning/line/line_follower.py:LineFollower._check_seen")
"""Places that keep an arm safe: limits of commands and forces, stops, what hears whether a sensor is alive."""
DRAWN = "limits:80,execution:40,fusion:30,feedforward:20,planning:20,sensing:20,physics:20"
"""Mutants of each package."""
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.toml")
BUDGET, LONGER, STARTS, COMPILES = 20.0, 3.0, 15.0, 60.0
"""Processor time of tests that a mutant meets, by what they take without a fault; how many times as long it may take,
and what is added for the start and for compiling [s]."""


class _Order:
    """Plays tests of files that import the module first, and of both kinds the quick ones; remembers what each took."""

    def __init__(self, known: dict[str, float], module: str) -> None:
        self.known, self.module, self.taken = known, module, dict[str, float]()

    def _place(self, item: pytest.Item) -> tuple[bool, float]:
        return self.module not in _imports(item.path), self.known.get(item.nodeid, BUDGET)

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        if self.known:
            selected, total = [], 0.0
            for item in sorted(items, key=self._place):
                total += self.known.get(item.nodeid, BUDGET)
                selected += [item] if total <= BUDGET else []
            items[:] = selected

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        begun = time.process_time()
        result = yield
        self.taken[item.nodeid] = time.process_time() - begun
        return result


def in_child(job: Callable[[], int], seconds: float) -> int:
    """What a job returns, run in a process of its own for ``seconds`` of processor time; -1 where it is ended."""
    child = os.fork()
    if child == 0:
        code = 1
        with contextlib.suppress(BaseException):
            resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 2))
            os.setsid()
            with open(os.devnull, "w") as nowhere:
                os.dup2(nowhere.fileno(), 1)
                os.dup2(nowhere.fileno(), 2)
            code = job()
        os._exit(code)
    signal.signal(signal.SIGALRM, lambda number, frame: os.killpg(child, signal.SIGKILL))
    # A process that sleeps uses no processor time.
    signal.alarm(int(20.0 * seconds))
    status = os.waitpid(child, 0)[1]
    signal.alarm(0)
    return os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else -1


def _play(root: Path, files: Iterable[str], order: _Order, seconds: float, keep: Path | None = None) -> int:
    """Exit code of pytest for test files of a copy; with ``keep`` all are played, and what they took is written."""
    def job() -> int:
        ours_of(root)
        sys.dont_write_bytecode = keep is None
        code = int(pytest.main(["-q", "-p", "no:cacheprovider", *(["-x"] if keep is None else []), *files],
                               plugins=[order]))
        if keep is not None:
            keep.write_text(json.dumps(order.taken), encoding="utf-8")
        return code

    return in_child(job, seconds)


def ours_of(root: Path) -> None:
    """Lets this process import our modules from a copy; libraries that are loaded stay."""
    for name in [name for name in sys.modules if name.partition(".")[0] in FOLDERS]:
        del sys.modules[name]
    os.chdir(root)
    sys.path[:] = [str(root), *(place for place in sys.path if Path(place or ".").resolve() != ROOT)]
    os.environ["PYTHONPATH"] = str(root)


@cache
def _imports(file: Path) -> frozenset[str]:
    """Modules of ours that a file names in its imports, as paths without ending."""
    modules = set()
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.ImportFrom) and node.module:
            modules |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
        elif isinstance(node, ast.Import):
            modules |= {name.name for name in node.names}
    return frozenset(name.replace(".", "/") for name in modules)


def tests_of(file: str) -> list[str]:
    """Test files for a module: those of its folder, and those that import it."""
    module = file.removesuffix(".py")
    near = ROOT / "tests" / Path(file).parent
    return [str(test.relative_to(ROOT)) for test in sorted((ROOT / "tests").rglob("test_*.py"))
            if near in test.parents or (module in _imports(test) and not {"scenes", "studies", "fuzz"} & {*test.parts})]


@cache
def compiled_with(file: str) -> tuple[str, ...]:
    """Modules whose compiled code may hold a module's."""
    users: dict[str, set[str]] = defaultdict(set)
    texts = {str(path.relative_to(ROOT).with_suffix("")): path for folder in FOLDERS[:5]
             for path in (ROOT / folder).rglob("*.py")}
    for name, path in texts.items():
        if "@jit(" in path.read_text(encoding="utf-8"):
            for used in _imports(path) & texts.keys():
                users[used].add(name)
    modules, open_ = set(), {file.removesuffix(".py")}
    while open_:
        modules |= open_
        open_ = {user for name in open_ for user in users[name]} - modules
    return tuple(sorted(modules))


def one_stamp() -> None:
    """Lets numba trust compiled code of the copy whatever its file's time; what a fault touches is taken away here."""
    caching._SourceFileBackedLocatorMixin.get_source_stamp = lambda self: (0.0, 0)


class Copy:
    """The checkout's copy, in which faults are put one at a time."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for folder in FOLDERS:
            shutil.copytree(ROOT / folder, root / folder, ignore=shutil.ignore_patterns("__pycache__"))
        for file in ROOT.glob("*.*"):
            if file.is_file():
                shutil.copy2(file, root)

    def _code(self, file: str) -> list[Path]:
        return [path for name in compiled_with(file)
                for path in (self.root / name).parent.glob(f"__pycache__/{Path(name).name}.*.nbc")]

    def killed(self, mutant: Mutant, tests: list[str], known: dict[str, float]) -> bool:
        """Whether a test notices a fault."""
        expected = min(BUDGET, sum(known[name] for name in known if name.partition("::")[0] in tests))
        seconds = LONGER * expected + STARTS + (COMPILES if mutant.compiled else 0.0)
        with self.changed(mutant.file, mutant.put_into, mutant.compiled):
            # 5: no test is left within the budget.
            return _play(self.root, tests, _Order(known, mutant.file.removesuffix(".py")), seconds) not in (0, 5)

    @contextlib.contextmanager
    def changed(self, name: str, change: Callable[[bytes], bytes], compiled: bool) -> Iterator[None]:
        """The copy with a changed file, without the code that was compiled from it."""
        file = self.root / name
        source = file.read_bytes()
        saved = {path: path.read_bytes() for path in self._code(name)} if compiled else {}
        for path in (*saved, *file.parent.glob(f"__pycache__/{file.stem}.*.pyc")):
            path.unlink()
        try:
            file.write_bytes(change(source))
            yield
        finally:
            file.write_bytes(source)
            if compiled:
                for path in self._code(name):
                    path.unlink()
                for path, code in saved.items():
                    path.write_bytes(code)


def _is_limit(mutant: Mutant) -> bool:
    return any(fnmatchcase(f"{mutant.file}:{mutant.place}", place) for place in LIMITS)


def drawn(package: str, each: int, seed: int) -> list[Mutant]:
    """Mutants of a package, the same ones however the rest of the code changes."""
    folders = PACKAGES[package] or sorted({place.partition(":")[0] for place in LIMITS})
    files = [str(path.relative_to(ROOT)) for folder in folders
             for path in (sorted((ROOT / folder).rglob("*.py")) if (ROOT / folder).is_dir() else [ROOT / folder])]
    faults = [mutant for file in files for mutant in mutants_of(ROOT, file)
              if package != "limits" or _is_limit(mutant)]
    return sorted(faults, key=lambda mutant: mutant.rank(seed))[:each]


def interval(killed: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    z = 1.96
    middle, half = killed + z * z / 2, z * np.sqrt(killed * (of - killed) / of + z * z / 4)
    return float((middle - half) / (of + z * z)), float((middle + half) / (of + z * z))


def _baseline(copy: Copy, tests: Iterable[str]) -> dict[str, float]:
    """What each test takes without a fault [s]; compiles on the way."""
    known: dict[str, float] = {}
    for test in sorted(tests):
        file = copy.root / "taken.json"
        if (code := _play(copy.root, [test], _Order({}, ""), 1200.0, file)) not in (0, 5):
            raise SystemExit(f"{test} fails without a fault (exit code {code})")
        known |= json.loads(file.read_text(encoding="utf-8"))
    return known


def mutants(packages: str = DRAWN, seed: int = 1, only: str = "") -> None:
    """Share of single faults in the code that the tests of `make test` notice, by package, with its interval.

    So many mutants of each package are drawn; ``--only TEXT`` plays those with it in their name. Survivors are printed
    as they come. Equivalent ones, which change nothing that can be observed, stand with their reason in
    ``studies/equivalent_mutants.toml`` and are drawn but not counted.
    """
    equal = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))["equivalent"]
    requested = [word.partition(":") for word in packages.split(",")]
    if wrong := [package for package, _, each in requested if package not in PACKAGES or not each.isdecimal()]:
        raise InputError(f"expected NAME:COUNT of {', '.join(PACKAGES)}", field="packages", value=wrong[0])
    chosen = {package: [m for m in drawn(package, int(each), seed) if only in m.key] for package, _, each in requested}
    tests = {m.file: tests_of(m.file) for faults in chosen.values() for m in faults}
    one_stamp()
    results: dict[str, list[bool]] = {}
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = Copy(Path(folder))
        known = _baseline(copy, {test for names in tests.values() for test in names})
        print(f"{len(known)} tests, {sum(known.values()):.0f} s without a fault", flush=True)
        for package, faults in chosen.items():
            results[package] = []
            for mutant in faults:
                if mutant.key in equal:
                    continue
                results[package].append(copy.killed(mutant, tests[mutant.file], known))
                if not results[package][-1]:
                    print(f"{package} survives, line {mutant.line}: {mutant.key}", flush=True)
    print()
    head("package", "mutants", "equivalent", "killed", "share", "95 %")
    for package, noticed in results.items():
        if noticed:
            low, high = interval(sum(noticed), len(noticed))
            row(package, len(noticed), len(chosen[package]) - len(noticed), sum(noticed),
                f"{100 * np.mean(noticed):.0f} %", f"{100 * low:.0f} to {100 * high:.0f} %")
