"""``ideal-robot`` that prints what code was compiled, or loaded, after the controller was first waited for."""

from __future__ import annotations

import sys
from typing import Any

from numba.core.dispatcher import Dispatcher

from ideal_robot.robots.interface import LinkedRobot

LATE = "loaded late: "


def watched(late: list[str], waiting: list[bool]) -> None:
    """From now on ``late`` gets the names of functions that are compiled or loaded once ``waiting`` is not empty."""
    compiled = Dispatcher.compile

    def compile_(self: Any, signature: Any) -> Any:
        if waiting:
            late.append(f"{self.py_func.__module__}.{self.py_func.__name__}")
        return compiled(self, signature)

    Dispatcher.compile = compile_


def waited_for(waiting: list[bool]) -> None:
    """From now on ``waiting`` says that an arm is waited for."""
    received = LinkedRobot.receive

    def receive(self: Any, *args: Any) -> Any:
        waiting.append(True)
        return received(self, *args)

    LinkedRobot.receive = receive


if __name__ == "__main__":
    names, waits = list[str](), list[bool]()
    watched(names, waits)
    waited_for(waits)
    from scenes.cli import main

    try:
        main()
    finally:
        print(LATE + " ".join(name for name in names if not name.startswith("numba.")), file=sys.stderr)
