"""What was handed to a function, where people may hand over something else: a clear error instead of a late one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording


def recordings_of(given: Recording | Sequence[Recording], field: str) -> tuple[Recording, ...]:
    """One recording or several, as a tuple.

    Args:
        given: what was handed over.
        field: the argument's name, for the message.

    Raises:
        InputError: it is something else.
    """
    if isinstance(given, Recording):
        return (given,)
    if not isinstance(given, (list, tuple)):
        raise InputError("expected a recording or a list of them; make one of a DataFrame by Recording.from_frame, "
                         "of arrays by Recording.from_arrays, of a file by Recording.read", field=field,
                         value=type(given).__name__)
    for i, one in enumerate(given):
        expect(one, Recording, f"{field}[{i}]", "make one by Recording.from_frame, from_arrays or read")
    return tuple(given)


def expect(given: Any, kind: type, field: str, remedy: str) -> None:
    """Refuses what is of another kind.

    Args:
        given: what was handed over.
        kind: what was expected.
        field: the argument's name.
        remedy: what to do instead.

    Raises:
        InputError: it is of another kind.
    """
    if not isinstance(given, kind):
        raise InputError(f"expected a {kind.__name__}; {remedy}", field=field, value=type(given).__name__)
