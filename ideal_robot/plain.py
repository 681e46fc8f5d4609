"""Plain values: what JSON can hold, from whatever results are made of."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np


def plain(value: Any, digits: int | None = None) -> Any:
    """The value as dictionaries, lists, numbers and strings; non-finite numbers as None.

    Args:
        value: dataclasses, arrays, paths and what they are nested in.
        digits: significant digits of numbers; all of them if None.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {entry.name: plain(getattr(value, entry.name), digits) for entry in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): plain(item, digits) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, digits) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), digits)
    if isinstance(value, np.generic):
        return plain(value.item(), digits)
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if digits is None else float(f"{value:.{digits}g}")
    return value if value is None or isinstance(value, (str, int)) else str(value)
