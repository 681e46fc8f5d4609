"""Changes a model's joint controllers to those identified from a motion, and describes the difference."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from ideal_robot.command.words import beyond_cascade
from ideal_robot.identification.whole_model import with_controllers
from ideal_robot.model.cascade import Cascade, beside_cascade
from ideal_robot.model.model import Model
from ideal_robot.robots.robot import Robot
from ideal_robot.signals.recording import Recording
from scenes.closing.loop import Form, Place

DRIVES: Place = ("joint_controllers", 0)
"""What is called a change of the controllers, which are no effect."""
_SHOWN_LATE, _SHOWN_LAG, _SHOWN_SHARE = 5e-4, 2e-3, 0.1
"""Smallest change of a delay and of a lag [s], of a share of the velocity and of a gain that is reported."""


def controllers_anew(known: Model, moved: Recording, robot: Robot) -> Form | None:
    """The change that replaces the joint controllers by those identified from a motion; None where there are none.

    Args:
        known: the model as it was.
        moved: the motion.
        robot: the arm.
    """
    found = with_controllers(known, moved, robot)
    if found is None:
        return None
    label = "joint controllers" + (f": {words}" if (words := differing(known, found)) else "")
    return Form(label, lambda model, _: dataclasses.replace(model, controller=found.controller, command=found.command),
                (DRIVES,))


def differing(known: Model, found: Model) -> str:
    """How a model's joint controllers differ from another's, in words; empty for no difference.

    Args:
        known, found: the models.
    """
    if found.by_law:
        assert found.command is not None
        return _by_law(found)
    assert found.controller is not None
    parts = [words] if (words := beside_cascade(found.controller)) else []
    late = found.controller.delay - (known.controller.delay if known.controller is not None else 0.0)
    if late > _SHOWN_LATE:
        parts.append(f"commands {1e3 * late:.2g} ms late")
    if known.controller is None:
        return " and ".join(parts)
    before, after = Cascade.of(known.controller), Cascade.of(found.controller)
    lags = [controller.filter_order * float(np.median(controller.filter_time))
            for controller in (known.controller, found.controller)]
    if lags[1] - lags[0] > _SHOWN_LAG:
        parts.append(f"commands lag by {1e3 * lags[1]:.2g} ms")
    share, of = (float(np.median(cascade.velocity_feedforward)) for cascade in (after, before))
    if abs(share - of) > _SHOWN_SHARE:
        parts.append(f"{100.0 * share:.0f} % of the velocity is fed forward, not {100.0 * of:.0f} %")
    gain, of = (float(np.median(cascade.position_gain)) for cascade in (after, before))
    if abs(np.log(gain / of)) > _SHOWN_SHARE:
        parts.append(f"position gains of {gain:.3g} 1/s, not {of:.3g}")
    return " and ".join(parts)


def _by_law(found: Model) -> str:
    """What the law of the command has beyond a cascade: each thing once, as the middle one of the joints has it."""
    assert found.command is not None
    alike: dict[str, list[tuple[int, str]]] = {}
    for joint, words in beyond_cascade(found.command):
        alike.setdefault(re.sub(r"[0-9.]+", "#", words), []).append((joint, words))
    parts = []
    for entries in alike.values():
        joints = [joint for joint, _ in entries]
        where = "" if len(joints) == found.n else f" in joint {', '.join(map(str, joints))}"
        parts.append(entries[len(entries) // 2][1] + where)
    return " and ".join(parts)
