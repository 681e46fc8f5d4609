"""What an arm that measures motor angles alone may believe of its tool."""

from __future__ import annotations

import pytest

from scenes.path import adoption_on_path
from scenes.path.adoption_on_path import measured_error
from scenes.path.candidates import Candidate
from tests.scenes.path import kind_arm as arm
from tests.scenes.path.effect_cases import CASES


def test_a_load_that_currents_show_counts_behind_the_gears() -> None:
    """A payload bends the gears; a model that makes up for it must not look worse to motor angles than one without."""
    case = CASES["payload/tau"]()
    known = arm.model()
    extended = known.with_effects((case.true,))
    before, after = (arm.played(case.world, model, of=case.individual) for model in (known, extended))

    def seen(played: arm.Play, *effects: object) -> float:
        return measured_error(played, arm.path(), arm.ROBOT, known, "motor", effects)

    assert seen(after, case.true) < 0.5 * seen(before, case.true)
    # Without the load behind the gears the better play looks worse.
    assert seen(after) > seen(after, case.true)


def test_a_softer_gear_does_not_confirm_itself() -> None:
    """Motor angles are brought behind the gears as they were known: what follows a changed stiffness looks wrong."""
    case = CASES["joint_elasticity/qa"]()
    known = arm.model()
    extended = known.with_effects((case.true,))
    before, after = (arm.played(case.world, model, of=case.individual) for model in (known, extended))
    seen = [measured_error(one, arm.path(), arm.ROBOT, known, "motor", extended.effects) for one in (before, after)]
    assert seen[1] > seen[0]


@pytest.mark.parametrize(("left", "played"), [(1.005, True), (1.05, False)])
def test_a_change_that_hardly_shows_on_the_loop_is_played(left, played, monkeypatch) -> None:
    """A payload under stiff control leaves as much of its joints unexplained and bends the path all the same."""
    effect = CASES["payload/tau"]().true
    cell = adoption_on_path.PathCell(arm.ROBOT, arm.WORLD, arm.model(), arm.path(), "motor", 1)
    ladder = adoption_on_path._Ladder(cell, None, cell.model, "tcp", 1)
    tried: list[str] = []
    monkeypatch.setattr(ladder, "_left", lambda model: left if model.effects else 1.0)
    monkeypatch.setattr(ladder, "_played", lambda label, model: bool(tried.append(label)) or True)
    assert ladder.climb((Candidate.adding("payload", (effect,)),)) is played
    assert tried == (["payload"] if played else [])
