"""The registry of methods: every way of correcting a path by its key, with those of other packages.

The keys are the same everywhere: in ``ir.feedforward``, ``--method``, comparisons and JSON. Behind a key, ``-`` and a
setting choose the method as a paper prints it, or stopped earlier (``precorrected-printed``, ``learned-2``): see
``Method.settings``. Scenes of paths have one more, ``-delay``: the standard path planner's delay is active.

A package outside adds a method by ``register``, or by an entry point whose value is a ``Method`` or a factory:

    [project.entry-points."ideal_robot.feedforward"]
    my_method = "my_package.my_module:MyFeedforward"
"""

from __future__ import annotations

from collections.abc import Sequence

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.method import Factory, Method, Needs, Practice, Setting
from ideal_robot.model.model import Model
from ideal_robot.progress import Progress, silent
from ideal_robot.registry import Registry
from ideal_robot.robots.robot import Robot

SETTING = "-"
"""Between a method and its setting; no key can hold it."""
_KEYS = ("none", "linear", "trained", "precorrected", "learned", "ideal", "adapted")
_BEFORE = {"precorrected_1": "precorrected-printed", "linear_1": "linear-printed", "trained_1": "trained-printed",
           "model_learned": "learned-model", "learned_1": "learned-1", "learned_2": "learned-2",
           "learned_3": "learned-3", "learned_4": "learned"}
"""Keys of earlier versions, and what is written today."""
_REGISTRY: Registry[Method | Factory] = Registry(
    "method", "ideal_robot.feedforward", {key: f"ideal_robot.feedforward.built_in:{key.upper()}" for key in _KEYS},
    "lower case letters, digits and underscores, and no key of an earlier version",
    lambda key: key.isidentifier() and key == key.lower() and not key.endswith("_delay") and key not in _BEFORE)


def methods(needs: Needs = Needs.PLAYS) -> tuple[str, ...]:
    """Keys of all methods with no more requirements than ``needs``, those of this project first.

    >>> "learned" in methods(Needs.PATH), "learned" in methods(Needs.PLAYS)
    (False, True)
    """
    if needs == Needs.PLAYS:
        return _REGISTRY.names()
    return tuple(key for key in _REGISTRY.names() if method(key).needs <= needs)


def settings(needs: Needs = Needs.PLAYS) -> tuple[str, ...]:
    """Keys of all settings of methods with no more requirements than ``needs``.

    >>> settings(Needs.MODEL)
    ('precorrected-printed',)
    """
    return tuple(f"{key}{SETTING}{name}" for key in _REGISTRY.names() for name, other in method(key).settings.items()
                 if other.needs <= needs)


def method(key: str) -> Method:
    """The method of a key, with or without a setting.

    Raises:
        InputError: there is no such method or setting; the message lists them, or has the new name of an old key.
    """
    base, dash, setting = key.partition(SETTING)
    if key not in _REGISTRY:
        require(base, _REGISTRY.names())
    entry = _REGISTRY.get(base)
    found = entry if isinstance(entry, Method) else _described(entry)
    if not dash:
        return found
    if setting not in found.settings:
        names = ", ".join(f"{base}{SETTING}{name}" for name in found.settings)
        raise InputError(f"{base} has no such setting; " + (f"there are {names}" if names else "it has none"),
                         field="method", value=key)
    return found.settings[setting]


def require(key: str, allowed: Sequence[str], field: str = "method") -> None:
    """Raises InputError for a key that is not allowed.

    Args:
        key: of a method, with its setting or without.
        allowed: keys, settings behind those that have them.
        field: name of the setting that named it.
    """
    if key in allowed:
        return
    today = key.removesuffix("_delay")
    today = _BEFORE.get(today, today) + (f"{SETTING}delay" if key.endswith("_delay") else "")
    if today != key and today.partition(SETTING)[0] in _KEYS:
        raise InputError(f"is a setting of a method today: write {today}", field=field, value=key)
    plain, further = ([name for name in allowed if (SETTING in name) == is_setting] for is_setting in (False, True))
    raise InputError(f"expected one of {', '.join(plain)}" + (f", or with a setting: {', '.join(further)}" if further
                                                              else ""), field=field, value=key)


def register(key: str, factory: Factory | Method, *, description: str = "", needs: Needs = Needs.MODEL) -> None:
    """Adds a method; raises InputError where one of that name exists, or the name cannot be a key.

    Args:
        key: its name; lower case, digits and underscores.
        factory: makes the feedforward of a ``Setting``; or a whole ``Method``.
        description: one line for help texts and tables; the first line of the factory's docstring if empty.
        needs: its requirements, which decide where it can be used.
    """
    _REGISTRY.register(key, factory if isinstance(factory, Method) else _described(factory, description, needs))


def unregister(key: str) -> None:
    """Removes a method that ``register`` added."""
    _REGISTRY.unregister(key)


def feedforward(key: str, model: Model | None, robot: Robot, *, n_d: int | None = None, delay: int = 0,
                q_d: Array | None = None, q_c: Array | None = None, practice: Practice | None = None,
                progress: Progress = silent) -> Feedforward:
    """Makes the feedforward of a method.

    Args:
        key: one of ``methods()``.
        model: identified model of the arm; None where the method needs none.
        robot: the arm; cycle times and limits.
        n_d: length of the horizon that will be given; None where the method may choose.
        delay: cycles between hand-over of a command and the start of its interpolation ([G] 5.2.3).
        q_d: the path at the cycles ``(N, n)`` [rad], for methods that are made for one path.
        q_c: commands ``(N, n)`` [rad] that learning starts from; the path itself if None.
        practice: runs on the arm, for methods that learn there.
        progress: called with the share of the making that is done.

    Raises:
        InputError: no such method, something it needs is missing, or a model of another arm.
    """
    if n_d is not None and n_d < 1:
        raise InputError("the horizon needs at least one row", field="n_d", value=n_d)
    return method(key).make(Setting(robot, model, n_d, delay, q_d, q_c, practice, progress))


def _described(factory: Factory, description: str = "", needs: Needs = Needs.MODEL) -> Method:
    first = (getattr(factory, "__doc__", None) or "").strip().partition("\n")[0]
    return Method(factory, description or first, needs)
