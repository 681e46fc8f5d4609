"""The methods of scenes, which turn sensor data into commands: by key or as an object of the user's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ideal_robot.errors import InputError, RaisedBy
from ideal_robot.feedforward.base import Feedforward, tried
from ideal_robot.feedforward.method import Factory, Method, Needs, Setting
from ideal_robot.feedforward.registry import method as registered
from ideal_robot.feedforward.registry import methods as registered_methods
from ideal_robot.feedforward.registry import require, settings
from scenes.result import Progress

NONE = "none"
"""The reference path, no correction."""
DIRECT = "direct_feedback"
"""[L] (1): the sensed deviation, times a gain, is added to the command."""
SENSOR_PATH = "sensor_path"
"""The sensed path, commanded as it is."""
IDEAL = "ideal"
ADAPTED = "adapted"
"""The ideal robot with friction that follows the arm: on known paths it plays beforehand, else it learns as it goes."""
DELAY = "-delay"
"""Behind a method's key, in scenes of paths: the standard path planner's delay is in force."""
WORDS = {NONE: "no correction", IDEAL: "the ideal robot", ADAPTED: "the ideal robot adapted"}
"""What pages call the methods that all kinds of scenes have."""
PLAIN = ("precorrected", "precorrected-printed")
"""Made for known paths; sensor-based scenes play them when asked for, and leave them out of their comparisons."""


@dataclass(frozen=True)
class SceneMethod:
    """One method of turning sensor data, or a known path, into commands.

    Attributes:
        key: its name in tables, files and on the command line.
        made: a feedforward of the user's, or the factory of one; None: that of the key.
    """

    key: str
    made: Feedforward | Factory | None = None

    @property
    def senses(self) -> bool:
        """Whether the desired path comes from sensors through the follower."""
        return self.key not in (NONE, DIRECT)

    @property
    def knows_model(self) -> bool:
        """Whether the run may use the arm's model: for commands, the gears' deflection, and the camera's latency."""
        return self.key not in (NONE, DIRECT, SENSOR_PATH)

    @property
    def adapts(self) -> bool:
        """Whether the method learns from motions before the task."""
        return self.key.removesuffix(DELAY) == ADAPTED

    def feedforward(self, setting: Setting) -> Feedforward:
        """Makes the feedforward; InputError where its requirements are missing, or this arm cannot use it."""
        with RaisedBy(f"method {self.key}, as it is made and tried"):
            if isinstance(self.made, Feedforward):
                feedforward = self.made
            elif self.made is not None:
                feedforward = self.made(setting)
            else:
                key = NONE if self.key in (DIRECT, SENSOR_PATH) else self.key.removesuffix(DELAY)
                feedforward = registered(key).make(setting)
            return tried(feedforward, setting.robot.home, setting.robot.t_ipo)

    def following(self, setting: Setting) -> Feedforward:
        """Makes the feedforward of a run that knows its path over a horizon only.

        Raises InputError where it needs more: the whole path, runs beforehand, or a longer horizon.
        """
        feedforward = self.feedforward(setting)
        if setting.n_d is not None and feedforward.n_d > setting.n_d and not feedforward.extends:
            raise InputError(f"the scene knows {setting.n_d} desired positions ahead, {self.key} needs more",
                             field="n_d", value=feedforward.n_d)
        return feedforward


def following_methods() -> tuple[str, ...]:
    """Keys of the methods that can follow sensors: without correction, and those that need a model at most."""
    return (SENSOR_PATH, IDEAL, ADAPTED,
            *(key for key in (*registered_methods(Needs.MODEL), *settings(Needs.MODEL))
              if key not in (NONE, IDEAL, ADAPTED)))


def method_of(wanted: Any, allowed: Sequence[str]) -> SceneMethod:
    """The method of a key or an object; InputError for no such key.

    Args:
        wanted: one of ``allowed``, a ``Feedforward``, or a factory of one that is called with a ``Setting``.
        allowed: keys of the kind of scene.
    """
    if isinstance(wanted, SceneMethod):
        return wanted
    if isinstance(wanted, str):
        require(wanted, allowed)
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
    """The methods of a comparison; InputError for no such method, or two of one name.

    Args:
        wanted: the caller's choice; None for all.
        allowed: keys of the kind of scene.
        left_out: keys that are compared only if chosen.
    """
    every = [key for key in allowed if key not in left_out]
    chosen = [method_of(choice, allowed) for choice in (every if wanted is None else wanted)]
    for i, method in enumerate(chosen):
        if method.key in {other.key for other in chosen[:i]}:
            raise InputError("two methods have that name; give one of the classes another", field="methods",
                             value=method.key)
    return chosen


@dataclass(frozen=True)
class GainTrial:
    """One pair of gains and its error; infinite where the run failed."""

    k_p: float
    k_d: float
    error: float


class GainSearch:
    """Tries gains one after another and stores the trials.

    Args:
        error: the error of a pair K_p, K_d in the scene; infinite or NaN where it fails.
        total: trials to expect, for the progress.
        progress: called after each trial.
    """

    def __init__(self, error: Callable[[float, float], float], total: int, progress: Progress) -> None:
        self._error, self._total, self._progress = error, total, progress
        self.trials: list[GainTrial] = []

    def scan(self, k_p: Sequence[float], k_d: Sequence[float] = (0.0,)) -> None:
        """Tries every K_p with every K_d."""
        for p in k_p:
            for d in k_d:
                error = self._error(p, d)
                self.trials.append(GainTrial(p, d, error if np.isfinite(error) else float("inf")))
                self._progress(min(len(self.trials) / self._total, 1.0), "searching the gains of direct feedback")

    def between(self, k_p: Sequence[float]) -> None:
        """Tries the geometric means of the best K_p and its neighbours in ``k_p``, which was scanned."""
        best = list(k_p).index(self.best().k_p)
        self.scan([float(np.sqrt(k_p[best] * k_p[other])) for other in (best - 1, best + 1) if 0 <= other < len(k_p)])

    def ranked(self) -> list[GainTrial]:
        """All trials, the best first."""
        return sorted(self.trials, key=lambda trial: trial.error)

    def best(self) -> GainTrial:
        """The trial with the smallest error; the first one of equals."""
        return self.ranked()[0]
