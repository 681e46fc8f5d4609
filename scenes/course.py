"""The exercises of the course: their answers, which the notebooks must not show.

A notebook ends with ``check = exercise("controller", globals())`` and ``check(answer)``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

Names = Mapping[str, Any]
"""What a notebook's cells have made."""


@dataclass(frozen=True)
class Exercise:
    """The question at the end of a lesson.

    Attributes:
        answer: computes the right answer from the notebook's variables.
        within: largest difference between an accepted answer and it.
        relative: whether that is a share of the answer.
        hint: said of a wrong one.
        remark: said of a right one.
    """

    answer: Callable[[Names], float]
    within: float
    hint: str
    relative: bool = False
    remark: str = ""


def _controller(made: Names) -> float:
    return float(min(np.geomspace(0.001, 3.0, 300), key=made["with_gain"]))


def _friction(made: Names) -> float:
    cold = made["ARMS"]["kr15"][1].replace(start_temperature=22.0)
    return float(made["friction_at"]("kr15", 3, 0.25, cold) / made["friction_at"]("kr15", 3, 0.25))


def _identification(made: Names) -> float:
    unseen = made["result"].result.validation[0]
    return float(100.0 * np.std(unseen.measured[:, 1] - unseen.tau[:, 1]) / np.std(unseen.measured[:, 1]))


def _learning(made: Names) -> float:
    error = {key: made["circle"].runs[key].errors.time_matched.E_car for key in made["METHODS"]}
    plays = [n for n, key in enumerate(made["METHODS"][-4:], 1) if error[key] < error["precorrected-printed"]]
    return float(plays[0] if plays else 0)


def _stiffness(made: Names) -> float:
    both = made["both"]
    return float(100.0 * (both.loc[1, "wrench"] / both.loc[1, "motor"] - 1.0))


EXERCISES = {
    "controller": Exercise(_controller, 0.1, "numpy.geomspace gives values to try; look for the least with_gain",
                           relative=True),
    "force": Exercise(lambda _: 1.0 - 1.0 / 1.6, 0.005, "read the sentence about the share above once more"),
    "friction": Exercise(_friction, 0.02, "cold over half warm, at the same speed, of the joint with index 3",
                         relative=True),
    "identification": Exercise(_identification, 0.1,
                               "of column 1 the scatter of what is not predicted, over that of what was measured"),
    "latency": Exercise(lambda _: 2.8, 0.1, "how far does the tool travel in that time?", remark="Across the line only "
                        "the slope of the line against its reference, times this, is seen."),
    "learning": Exercise(_learning, 0.0, "the first play below precorrected-printed; 0 if none is"),
    "line_following": Exercise(lambda made: 700.0 * made["scene"].camera.latency, 0.5,
                               "how far does the tool travel while a field is on its way?"),
    "precorrection": Exercise(lambda made: float(min(np.arange(0.0, 40.5, 0.5), key=made["off_by"])), 0.5,
                              "move the slider to where E_car is least, or search with off_by"),
    "residual_to_effect": Exercise(lambda made: 100.0 * (1.0 - made["error"] / made["before"]), 0.5,
                                   "by how much is the new error less, as a share of the old one?"),
    "stiffness": Exercise(_stiffness, 0.1, "which factor makes one method's stiffness the other's? The sign matters"),
}
"""By the name of the notebook."""


def exercise(lesson: str, made: Names) -> Callable[[float | None], bool]:
    """The check of a lesson's exercise: takes an answer, prints whether it is right or a hint, and returns it.

    Args:
        lesson: name of the notebook.
        made: names of the notebook, ``globals()``; they are looked up when an answer is given.
    """
    asked = EXERCISES[lesson]

    def check(answer: float | None) -> bool:
        right = False
        if answer is not None:
            true = asked.answer(made)
            right = math.isclose(float(answer), true, rel_tol=asked.within if asked.relative else 0.0,
                                 abs_tol=0.0 if asked.relative else asked.within)
        print(f"Right. {asked.remark}".strip() if right else f"Not yet: {asked.hint}.")
        return right

    return check
