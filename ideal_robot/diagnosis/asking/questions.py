"""What a diagnosis leaves open: causes that it could not tell apart, and joints that it could not decide."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ideal_robot.diagnosis.validation.result import Diagnosis
from ideal_robot.effects.base import prefix_of
from ideal_robot.effects.registry import names
from ideal_robot.errors import InputError

_ELSEWHERE = re.compile(r"(?P<name>\w+) of joint (?P<joint>\d+)")
"""How a rival at another joint is written in ``indistinguishable_from``."""


@dataclass(frozen=True)
class Named:
    """A cause that a diagnosis names, without its numbers.

    Attributes:
        name: of the effect.
        joint: from 1; 0 for the whole arm.
        prefix: of the channel it was found in.
        rivals: names of what the data could not tell from it; with the joint where that is another one.
    """

    name: str
    joint: int
    prefix: str
    rivals: tuple[tuple[str, int | None], ...] = ()


@dataclass(frozen=True)
class Open:
    """What a diagnosis found and left open.

    Attributes:
        found: the causes it names, in its order.
        undecided: joints (from 1) that moved too little.
    """

    found: tuple[Named, ...] = ()
    undecided: tuple[int, ...] = ()

    @property
    def asks(self) -> bool:
        """Whether anything is open."""
        return bool(self.undecided) or any(one.rivals for one in self.found)


def open_questions(diagnosis: Diagnosis) -> Open:
    """What a diagnosis found and left open."""
    found = tuple(Named(one.fitted.name, one.fitted.joint, prefix_of(one.fitted.channel),
                        tuple(_rival(rival) for rival in one.indistinguishable_from)) for one in diagnosis.effects)
    return Open(found, tuple(sorted(diagnosis.undecided)))


def read_questions(values: Any, n: int, file: Any = None) -> Open:
    """What the JSON of ``diagnose`` says was found and left open.

    Args:
        values: its content.
        n: joints of the arm.
        file: where it was read, for messages.

    Raises:
        InputError: it is no such content, or of another arm or version.
    """
    if not isinstance(values, Mapping) or not isinstance(values.get("effects"), list):
        raise InputError("expected the JSON that ideal-robot diagnose --json wrote", file=file, field="effects")
    known, found = set(names()), []
    for i, entry in enumerate(values["effects"]):
        place = f"effects.{i}"
        if not isinstance(entry, Mapping):
            raise InputError("expected an effect with name and joint", file=file, field=place)
        name, joint, rivals = entry.get("effect"), entry.get("joint"), entry.get("indistinguishable_from", [])
        if not isinstance(name, str) or name not in known:
            raise InputError(f"no such effect; known are {', '.join(sorted(known))}", file=file,
                             field=f"{place}.effect", value=str(name)[:60])
        if not _is_joint(joint, 0, n):
            raise InputError(f"expected a joint from 0 (the whole arm) to {n}", file=file, field=f"{place}.joint",
                             value=str(joint)[:60])
        if not isinstance(rivals, list) or not all(isinstance(rival, str) for rival in rivals):
            raise InputError("expected a list of effects", file=file, field=f"{place}.indistinguishable_from")
        named = tuple(_rival(rival) for rival in rivals)
        for rival, other in named:
            if rival not in known or (other is not None and not 0 <= other <= n):
                raise InputError("no such effect at a joint of this arm", file=file,
                                 field=f"{place}.indistinguishable_from", value=rival[:60])
        found.append(Named(name, int(str(joint)), prefix_of(str(entry.get("channel", ""))), named))
    return Open(tuple(found), _undecided(values.get("undecided", []), n, file))


def _undecided(entries: Any, n: int, file: Any) -> tuple[int, ...]:
    if not isinstance(entries, list):
        raise InputError("expected a list of joints", file=file, field="undecided")
    joints: list[Any] = [entry.get("joint") if isinstance(entry, Mapping) else None for entry in entries]
    for joint in joints:
        if not _is_joint(joint, 1, n):
            raise InputError(f"expected a joint from 1 to {n}", file=file, field="undecided", value=str(joint)[:60])
    return tuple(sorted(set(joints)))


def _is_joint(value: Any, first: int, last: int) -> bool:
    """Whether a value is a joint's number; a truth value is none."""
    return isinstance(value, int) and not isinstance(value, bool) and first <= value <= last


def _rival(text: str) -> tuple[str, int | None]:
    match = _ELSEWHERE.fullmatch(text)
    return (match["name"], int(match["joint"])) if match else (text, None)
