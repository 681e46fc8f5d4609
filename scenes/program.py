"""The running program: whether imports find its folders, its version, and the machine, for files of results."""

from __future__ import annotations

import hashlib
import platform
import subprocess
import sys
import sysconfig
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ideal_robot.errors import InputError

SCHEMA = 1
"""Counts the layouts of files of results."""
TIMES = ("real_time_factor", "cycle_time_ms", "compute_time_ms", "seconds")
PLACES = ("recording", "report", "urdf", "output", "motion")
"""Keys of an answer that say how long it took and where files lie; they stand apart from results."""
ROOMS = ("ideal_robot", "planning", "scenes", "sensing", "sim")
"""Folders of what is installed; a run depends on nothing else of ours."""
_ROOT = Path(__file__).parents[1]


@cache
def program() -> dict[str, str | None]:
    """Version of the program, commit of the checkout (None where it is installed), digest of all its sources."""
    from importlib import metadata

    return {"version": metadata.version("ideal-robot"), "commit": _commit(), "digest": _source_digest()}


def _commit() -> str | None:
    if (_ROOT / ".git").exists():
        with suppress(OSError, subprocess.SubprocessError):
            return subprocess.run(["git", "-C", str(_ROOT), "describe", "--always", "--dirty", "--abbrev=12"],
                                  capture_output=True, text=True, check=True, timeout=10.0).stdout.strip()
    return None


def _source_digest() -> str:
    digest = hashlib.sha256()
    for path in sorted(path for room in ROOMS for path in (_ROOT / room).rglob("*")):
        if path.suffix in (".py", ".toml", ".urdf", ".json") and path.is_file():
            digest.update(str(path.relative_to(_ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def machine() -> dict[str, str]:
    """The machine: kind of processor, system, Python, and the libraries that decide the last digits."""
    from importlib import metadata

    libraries = {name: metadata.version(name) for name in ("numpy", "scipy", "numba", "pin", "pybullet")}
    return {"processor": platform.machine(), "system": platform.system(), "python": platform.python_version(),
            **libraries}


ORIGIN = ("version", "commit", "digest", "computer", "when")
"""What ``origin`` says."""


def origin() -> dict[str, str | None]:
    """The program, the computer, and the time (UTC): the keys of ``ORIGIN``."""
    return {**program(), "computer": platform.node() or platform.machine(),
            "when": datetime.now(UTC).isoformat(timespec="seconds")}


def signed(content: dict[str, Any]) -> dict[str, Any]:
    """The content of a ``--json``, with its layout and the program that computed it, results before times and places.

    It is of one run; or of several, in a list ``runs`` or a table ``methods``.
    """
    apart = told_apart(content)
    if isinstance(runs := content.get("runs"), list):
        apart["runs"] = [told_apart(run) for run in runs]
    if isinstance(methods := content.get("methods"), dict):
        apart["methods"] = {key: told_apart(answer) for key, answer in methods.items()}
    return {"schema": SCHEMA, "program": program(), **apart}


def told_apart(answer: dict[str, Any]) -> dict[str, Any]:
    """Splits an answer into results, then ``times`` and ``files`` as tables of their own where there are any.

    >>> told_apart({"report": "out/report.html", "seed": 1, "seconds": 0.2})
    {'seed': 1, 'times': {'seconds': 0.2}, 'files': {'report': 'out/report.html'}}
    """
    groups = {"times": TIMES, "files": PLACES}
    apart = {name: {key: answer[key] for key in keys if key in answer} for name, keys in groups.items()}
    results = {key: value for key, value in answer.items() if key not in (*TIMES, *PLACES)}
    return results | {name: group for name, group in apart.items() if group}


def example_files() -> list[Path]:
    """The shipped examples: of the checkout, or where the wheel was installed; InputError where they are not."""
    beside = [_ROOT / "examples"] if (_ROOT / "pyproject.toml").is_file() else []
    data = Path("share", "ideal-robot", "examples")
    for folder in (*beside, _ROOT / data, Path(sysconfig.get_path("data")) / data):
        if folder.is_dir():
            return sorted(path for path in folder.iterdir() if path.is_file())
    raise InputError("the examples were not installed; they are in the folder examples of the repository",
                     file=_ROOT / data)


# Folders of the user's that hide this program's packages: a repository with a ``sim`` of its own.

def _hidden() -> dict[str, str]:
    """What is found in place of our packages: name → place."""
    hidden = {}
    for room in ROOMS:
        spec = find_spec(room)
        places = [] if spec is None else list(spec.submodule_search_locations or [str(spec.origin)])
        if not any(Path(place).resolve() == (_ROOT / room).resolve() for place in places):
            hidden[room] = places[0] if places else "nothing"
    return hidden


def check_rooms() -> None:
    """Raises InputError where imports find a folder of the same name instead of a package of this program."""
    for room, place in _hidden().items():
        raise InputError(f"hides the package {room} of ideal-robot, which is looked for by that name; rename it, start "
                         "from another folder, or call the program ideal-robot, which finds its own", file=place)


def find_ours_first() -> None:
    """Puts this program's packages before folders of the same names on the import path of this process."""
    if _hidden():
        sys.path.insert(0, str(_ROOT))
