"""A change of the model that explains what the arm did leaves less of it unexplained on the identified loop."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from scenes.path.cell import PathCell
from scenes.path.close_loop import left_unexplained
from tests.scenes.path import kind_arm as arm
from tests.scenes.path.effect_cases import CASES, friction_of


@pytest.mark.parametrize(("key", "measured"), [("stribeck/tau", "motor"), ("payload/tau", "motor"),
                                               ("joint_elasticity/qa", "tcp")])
def test_true_change_explains_the_play_and_its_opposite_does_not(key: str, measured: str) -> None:
    case = CASES[key]()
    known = dataclasses.replace(arm.model(), friction=friction_of(case))
    played = arm.played(case.world, known, of=case.individual)
    opposite = dataclasses.replace(case.true, coefficients=tuple(-0.5 * value for value in case.true.coefficients))
    cell = PathCell(arm.ROBOT, case.world, known, arm.path(), "motor", 1)
    before, right, wrong = (float(np.linalg.norm(left_unexplained(cell, model, played, measured))) for model in (
        known, known.with_effects((case.true,)), known.with_effects((opposite,))))
    # What two programs that simulate the same arm differ by, about 20 µm, is in all three.
    assert right < 0.9 * before
    assert wrong > 0.999 * before
