"""Functions by name, for processes that need what the one that starts them shall not load."""

from __future__ import annotations

import importlib
from typing import Any


def called(name: str, *given: Any) -> Any:
    """Calls a function of another process's own; its module is loaded there alone.

    Args:
        name: ``module:function``.
        given: what it is called with.
    """
    module, _, function = name.partition(":")
    return getattr(importlib.import_module(module), function)(*given)
