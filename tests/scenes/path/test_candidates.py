"""Which forms of a change a diagnosis suggests."""

from __future__ import annotations

import pytest

from ideal_robot.diagnosis import Diagnosis
from ideal_robot.effects import FittedEffect
from scenes.closing.loop import Group
from scenes.path.candidates import Candidates
from tests.scenes.path import kind_arm as arm
from tests.scenes.path.effect_cases import CASES


def test_what_explains_a_recording_with_the_model_as_it_was_is_tried_too() -> None:
    """Where parameters were fitted anew, a body hides in them, and all that has a name then may be what cannot act."""
    case = CASES["payload/tau"]()
    moved = arm.recording(case.world, of=case.individual)
    offset = FittedEffect("current_offset", 1, "tau_1", (1.0,))
    found = Diagnosis("unknown", (), (), (), "", 0.0, beside_known=((case.true, offset),))
    (of_arm, of_tool), refused = Candidates(arm.model(), found, moved, moved, arm.ROBOT, "tcp").groups()
    (together,), (alone, of_offset) = of_arm.together, of_arm.apart
    assert of_tool == Group((), ())
    assert together.places == (("payload", 0), ("current_offset", 1))
    for form in (together, *alone):
        added = form.change(arm.model(), None).effects
        assert added[0].coefficients[0] == pytest.approx(case.true.coefficients[0], rel=0.05)
    assert [form.places for form in alone] == [(("payload", 0),)] * 2
    assert [form.places for form in of_offset] == [(("current_offset", 1),)] * 2
    assert not refused
