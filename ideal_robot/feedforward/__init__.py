"""Feedforward: from desired positions over a horizon to the command, by every method.

The package itself can be called to make a feedforward by its key:

    ideal_robot.feedforward("ideal", model, robot)

which is ``ideal_robot.feedforward.registry.feedforward``; package and function have to share the name.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


class _CallablePackage(ModuleType):
    """The type of this package, which can be called: ``feedforward(key, …)``, see the registry."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return import_module(f"{__name__}.registry").feedforward(*arguments, **options)


sys.modules[__name__].__class__ = _CallablePackage
