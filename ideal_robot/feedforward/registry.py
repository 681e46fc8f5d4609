"""Every way of correcting a path by its key: those of this project, and those that other packages add.

The keys are the same everywhere: in ``ir.feedforward``, ``--method``, comparisons and JSON. A suffix ``_delay``, which
scenes know, says that the standard path planner's delay is in force; it is no method of its own.

A package outside adds a method by ``register``, or by an entry point whose value is a ``Method`` or a factory:

    [project.entry-points."ideal_robot.feedforward"]
    my_method = "my_package.my_module:MyFeedforward"
"""

from __future__ import annotations

from ideal_robot.arrays import Array
from ideal_robot.errors import InputError
from ideal_robot.feedforward.base import Feedforward
from ideal_robot.feedforward.method import Factory, Method, Needs, Practice, Setting
from ideal_robot.model.model import Model
from ideal_robot.progress import Progress, silent
from ideal_robot.registry import Registry
from ideal_robot.robots.robot import Robot

_KEYS = ("none", "linear", "linear_1", "trained", "trained_1", "precorrected_1", "precorrected", "model_learned",
         "learned_1", "learned_2", "learned_3", "learned_4", "ideal", "adapted")
_REGISTRY: Registry[Method | Factory] = Registry(
    "method", "ideal_robot.feedforward", {key: f"ideal_robot.feedforward.built_in:{key.upper()}" for key in _KEYS},
    "lower case letters, digits and underscores, and no ending _delay",
    lambda key: key.isidentifier() and key == key.lower() and not key.endswith("_delay"))


def methods(needs: Needs = Needs.PLAYS) -> tuple[str, ...]:
    """Keys of all methods that need no more than ``needs``, those of this project first.

    >>> "learned_1" in methods(Needs.PATH), "learned_1" in methods(Needs.PLAYS)
    (False, True)
    """
    if needs == Needs.PLAYS:
        return _REGISTRY.names()
    return tuple(key for key in _REGISTRY.names() if method(key).needs <= needs)


def method(key: str) -> Method:
    """What a key stands for; raises InputError, which lists the methods there are, where it is none of them."""
    entry = _REGISTRY.get(key)
    return entry if isinstance(entry, Method) else _described(entry)


def register(key: str, factory: Factory | Method, *, description: str = "", needs: Needs = Needs.MODEL) -> None:
    """Adds a method; raises InputError where one of that name exists, or the name cannot be a key.

    Args:
        key: its name; lower case, digits and underscores.
        factory: makes the feedforward of a ``Setting``; or a whole ``Method``.
        description: one line for help texts and tables; the first line of the factory's docstring if empty.
        needs: what has to be there, which says where it applies.
    """
    _REGISTRY.register(key, factory if isinstance(factory, Method) else _described(factory, description, needs))


def unregister(key: str) -> None:
    """Takes out what ``register`` added."""
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
        practice: plays on the arm, for methods that learn there.
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
