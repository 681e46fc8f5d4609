"""How much of the program a job goes through: what whoever carries it on has to open to follow it."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import sys
import tempfile
from pathlib import Path
from types import FrameType

from scenes import load_scene, shipped_model
from scenes.cli import main
from studies.report import head, row

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("ideal_robot", "sensing", "planning", "sim", "scenes")


def walks(scenes: str = "line,force_wave,iso9283_1", which: bool = False) -> None:
    """Files and rooms that a verb goes through: scenes from the command line into their run, a recording's diagnosis.

    A file counts in which a function is called, a room is the folder it is in. What runs at import, what compiled
    functions call and other processes do not count. --which lists rooms and files.
    """
    for package in PACKAGES:
        for module in pkgutil.walk_packages([str(ROOT / package)], f"{package}."):
            importlib.import_module(module.name)
    head("walk", "files", "rooms")
    with tempfile.TemporaryDirectory() as folder:
        for name in scenes.split(","):
            _shown(f"run {name}", _walked("run", name, "--out", f"{folder}/{name}"), which)
        known = ["--robot", (robot := load_scene(name).robot), "--model", str(shipped_model(robot))]
        recording = next(Path(folder, name).rglob("*.parquet"))
        _shown("diagnose", _walked("diagnose", str(recording), *known, "--out", f"{folder}/diagnosis"), which)


def _walked(*words: str) -> list[Path]:
    """Files of the program in which functions are called while a verb does its job."""
    met: set[str] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code.co_flags & inspect.CO_OPTIMIZED:
            met.add(frame.f_code.co_filename)

    before, sys.argv = sys.argv, ["ideal-robot", *words]
    sys.setprofile(note)
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
    finally:
        sys.setprofile(None)
        sys.argv = before
    return sorted(Path(one).relative_to(ROOT) for one in met if one.startswith(tuple(f"{ROOT / p}/" for p in PACKAGES)))


def _shown(name: str, files: list[Path], which: bool) -> None:
    rooms = {str(room): [one.name for one in files if one.parent == room] for room in {one.parent for one in files}}
    row(name, len(files), len(rooms))
    for room, names in sorted(rooms.items()) if which else ():
        print(f"  {room}: {', '.join(names)}")
