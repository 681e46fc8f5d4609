"""``ideal-robot`` that prints what code was compiled, or loaded, after the controller was first waited for."""

from __future__ import annotations

import sys
from typing import Any

from numba.core.dispatcher import Dispatcher

from ideal_robot.robots.interface import LinkedRobot

LATE = "loaded late: "


def watched(late: list[str]) -> None:
    """From now on ``late`` gets the names of functions that are compiled or loaded once an arm is waited for."""
    compiled, received, waiting = Dispatcher.compile, LinkedRobot.receive, []

    def compile_(self: Any, signature: Any) -> Any:
        name = f"{self.py_func.__module__}.{self.py_func.__name__}"
        if waiting and not name.startswith("numba."):
            late.append(name)
        return compiled(self, signature)

    def receive(self: Any, *args: Any) -> Any:
        waiting.append(True)
        return received(self, *args)

    Dispatcher.compile, LinkedRobot.receive = compile_, receive


if __name__ == "__main__":
    names: list[str] = []
    watched(names)
    from scenes.cli import main

    try:
        main()
    finally:
        print(LATE + " ".join(names), file=sys.stderr)
