"""The errors of the package: one root, with bad input separate from failures at run time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path

BAD_ADDRESS = (OSError, OverflowError, TypeError, UnicodeError)
"""What sockets raise for an address that cannot be: no such host, no such port, no text."""


class IdealRobotError(Exception):
    """Root of all errors raised on purpose; the command line turns it into one line and exit code 1."""


class InputError(IdealRobotError):
    """Something the user gave cannot be used; the command line turns it into one line and exit code 2.

    Args:
        message: the finding, the expectation and the remedy.
        file: the file in question, if any.
        field: the key, column or option in question, if any.
        value: the offending value, if it is short enough to show.

    >>> print(InputError("expected a positive number", file="arm.toml", field="t_ipo", value=-1))
    arm.toml: t_ipo: expected a positive number (got -1)
    """

    def __init__(
        self, message: str, *, file: str | Path | None = None, field: str | None = None, value: object = None
    ) -> None:
        self.message = message
        self.file = None if file is None else Path(file)
        self.field = field
        self.value = value
        where = ": ".join(str(part) for part in (file, field) if part is not None)
        shown = "" if value is None else f" (got {value!r})"
        super().__init__(f"{where}: {message}{shown}" if where else f"{message}{shown}")


def did_you_mean(wanted: str, names: Iterable[str]) -> str:
    """A question that proposes the name nearest to a misspelt one; empty where none is near.

    >>> did_you_mean("strait", ["line", "straight"])
    "did you mean 'straight'? "
    """
    near = get_close_matches(wanted, list(names), 1)
    return f"did you mean {near[0]!r}? " if near else ""


@contextmanager
def found_in(file: str | Path | None) -> Iterator[None]:
    """Adds a file name to InputErrors without one that are raised within the block.

    >>> with found_in("arm.toml"):
    ...     raise InputError("must be positive", field="t_ipo")
    Traceback (most recent call last):
    ideal_robot.errors.InputError: arm.toml: t_ipo: must be positive
    """
    try:
        yield
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.message, file=file, field=error.field, value=error.value) from error


class RaisedBy:
    """Notes on exceptions raised within the block which part, perhaps of another package, raised them, and when.

    It is used in control cycles, where a ``contextmanager`` costs four times as much.
    """

    __slots__ = ("part",)

    def __init__(self, part: str) -> None:
        self.part = part

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, Exception):
            error.add_note(self.part)


def described(error: BaseException) -> str:
    """The error's message; for unexpected errors also the type and the part that raised it (``RaisedBy``).

    >>> try:
    ...     with RaisedBy("method mine: step"):
    ...         [][1]
    ... except IndexError as error:
    ...     print(described(error))
    method mine: step: IndexError: list index out of range
    """
    parts = () if isinstance(error, IdealRobotError) else (*getattr(error, "__notes__", ())[:1], type(error).__name__)
    return ": ".join([*parts, str(error)])


class LimitError(IdealRobotError):
    """A command would exceed a limit of the robot.

    Args:
        joint: joint counted from 1, or 0 where the whole arm is meant.
        quantity: what is limited, with unit, e.g. ``"velocity [rad/s]"``.
        value, limit: the requested value, and the limit.
        remedy: what the user can do.
    """

    def __init__(self, joint: int, quantity: str, value: float, limit: float, remedy: str) -> None:
        self.joint, self.quantity, self.value, self.limit, self.remedy = joint, quantity, value, limit, remedy
        super().__init__(f"joint {joint}: {quantity} {value:.4g} is outside the limit {limit:.4g}; {remedy}")
