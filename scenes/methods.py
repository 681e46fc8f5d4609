"""The methods of scenes: how what is sensed becomes commands, by key or as an object of the user's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.method import Factory, Method, Needs, Setting
from ideal_robot.feedforward.registry import method as registered
from ideal_robot.feedforward.registry import methods as registered_methods

NONE = "none"
"""The reference path, no correction."""
DIRECT = "direct_feedback"
"""[L] (1): the sensed deviation, times a gain, is added to the command."""
SENSOR_PATH = "sensor_path"
"""The sensed path, commanded as it is."""
IDEAL = "ideal"
ADAPTED = "adapted"
"""The ideal robot with friction that follows the arm: on known paths it plays beforehand, else it learns as it goes."""
PLAIN = ("precorrected_1", "precorrected")
"""Made for known paths; sensor-based scenes play them when asked for, and leave them out of their comparisons."""


@dataclass(frozen=True)
class SceneMethod:
    """One way of turning what is sensed, or a known path, into commands.

    Attributes:
        key: its name in tables, files and on the command line.
        made: a feedforward of the user's, or the factory of one; None: what the key says.
    """

    key: str
    made: Feedforward | Factory | None = None

    @property
    def senses(self) -> bool:
        """Whether the desired path is what the follower makes of the sensors."""
        return self.key not in (NONE, DIRECT)

    @property
    def knows_model(self) -> bool:
        """Whether the play may use the arm's model: for the commands, the gears' deflection, the camera's latency."""
        return self.key not in (NONE, DIRECT, SENSOR_PATH)

    @property
    def adapts(self) -> bool:
        """Whether what the arm showed before the job is learned from."""
        return self.key.removesuffix("_delay") == ADAPTED

    def feedforward(self, setting: Setting) -> Feedforward:
        """Makes the feedforward.

        Raises:
            InputError: something that it needs is missing.
        """
        if isinstance(self.made, Feedforward):
            return self.made
        if self.made is not None:
            return self.made(setting)
        key = NONE if self.key in (DIRECT, SENSOR_PATH) else self.key.removesuffix("_delay")
        return registered(key).make(setting)

    def following(self, setting: Setting) -> Feedforward:
        """Makes the feedforward of a play that knows its path over a horizon only.

        Raises:
            InputError: it needs more than there is: the whole path, plays beforehand, or a longer horizon.
        """
        found = self.feedforward(setting)
        if setting.n_d is not None and found.n_d > setting.n_d:
            raise InputError(f"the scene knows {setting.n_d} desired positions ahead, {self.key} wants more",
                             field="n_d", value=found.n_d)
        return found


def following_methods() -> tuple[str, ...]:
    """Keys of the methods that follow what is sensed: the sensed path alone, and what needs no more than a model."""
    return (SENSOR_PATH, IDEAL, ADAPTED,
            *(key for key in registered_methods(Needs.MODEL) if key not in (NONE, IDEAL, ADAPTED)))


def method_of(wanted: Any, allowed: Sequence[str]) -> SceneMethod:
    """The method that a caller asks for.

    Args:
        wanted: one of ``allowed``, a ``Feedforward``, or a factory of one that is called with a ``Setting``.
        allowed: keys of the kind of scene.

    Raises:
        InputError: no such key.
    """
    if isinstance(wanted, SceneMethod):
        return wanted
    if isinstance(wanted, str):
        if wanted not in allowed:
            raise InputError(f"expected one of {', '.join(allowed)}, or a Feedforward", field="method", value=wanted)
        return SceneMethod(wanted)
    if isinstance(wanted, Feedforward):
        return SceneMethod(type(wanted).__name__, wanted)
    if isinstance(wanted, Method):
        return SceneMethod(getattr(wanted.make, "__name__", "method"), wanted.make)
    if callable(wanted):
        return SceneMethod(getattr(wanted, "__name__", type(wanted).__name__), wanted)
    raise InputError(f"expected one of {', '.join(allowed)}, a Feedforward or a factory of one", field="method",
                     value=type(wanted).__name__)


def compared(wanted: Sequence[Any] | None, allowed: Sequence[str], left_out: Sequence[str] = ()) -> list[SceneMethod]:
    """The methods of a comparison.

    Args:
        wanted: those that a caller asks for; None for all.
        allowed: keys of the kind of scene.
        left_out: keys that are compared only where they are asked for.

    Raises:
        InputError: no such method, or two of one name.
    """
    every = [key for key in allowed if key not in left_out]
    found = [method_of(one, allowed) for one in (every if wanted is None else wanted)]
    for i, one in enumerate(found):
        if one.key in {other.key for other in found[:i]}:
            raise InputError("two methods have that name; give one of the classes another", field="methods",
                             value=one.key)
    return found
