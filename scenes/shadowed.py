"""Folders of a user's that hide ours of the same name: a repository with a ``sim`` of its own."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

from ideal_robot.errors import InputError

_ROOT = Path(__file__).parents[1]
_ROOMS = ("ideal_robot", "planning", "scenes", "sensing", "sim")


def _hidden() -> dict[str, str]:
    """What is found in place of our packages: name → place."""
    found = {}
    for room in _ROOMS:
        spec = find_spec(room)
        places = [] if spec is None else list(spec.submodule_search_locations or [str(spec.origin)])
        if not any(Path(place).resolve() == (_ROOT / room).resolve() for place in places):
            found[room] = places[0] if places else "nothing"
    return found


def check_rooms() -> None:
    """Makes sure that our packages are those that imports find.

    Raises:
        InputError: a folder of the same name stands before one of them.
    """
    for room, place in _hidden().items():
        raise InputError(f"hides the package {room} of ideal-robot, which is looked for by that name; rename it, start "
                         "from another folder, or call the program ideal-robot, which finds its own", file=place)


def find_ours_first() -> None:
    """Of a process that is ours alone: puts our packages before folders of the same names."""
    if _hidden():
        sys.path.insert(0, str(_ROOT))
