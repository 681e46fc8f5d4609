"""The table of effects, the way in for effects of others, and what a single effect says of itself."""

from __future__ import annotations

import numpy as np
import pytest

from ideal_robot.diagnosis import diagnose
from ideal_robot.diagnosis.validation.evidence import discriminating_motion
from ideal_robot.effects import FittedEffect, effect_of, library, names, register, unregister
from ideal_robot.effects.base import Effect
from ideal_robot.effects.learned import Unknown
from ideal_robot.effects.registry import EFFECTS
from ideal_robot.errors import InputError
from ideal_robot.signals.recording import Recording
from tests.ideal_robot.diagnosis.test_diagnose import arm
from tests.ideal_robot.effects.test_laws import motion


class SquareOfPosition(Effect):
    """A torque that no effect of ours makes: ``tau = c sign(sin(7 q))``."""

    name = "square_of_position"
    discriminating_motion = (("cable_spring", "other strokes"),)

    def columns(self, signals, joint, theta):
        return signals.on_joint(joint, np.sign(np.sin(7.0 * signals.q[:, joint - 1])))


@pytest.fixture
def own_effect():
    effect = SquareOfPosition()
    register(effect)
    yield effect
    unregister(effect)


def test_the_table_says_of_each_effect_what_its_class_says():
    assert EFFECTS.names() == tuple(effect.key for effect in library())
    assert len(set(EFFECTS.names())) == len(library())


def test_rivals_that_effects_name_are_effects():
    named = {rival for effect in library() for rival, _ in effect.discriminating_motion}
    assert named <= set(names())


def test_an_own_effect_is_found_by_the_diagnosis(own_effect, tmp_path):
    assert own_effect in library()
    assert "square_of_position" in names()
    one, rng = arm(tmp_path), np.random.default_rng(3)
    t = np.arange(0.0, 40.0, 0.004)
    q = 0.6 * np.sin(0.7 * t)[:, None] + 0.3 * np.sin(1.9 * t)[:, None]
    qd, qdd = np.gradient(q, t, axis=0), np.gradient(np.gradient(q, t, axis=0), t, axis=0)
    tau = 0.6 * qdd - 14.7 * np.cos(q) + 2.0 * np.tanh(qd / 2e-3) + 1.5 * qd + 0.03 * rng.normal(size=q.shape)
    tau = tau + 0.7 * np.sign(np.sin(7.0 * q))
    found = diagnose(Recording.from_arrays(t, q=q, tau=tau), one)
    assert [e.fitted.name for e in found.effects] == ["square_of_position"]
    assert found.effects[0].fitted.coefficients[0] == pytest.approx(0.7, rel=0.02)
    assert found.effects[0].fitted.channel == "tau_1"
    assert discriminating_motion("cable_spring", ("square_of_position",)) == "other strokes"


def test_an_effect_is_registered_once(own_effect):
    with pytest.raises(InputError, match="already"):
        register(SquareOfPosition())


def test_an_effect_that_was_taken_out_is_unknown():
    effect = SquareOfPosition()
    register(effect)
    fitted = FittedEffect(effect.name, 1, "tau_1", (2.0,))
    assert effect_of(fitted) is effect
    unregister(effect)
    with pytest.raises(InputError, match="known are"):
        fitted.contribution(motion())


@pytest.mark.parametrize("key", ["prefix", "head"])
def test_a_learned_curve_of_an_older_file_is_read(key):
    data = {"depends_on": ["q_1"], "directed": False, "knots": [[-1.0, 1.0]], key: "tcp"}
    assert Unknown.from_data(data).channel(2) == "tcp_2"
